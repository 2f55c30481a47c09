/* See dbo_kernel.h. The readable twin of this file is in the package, export/single_kernel.py; both give
 * the same bits. */
#include "dbo_kernel.h"

#include <float.h>
#include <stddef.h>

#define ALL_ONES UINT32_MAX
#define SINGLE 4 /* so many gears ahead cost less one by one than by runs; 3 and 8 cost more */
#define LEAP 3U  /* runs shorter than this cost more as a run than gear by gear */
#define FAR 32   /* where as many gears like the next one are to be travelled, whole blocks come first */

#if defined(FLT_EVAL_METHOD) && FLT_EVAL_METHOD != 0 && !defined(DBO_Q31)
#error "float must be computed as float: compile for hardware or software float32, not x87"
#endif

#if defined(__ARM_ARCH_ISA_THUMB) && __ARM_ARCH_ISA_THUMB == 1
#define THUMB_1 1
#else
#define THUMB_1 0
#endif

/* Kept apart from its caller: all in one, these loops find no room in the registers of a Cortex-M0+. */
#if defined(__GNUC__) && THUMB_1
#define APART static __attribute__((noinline))
#else
#define APART static
#endif

/* Place of the lowest one, by a de Bruijn sequence: every chip multiplies, few count zeros. */
static uint32_t first_one(uint32_t word) {
    static const uint8_t place[32] = {0,  1,  28, 2,  29, 14, 24, 3,  30, 22, 20, 15, 25, 17, 4,  8,
                                      31, 27, 13, 23, 21, 19, 16, 7,  26, 12, 18, 6,  11, 5,  10, 9};
    return place[((word & (~word + 1U)) * UINT32_C(0x077CB531)) >> 27];
}

/* Place of the highest one. */
static uint32_t last_one(uint32_t word) {
    for (uint32_t reach = 1U; reach < 32U; reach *= 2U) word |= word >> reach;
    return first_one(word ^ word >> 1);
}

static uint32_t count_ones(uint32_t word) {
    word -= word >> 1 & UINT32_C(0x55555555);
    word = (word & UINT32_C(0x33333333)) + (word >> 2 & UINT32_C(0x33333333));
    word = (word + (word >> 4)) & UINT32_C(0x0F0F0F0F);
    return (word * UINT32_C(0x01010101)) >> 24;
}

/* ---- what differs between the arithmetics ------------------------------------------------------------ */

#define FARTHEST ((dbo_position)1 << 60) /* beyond every position, and a difference of two fits 64 bits */

/* Where float32 is software, its bits compare and convert for a fifth of that. */
#if !defined(DBO_Q31) && (defined(DBO_SOFT_FLOAT) || (defined(__arm__) && !(defined(__ARM_FP) && (__ARM_FP & 4))) || \
                          (defined(__riscv) && !defined(__riscv_flen)))
#define SOFT_FLOAT 1

static uint32_t bits_of(float value) {
    union {
        float value;
        uint32_t bits;
    } u;
    u.value = value;
    return u.bits;
}

/* A whole number that rises with the float. */
typedef int32_t dbo_order;
static dbo_order order_of(float value) {
    const uint32_t bits = bits_of(value);
    const int32_t size = (int32_t)(bits & 0x7FFFFFFFU);
    return size == (int32_t)bits ? size : -size;
}
#else
#define SOFT_FLOAT 0
typedef dbo_number dbo_order;
#define order_of(value) (value)
#endif

/* value / 2^shift, rounded down. The right shift of a negative number is written out: what it does is left to
 * the compiler, and every compiler makes one instruction of this. */
static int64_t floored(int64_t value, uint32_t shift) {
    return value >= 0 ? value >> shift : ~(~value >> shift);
}

/* value / 2^shift, rounded to nearest. */
static int64_t scaled_down(int64_t value, uint32_t shift) {
    return shift == 0U ? value : floored(value + ((int64_t)1 << (shift - 1U)), shift);
}

static int64_t within(int64_t value, int64_t low, int64_t high) {
    return value < low ? low : value > high ? high : value;
}

int32_t dbo_counts_of(int64_t value, uint32_t shift) {
    return (int32_t)within(scaled_down(value, shift), INT32_MIN, INT32_MAX);
}

#if defined(DBO_Q31)

/* slope x way / 2^shift; a way beyond 32 bits, outside of the gears, loses its last 16 bits first. */
static dbo_signal along(dbo_number slope, dbo_position way, uint32_t shift) {
    if (way >= INT32_MIN && way <= INT32_MAX) return scaled_down((int64_t)slope * way, shift);
    return scaled_down((int64_t)slope * within(scaled_down(way, 16U), INT32_MIN, INT32_MAX), shift - 16U);
}

static dbo_position along_gear(const dbo_backlash *op, dbo_number slope, dbo_position way) {
    return along(slope, way, op->slope_shift);
}

static dbo_position position_of(dbo_signal signal, uint32_t shift) {
    (void)shift;
    return signal;
}

#else

#define MOST_COUNTS 2147483520.0F /* the greatest float32 below 2^31 */

/* A number of counts as positions; from 2^31 on by 2^8 counts, which loses no digit, and what is beyond 2^39, or
 * no number, is brought to the end. */
static dbo_position position_of(dbo_signal counts, uint32_t shift) {
#if SOFT_FLOAT
    const uint32_t bits = bits_of(counts), coarse = (bits >> 23 & 255U) < 158U ? 0U : 8U;
    const uint32_t exponent = (bits >> 23 & 255U) - coarse, part = (bits & 0x7FFFFFU) | 0x800000U;
    int32_t whole = (int32_t)MOST_COUNTS;
    if (exponent < 127U)
        whole = 0;
    else if (exponent < 158U)
        whole = (int32_t)(exponent < 150U ? part >> (150U - exponent) : part << (exponent - 150U));
    if (bits > 0x7F800000U) whole = -whole; /* the sign, or no number */
#else
    const uint32_t coarse = counts >= -MOST_COUNTS && counts <= MOST_COUNTS ? 0U : 8U;
    int32_t whole;
    if (coarse != 0U) {
        counts *= 1.0F / 256.0F;
        if (!(counts > -MOST_COUNTS)) counts = -MOST_COUNTS;
        if (counts > MOST_COUNTS) counts = MOST_COUNTS;
    }
    whole = (int32_t)counts;
#endif
    return (dbo_position)whole * ((dbo_position)1 << (shift + coarse));
}

static dbo_position along_gear(const dbo_backlash *op, dbo_number slope, dbo_position way) {
    if (way >= INT32_MIN && way <= INT32_MAX)
        return position_of(slope * (float)(int32_t)way, 0U);
    return position_of(slope * (float)dbo_counts_of(way, op->y_shift), op->y_shift);
}

#endif

/* ---- memories ---------------------------------------------------------------------------------------- */

/* The remembered signal as the memories hold it. */
static int64_t drive_of(const dbo_backlash *op, dbo_position value) {
    return within((int64_t)dbo_counts_of(value, op->drive_shift) + op->drive_offset, INT32_MIN, INT32_MAX);
}

/* What the memories add up to, in positions. */
static dbo_position recalled(const dbo_backlash *op, const dbo_memory *memory) {
    int64_t sum = 0;
    for (uint32_t j = 0U; j < op->term_count; j++)
        sum += (int64_t)op->terms[j].carried * (int32_t)floored(memory[j], 24U);
    return scaled_down(sum, op->carried_shift);
}

static void remember(const dbo_backlash *op, dbo_memory *memory, int64_t drive) {
    for (uint32_t j = 0U; j < op->term_count; j++) {
        const int64_t way = drive - floored(memory[j], 24U);
        memory[j] += floored(way * op->terms[j].rest, op->terms[j].rest_shift - 24U);
    }
}

/* ---- the state's bits -------------------------------------------------------------------------------- */

static const dbo_gear *gear_at(const dbo_backlash *op, uint32_t i) {
    return op->gears + ((i * op->row_factor) >> op->row_shift);
}

/* The lowest bit that is one, or zero where `inverted` is all ones, from word k on; n where there is none. */
static uint32_t lowest(const uint32_t *words, uint32_t n, uint32_t k, uint32_t inverted) {
    for (; 32U * k < n; k++)
        if ((words[k] ^ inverted) != 0U) {
            const uint32_t found = 32U * k + first_one(words[k] ^ inverted);
            return found < n ? found : n;
        }
    return n;
}

/* Bits of word k whose gears can still be crossed. */
static uint32_t open_bits(uint32_t word, uint32_t k, uint32_t n, int rising) {
    const uint32_t open = rising ? ~word : word;
    return n - 32U * k < 32U ? open & ~(ALL_ONES << (n - 32U * k)) : open;
}

/* Where the sums over the gears crossed of a block of 64 stand, behind the bits: x and y, two words each. They
 * count where some of its gears are crossed and some are open: else they would be 0, or what it adds up to. */
static uint32_t *sums_of(const dbo_backlash *op, const dbo_backlash_state *state, uint32_t block) {
    return state->words + (op->n + 31U) / 32U + 4U * block;
}

static dbo_position sum(const uint32_t *at) { return (dbo_position)((uint64_t)at[1] << 32 | at[0]); }

static void set_sum(uint32_t *at, dbo_position value) {
    at[0] = (uint32_t)((uint64_t)value & ALL_ONES);
    at[1] = (uint32_t)((uint64_t)value >> 32);
}

void dbo_backlash_load(const dbo_backlash *op, dbo_backlash_state *state) {
    state->x = 0;
    state->y = 0;
    for (uint32_t k = 0U; k < 4U * (op->n / 64U); k++) sums_of(op, state, 0U)[k] = 0U;
    for (uint32_t i = 0U; i < op->n; i++) {
        const dbo_gear *gear = gear_at(op, i);
        uint32_t *sums = sums_of(op, state, i >> 6);
        if ((state->words[i >> 5] >> (i & 31U) & 1U) == 0U) continue;
        state->x += gear->width;
        state->y += gear->height;
        if (i >> 6 >= op->n / 64U) continue;
        set_sum(sums, sum(sums) + gear->width);
        set_sum(sums + 2, sum(sums + 2) + gear->height);
    }
    state->set = lowest(state->words, op->n, 0U, 0U);
    state->zero = lowest(state->words, op->n, 0U, ALL_ONES);
}

/* ---- the procedure, steps 1 to 4 --------------------------------------------------------------------- */

/* A way to go. What is left to travel, and of room on the output, falls with every gear crossed: below zero
 * only behind one that is crossed by the tolerance, and no gear is crossed after that. */
typedef struct {
    dbo_position left;
    dbo_position room;
    uint32_t nearly; /* the gear that is crossed by the tolerance; n: none */
    int going;       /* 0: the next gear is not crossed */
} dbo_way;

/* Whether a gear is crossed, where `left` and `room` are what would remain behind it. */
static int crosses(const dbo_backlash *op, const dbo_gear *gear, dbo_position left, dbo_position room) {
    if (left >= 0 && room >= 0) return 1;
    return left + (gear->width >> op->tolerance) >= 0 && room + (gear->height >> op->tolerance) >= 0;
}

/* Cross `open` gears of word k one by one, at most `most`; returns those that remain. */
APART uint32_t walk(const dbo_backlash *op, dbo_way *way, uint32_t k, uint32_t open, uint32_t most) {
    for (; open != 0U && most > 0U; most--) {
        const uint32_t i = 32U * k + first_one(open);
        const dbo_gear *gear = gear_at(op, i);
        const dbo_position left = way->left - gear->width, room = way->room - gear->height;
        if (left < 0 || room < 0) {
            way->going = crosses(op, gear, left, room);
            if (!way->going) break;
            way->nearly = i;
        }
        way->left = left;
        way->room = room;
        open &= open - 1U;
    }
    return open;
}

/* count x width; in halves of 16 bits on a Cortex-M0+, which has no product of 64 bits. */
static dbo_position times(uint32_t count, int32_t width) {
#if THUMB_1
    const uint32_t high = count * ((uint32_t)width >> 16), low = count * ((uint32_t)width & 0xFFFFU);
    return (dbo_position)(((uint64_t)high << 16) + low);
#else
    return (dbo_position)((uint64_t)count * (uint32_t)width);
#endif
}

/* How many of up to 64 gears like one go into both ways: by halves. */
static uint32_t fitting(const dbo_gear *gear, dbo_position across, dbo_position up) {
    uint64_t wide = (uint64_t)(uint32_t)gear->width << 5, high = (uint64_t)(uint32_t)gear->height << 5;
    uint32_t count = 0U;
    for (uint32_t half = 32U; half > 0U; half /= 2U, wide /= 2U, high /= 2U)
        if (across >= (dbo_position)wide && up >= (dbo_position)high) {
            across -= (dbo_position)wide;
            up -= (dbo_position)high;
            count += half;
        }
    return count;
}

/* Bits of a word from a place on. */
static uint32_t from_place(uint32_t word, uint32_t place) { return place < 32U ? word & ALL_ONES << place : 0U; }

static uint32_t from_high(uint32_t word, uint32_t place) {
    return place > 32U ? from_place(word, place - 32U) : word;
}

/* Cross gears of a block of 64 that are open in its two words, equal ones side by side at once. */
APART void walk_rows(const dbo_backlash *op, dbo_way *way, uint32_t block, uint32_t *low, uint32_t *high) {
    const uint64_t open = (uint64_t)*high << 32 | *low, beyond = open + (open & (~open + 1U));
    const int gapless = (beyond & (beyond - 1U)) == 0U; /* one bit, or beyond all 64 */
    dbo_position left = way->left, room = way->room;
    uint32_t place = *low != 0U ? first_one(*low) : 32U + first_one(*high), crossed = 0U;
    uint32_t more = gapless && beyond == 0U ? 64U - place : count_ones(*low) + count_ones(*high);
    uint32_t row = ((64U * block + place) * op->row_factor) >> op->row_shift;
    uint32_t row_end = (row + 1U) * op->run - 64U * block;
    for (const dbo_gear *gear = op->gears + row; more > 0U; gear++, row_end += op->run) {
        const uint32_t stop = row_end < 64U ? row_end : 64U, side = stop - place;
        const uint32_t count = gapless ? (side < more ? side : more)
                                       : count_ones(from_place(*low, place) & ~from_place(ALL_ONES, stop)) +
                                             count_ones(from_high(*high, place) & ~from_high(ALL_ONES, stop));
        const dbo_position across = left, up = room;
        left -= times(count, gear->width);
        room -= times(count, gear->height);
        crossed = count;
        if (!crosses(op, gear, left, room)) {
            crossed = fitting(gear, across + (gear->width >> op->tolerance), up + (gear->height >> op->tolerance));
            left = across - times(crossed, gear->width);
            room = up - times(crossed, gear->height);
        }
        if (left < 0 && crossed > 0U) way->nearly = 64U * block + place;
        if (crossed < count) break;
        more -= count;
        place = stop;
    }
    way->left = left;
    way->room = room;
    if (more == 0U)
        place = 64U;
    else if (gapless)
        place += crossed;
    *low = from_place(*low, place);
    *high = from_high(*high, place);
    if (more == 0U || gapless) return;
    for (; crossed > 0U; crossed--) {
        if (*low != 0U)
            *low &= *low - 1U;
        else
            *high &= *high - 1U;
    }
}

/* Cross blocks of 64 gears, words `word` to `end`, while all of a block are `open` and its far end is within
 * the way: found by halves. They begin at `at`. Returns the word where that ends. */
APART uint32_t *pass_open_blocks(uint32_t *word, const uint32_t *end, const dbo_block *at, dbo_way *way,
                                 uint32_t open) {
    const dbo_position x = way->left + at->x, y = way->room + at->y;
    uint32_t within = 0U, beyond = (uint32_t)(end - word) / 2U + 1U;
    while (within + 1U < beyond) {
        const uint32_t middle = (within + beyond) / 2U;
        if (at[middle].x <= x && at[middle].y <= y)
            within = middle;
        else
            beyond = middle;
    }
    for (end = word + 2U * within; word != end && word[0] == open && word[1] == open; word += 2)
        word[0] = word[1] = ~open;
    at += within - (uint32_t)(end - word) / 2U;
    way->left = x - at->x;
    way->room = y - at->y;
    return word;
}

/* Cross whole blocks: all gears of one that are open, where the last one of them is crossed. Returns the first
 * block that is not crossed. */
APART uint32_t pass_blocks(const dbo_backlash *op, const dbo_backlash_state *state, dbo_way *way, uint32_t block,
                           int rising) {
    const uint32_t closed = rising ? ALL_ONES : 0U, end = op->n / 64U;
    for (; block < end; block++) {
        uint32_t *word = state->words + 2U * block;
        uint32_t low, high;
        dbo_position left, room;
        if (word[0] == closed && word[1] == closed) continue;
        word = pass_open_blocks(word, state->words + 2U * end, op->blocks + block, way, ~closed);
        block = (uint32_t)(word - state->words) / 2U;
        if (block == end) break;
        low = word[0] ^ closed;
        high = word[1] ^ closed;
        if ((low | high) != 0U) {
            const dbo_block *at = op->blocks + block;
            const uint32_t *sums = sums_of(op, state, block);
            const int all = (low & high) == ALL_ONES;
            const dbo_position x = all ? 0 : sum(sums), y = all ? 0 : sum(sums + 2);
            left = way->left - (all || rising ? at[1].x - at->x - x : x);
            room = way->room - (all || rising ? at[1].y - at->y - y : y);
            if (left < 0 || room < 0) {
                const uint32_t top = 64U * block + (high != 0U ? 32U + last_one(high) : last_one(low));
                if (!crosses(op, gear_at(op, top), left, room)) break;
                way->nearly = top;
            }
            way->left = left;
            way->room = room;
            word[0] = word[1] = closed;
        }
    }
    return block;
}

/* Gears of a block are crossed, up or down, x and y in all: the sums of the block, before its bits change. */
static void note_crossed(const dbo_backlash *op, const dbo_backlash_state *state, uint32_t block, dbo_position x,
                         dbo_position y, int rising) {
    const uint32_t *word = state->words + 2U * block;
    uint32_t *sums = sums_of(op, state, block);
    const dbo_block *at = op->blocks + block;
    if (block >= op->n / 64U) return;
    if (rising) {
        const int none = (word[0] | word[1]) == 0U;
        set_sum(sums, (none ? 0 : sum(sums)) + x);
        set_sum(sums + 2, (none ? 0 : sum(sums + 2)) + y);
    } else {
        const int all = (word[0] & word[1]) == ALL_ONES;
        set_sum(sums, (all ? at[1].x - at->x : sum(sums)) - x);
        set_sum(sums + 2, (all ? at[1].y - at->y : sum(sums + 2)) - y);
    }
}

/* Cross gears one way, (6)-(9), while the input `u` is far enough and the output has room up to `bound`;
 * returns the one that the tolerance let pass, n where there was none. */
static uint32_t pass_gears(const dbo_backlash *op, dbo_backlash_state *state, dbo_position u,
                           dbo_position bound, int rising) {
    const uint32_t words = (op->n + 31U) / 32U;
    uint32_t next = rising ? state->zero : state->set, block = next / 64U;
    dbo_way way = {rising ? u - state->x : state->x - u, rising ? bound - state->y : state->y - bound, op->n,
                   1};
    const dbo_gear *gear;
    int far;
    if (next == op->n) return op->n;
    gear = gear_at(op, next);
    if (!crosses(op, gear, way.left - gear->width, way.room - gear->height)) return op->n;
    far = way.left >= FAR * (dbo_position)gear->width;
    for (next = op->n; 64U * block < op->n; block++, far = 1) {
        uint32_t *word, low, high, open_low, open_high;
        dbo_position left, room;
        if (far) block = pass_blocks(op, state, &way, block, rising);
        if (64U * block >= op->n) break;
        left = way.left;
        room = way.room;
        word = state->words + 2U * block;
        low = open_low = open_bits(word[0], 2U * block, op->n, rising);
        high = open_high = 2U * block + 1U < words ? open_bits(word[1], 2U * block + 1U, op->n, rising) : 0U;
        if (op->run < LEAP || left < SINGLE * (dbo_position)gear->width) {
            const uint32_t most = op->run < LEAP ? 32U : (uint32_t)SINGLE;
            if (low != 0U) low = walk(op, &way, 2U * block, low, most);
            if (low == 0U && way.going) high = walk(op, &way, 2U * block + 1U, high, most);
        }
        if (way.going && (low | high) != 0U) walk_rows(op, &way, block, &low, &high);
        if (low != open_low || high != open_high) {
            note_crossed(op, state, block, left - way.left, room - way.room, rising);
            word[0] ^= low ^ open_low;
            if (high != open_high) word[1] ^= high ^ open_high;
        }
        if ((low | high) != 0U) {
            next = 64U * block + (low != 0U ? first_one(low) : 32U + first_one(high));
            break;
        }
    }
    state->x = rising ? u - way.left : u + way.left;
    state->y = rising ? bound - way.room : bound + way.room;
    state->set = rising ? 0U : next;
    state->zero = rising ? next : 0U;
    return way.nearly;
}

/* Drive the operator with exchanged axes one way, to the output `y`. */
static void follow_output(const dbo_backlash *op, dbo_backlash_state *state, dbo_position y, int rising) {
    (void)pass_gears(op, state, rising ? FARTHEST : -FARTHEST, y, rising);
}

/* The output for the input `u`, never crossing a gear that would leave low ... high. */
static dbo_position solve(const dbo_backlash *op, dbo_backlash_state *state, dbo_position u, dbo_position low,
                          dbo_position high) {
    const int rising = u >= state->x;
    const uint32_t last = pass_gears(op, state, u, rising ? high : low, rising);
    uint32_t next = rising ? state->zero : state->set;
    const dbo_position d = u - state->x;
    if (last < op->n && (rising ? d < 0 : d > 0)) next = last; /* crossed by the tolerance */
    return state->y + along_gear(op, gear_at(op, next < op->n ? next : op->n - 1U)->slope, d);
}

/* The output within low ... high, the state that of the exchanged operator driven by it. */
static dbo_position solve_within(const dbo_backlash *op, dbo_backlash_state *state, dbo_position u,
                                 dbo_position low, dbo_position high) {
    const int rising = u >= state->x;
    dbo_position y;
    if (rising ? high < state->y : low > state->y) { /* the limits lie on the other side */
        follow_output(op, state, rising ? high : low, !rising);
        return rising ? high : low;
    }
    y = solve(op, state, u, low, high);
    if (y > high) {
        if (!rising) follow_output(op, state, high, 0);
        return high;
    }
    if (y < low) {
        if (rising) follow_output(op, state, low, 1);
        return low;
    }
    return y;
}

dbo_position dbo_backlash_step(const dbo_backlash *op, dbo_backlash_state *state, dbo_signal u,
                               const dbo_limits *limits) {
    const int on_output = op->term_count > 0U && op->memory_on_output;
    const int on_input = op->term_count > 0U && !op->memory_on_output;
    dbo_position x = position_of(u, op->x_shift), remembered = 0, y;
    if (on_input) remember(op, state->memory, drive_of(op, x));
    if (op->term_count > 0U) remembered = recalled(op, state->memory);
    x = within(on_output ? x - remembered : x, op->least, op->most);
    if (limits == NULL) {
        y = solve(op, state, x, -FARTHEST, FARTHEST);
    } else {
        dbo_position low = limits->low, high = limits->high;
        if (limits->step >= 0) { /* the range wins over the slew limit */
            const dbo_position least = state->last - limits->step, most = state->last + limits->step;
            low = least < low ? low : least > high ? high : least;
            high = most > high ? high : most < limits->low ? limits->low : most;
        }
        y = solve_within(op, state, x, low, high);
    }
    state->last = y;
    if (on_output) remember(op, state->memory, drive_of(op, y));
    return on_input ? y + remembered : y;
}

void dbo_backlash_settle(const dbo_backlash *op, dbo_backlash_state *state, uint32_t covered,
                         const uint32_t *spare, dbo_signal drive) {
    const dbo_position place = position_of(drive, op->memory_on_output ? op->y_shift : op->x_shift);
    dbo_position low = 0, high = 0, slack, target;
    for (uint32_t k = 0U; 32U * k < op->n; k++) state->words[k] = spare == NULL ? 0U : spare[k];
    dbo_backlash_load(op, state);
    target = place - (op->memory_on_output ? state->y : state->x);
    for (uint32_t i = 0U; i < covered; i++)
        high += op->memory_on_output ? gear_at(op, i)->height : gear_at(op, i)->width;
    slack = high / 1048576; /* a tie, as with even gears halfway, stays 1 */
    for (uint32_t i = covered; i > 0U && target > 0; i--) {
        const dbo_gear *gear = gear_at(op, i - 1U);
        const dbo_position width = op->memory_on_output ? gear->height : gear->width;
        if (target - low >= (high - target) - slack) {
            state->words[(i - 1U) >> 5] |= (uint32_t)1 << ((i - 1U) & 31U);
            low += width;
        } else {
            high -= width;
        }
    }
    for (uint32_t j = 0U; j < op->term_count; j++) state->memory[j] = drive_of(op, place) * ((int64_t)1 << 24);
    dbo_backlash_load(op, state);
    if (op->memory_on_output)
        follow_output(op, state, place, place >= state->y);
    else
        (void)pass_gears(op, state, place, place >= state->x ? FARTHEST : -FARTHEST, place >= state->x);
    state->last = place;
}

/* ---- points and scales, folded into one piecewise linear function ------------------------------------ */

dbo_signal dbo_segments_step(const dbo_segment *segments, uint32_t count, uint32_t shift,
                             uint32_t *segment, dbo_number u) {
    const dbo_order at = order_of(u);
    uint32_t c = *segment;
    if ((c + 1U < count && at >= order_of(segments[c + 1U].x)) || (c > 0U && at < order_of(segments[c].x))) {
        uint32_t beyond = count;
        c = 0U;
        while (c + 1U < beyond) { /* by halves: a jump costs little more than a step */
            const uint32_t middle = (c + beyond) / 2U;
            if (at >= order_of(segments[middle].x))
                c = middle;
            else
                beyond = middle;
        }
    }
    *segment = c;
#if defined(DBO_Q31)
    return segments[c].y + along(segments[c].slope, (dbo_position)u - segments[c].x, shift);
#else
    (void)shift;
    return segments[c].y + segments[c].slope * (u - segments[c].x);
#endif
}
