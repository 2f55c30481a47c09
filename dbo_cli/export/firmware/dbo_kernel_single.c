/* See dbo_kernel.h. The readable twin of this file is in the package, export/single_kernel.py; both give
 * the same bits. */
#include "dbo_kernel.h"

#include <float.h>
#include <stddef.h>

#define ALL_ONES UINT32_MAX
#define SINGLE 4 /* so many gears are crossed one by one before whole blocks are tried: 3 and 8 cost more */

#if defined(FLT_EVAL_METHOD) && FLT_EVAL_METHOD != 0 && !defined(DBO_Q31)
#error "float must be computed as float: compile for hardware or software float32, not x87"
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

/* ---- what differs between the arithmetics ------------------------------------------------------------ */

#define FARTHEST ((dbo_position)1 << 60)

/* value / 2^shift, rounded to nearest. The right shift of a negative number is written out: what it does
 * is left to the compiler, and every compiler makes one instruction of this. */
static int64_t scaled_down(int64_t value, uint32_t shift) {
    if (shift == 0U) return value;
    value += (int64_t)1 << (shift - 1U);
    return value >= 0 ? value >> shift : ~(~value >> shift);
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

/* The remembered signal as the memories hold it. */
static int64_t drive_of(const dbo_backlash *op, dbo_position value) {
    const uint32_t shift = op->memory_on_output ? op->y_shift : op->x_shift;
    return within((int64_t)dbo_counts_of(value, shift) + op->drive_offset, INT32_MIN, INT32_MAX);
}

static dbo_signal recalled(const dbo_term *term, const dbo_memory *memory) {
    return scaled_down((int64_t)term->carried * scaled_down(*memory, 24U), term->carried_shift);
}

static void remember(const dbo_term *term, dbo_memory *memory, int64_t drive) {
    const int64_t way = drive - scaled_down(*memory, 24U);
    *memory += scaled_down(way * term->rest, term->rest_shift - 24U);
}

static void rest_at(dbo_memory *memory, int64_t drive) { *memory = drive * ((int64_t)1 << 24); }

typedef int64_t remembered_drive;

#else

#define MOST_COUNTS 2147483520.0F /* the greatest float32 below 2^31 */

/* A number of counts as positions; what is beyond 32 bits, or no number, is brought to the end. */
static dbo_position position_of(dbo_signal counts, uint32_t shift) {
    if (!(counts > -MOST_COUNTS)) counts = -MOST_COUNTS;
    if (counts > MOST_COUNTS) counts = MOST_COUNTS;
    return (dbo_position)(int32_t)counts * ((dbo_position)1 << shift);
}

static dbo_position along_gear(const dbo_backlash *op, dbo_number slope, dbo_position way) {
    if (way >= INT32_MIN && way <= INT32_MAX)
        return position_of(slope * (float)(int32_t)way, 0U);
    return position_of(slope * (float)dbo_counts_of(way, op->y_shift), op->y_shift);
}

static float drive_of(const dbo_backlash *op, dbo_position value) {
    return (float)dbo_counts_of(value, op->memory_on_output ? op->y_shift : op->x_shift) + op->drive_offset;
}

static dbo_signal recalled(const dbo_term *term, const dbo_memory *memory) {
    return term->carried * memory->value;
}

static void remember(const dbo_term *term, dbo_memory *memory, float drive) {
    const float change = term->rest * (drive - memory->value) + memory->lost;
    const float next = memory->value + change;
    memory->lost = change - (next - memory->value);
    memory->value = next;
}

static void rest_at(dbo_memory *memory, float drive) {
    memory->value = drive;
    memory->lost = 0.0F;
}

typedef float remembered_drive;

#endif

static dbo_position crossed_at(int32_t width, uint32_t tolerance) {
    return width - (width >> tolerance);
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

/* Sums over a block of 64 gears, each two words, behind the bits: of the gears crossed, and of all. */
enum { CROSSED_X = 0, CROSSED_Y = 2, WHOLE_X = 4, WHOLE_Y = 6, SUMS = 8 };

static uint32_t *sums_of(const dbo_backlash *op, const dbo_backlash_state *state, uint32_t block) {
    return state->words + (op->n + 31U) / 32U + (uint32_t)SUMS * block;
}

static dbo_position sum(const uint32_t *at) { return (dbo_position)((uint64_t)at[1] << 32 | at[0]); }

static void set_sum(uint32_t *at, dbo_position value) {
    at[0] = (uint32_t)((uint64_t)value & ALL_ONES);
    at[1] = (uint32_t)((uint64_t)value >> 32);
}

static void add_crossed(uint32_t *sums, dbo_position x, dbo_position y) {
    set_sum(sums + CROSSED_X, sum(sums + CROSSED_X) + x);
    set_sum(sums + CROSSED_Y, sum(sums + CROSSED_Y) + y);
}

/* S and Z (4)-(5) after gears from word k on were crossed. */
static void find_next(const dbo_backlash *op, dbo_backlash_state *state, uint32_t k, int rising) {
    state->set = rising ? 0U : lowest(state->words, op->n, k, 0U);
    state->zero = rising ? lowest(state->words, op->n, k, ALL_ONES) : 0U;
}

void dbo_backlash_load(const dbo_backlash *op, dbo_backlash_state *state) {
    state->x = 0;
    state->y = 0;
    for (uint32_t k = 0U; 64U * k < op->n; k++) {
        uint32_t *sums = sums_of(op, state, k);
        for (uint32_t s = 0U; s < (uint32_t)SUMS; s++) sums[s] = 0U;
    }
    for (uint32_t i = 0U; i < op->n; i++) {
        const dbo_gear *gear = gear_at(op, i);
        uint32_t *sums = sums_of(op, state, i >> 6);
        set_sum(sums + WHOLE_X, sum(sums + WHOLE_X) + gear->width);
        set_sum(sums + WHOLE_Y, sum(sums + WHOLE_Y) + gear->height);
        if ((state->words[i >> 5] >> (i & 31U) & 1U) == 0U) continue;
        add_crossed(sums, gear->width, gear->height);
        state->x += gear->width;
        state->y += gear->height;
    }
    state->set = lowest(state->words, op->n, 0U, 0U);
    state->zero = lowest(state->words, op->n, 0U, ALL_ONES);
}

/* ---- the procedure, steps 1 to 4 --------------------------------------------------------------------- */

/* Cross gears one by one while the input is far enough and the output has room, (6)-(9); `most` are left to
 * cross. Returns the gear crossed last, n where there was none. */
static uint32_t walk(const dbo_backlash *op, dbo_backlash_state *state, dbo_position u, dbo_position bound,
                     uint32_t *most, int rising) {
    const uint32_t begin = (rising ? state->zero : state->set) >> 5;
    dbo_position left = rising ? u - state->x : state->x - u;
    dbo_position room = rising ? bound - state->y : state->y - bound;
    uint32_t last = op->n, k = begin;
    int going = 1;
    for (; going && 32U * k < op->n; k++) {
        const dbo_position left_before = left, room_before = room;
        uint32_t open = open_bits(state->words[k], k, op->n, rising), crossed = open;
        dbo_position x, y;
        for (; open != 0U; open &= open - 1U) {
            const uint32_t i = 32U * k + first_one(open);
            const dbo_gear *gear = gear_at(op, i);
            going = *most > 0U && left >= crossed_at(gear->width, op->tolerance) &&
                    room >= crossed_at(gear->height, op->tolerance);
            if (!going) break;
            left -= gear->width;
            room -= gear->height;
            --*most;
            last = i;
        }
        crossed ^= open;
        if (crossed == 0U) continue;
        x = rising ? left_before - left : left - left_before;
        y = rising ? room_before - room : room - room_before;
        state->words[k] ^= crossed;
        add_crossed(sums_of(op, state, k >> 1), x, y);
        state->x += x;
        state->y += y;
    }
    if (last < op->n) find_next(op, state, begin, rising);
    return last;
}

/* Cross whole blocks of 64 gears: all that are open where the last one is crossed, since what is left to
 * travel, and of room, falls with every gear; that one surely is where its far end is short of both. Returns
 * the gear crossed last, n where there was none. */
static uint32_t pass_blocks(const dbo_backlash *op, dbo_backlash_state *state, dbo_position u,
                            dbo_position bound, int rising) {
    const uint32_t begin = (rising ? state->zero : state->set) >> 6;
    uint32_t last = op->n, block = begin;
    for (; 64U * block < op->n; block++) {
        uint32_t *sums = sums_of(op, state, block), *word = state->words + 2U * block;
        const int two = 64U * block + 32U < op->n;
        const uint32_t low = open_bits(word[0], 2U * block, op->n, rising);
        const uint32_t high = two ? open_bits(word[1], 2U * block + 1U, op->n, rising) : 0U;
        const dbo_position x = (rising ? sum(sums + WHOLE_X) : 0) - sum(sums + CROSSED_X);
        const dbo_position y = (rising ? sum(sums + WHOLE_Y) : 0) - sum(sums + CROSSED_Y);
        uint32_t top;
        if ((low | high) == 0U) continue;
        top = 64U * block + (high != 0U ? 32U + last_one(high) : last_one(low));
        if (rising ? u < state->x + x || bound < state->y + y : u > state->x + x || bound > state->y + y) {
            const dbo_gear *gear = gear_at(op, top);
            const dbo_position far_x = rising ? u - (state->x + x) : (state->x + x) - u;
            const dbo_position far_y = rising ? bound - (state->y + y) : (state->y + y) - bound;
            if (far_x + gear->width < crossed_at(gear->width, op->tolerance)) break;
            if (far_y + gear->height < crossed_at(gear->height, op->tolerance)) break;
        }
        word[0] ^= low;
        if (two) word[1] ^= high;
        add_crossed(sums, x, y);
        state->x += x;
        state->y += y;
        last = top;
    }
    if (last < op->n) find_next(op, state, 2U * begin, rising);
    return last;
}

/* Cross gears one way while the input `u` is far enough and the output has room up to `bound`; returns the
 * one crossed last, n where there was none. */
static uint32_t pass_gears(const dbo_backlash *op, dbo_backlash_state *state, dbo_position u,
                           dbo_position bound, int rising) {
    uint32_t single = SINGLE, all = op->n, blocks, rest;
    const uint32_t first = walk(op, state, u, bound, &single, rising);
    if (single > 0U) return first;
    blocks = pass_blocks(op, state, u, bound, rising);
    rest = walk(op, state, u, bound, &all, rising);
    return rest < op->n ? rest : blocks < op->n ? blocks : first;
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
    dbo_signal remembered = 0;
    dbo_position x, y;
    remembered_drive drive;
    if (!op->memory_on_output) {
        drive = drive_of(op, position_of(u, op->x_shift));
        for (uint32_t j = 0U; j < op->term_count; j++) {
            remember(op->terms + j, state->memory + j, drive);
            remembered += recalled(op->terms + j, state->memory + j);
        }
    } else {
        for (uint32_t j = 0U; j < op->term_count; j++) remembered += recalled(op->terms + j, state->memory + j);
        u -= remembered;
    }
    x = within(position_of(u, op->x_shift), op->least, op->most);
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
    if (!op->memory_on_output) return y + position_of(remembered, op->y_shift);
    drive = drive_of(op, y);
    for (uint32_t j = 0U; j < op->term_count; j++) remember(op->terms + j, state->memory + j, drive);
    return y;
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
    for (uint32_t j = 0U; j < op->term_count; j++) rest_at(state->memory + j, drive_of(op, place));
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
    uint32_t c = *segment;
    while (c + 1U < count && u >= segments[c + 1U].x) c++;
    while (c > 0U && u < segments[c].x) c--;
    *segment = c;
#if defined(DBO_Q31)
    return segments[c].y + along(segments[c].slope, (dbo_position)u - segments[c].x, shift);
#else
    (void)shift;
    return segments[c].y + segments[c].slope * (u - segments[c].x);
#endif
}
