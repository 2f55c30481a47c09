/* See dbo_kernel.h. The readable twin of this file is in the package, export/single_kernel.py; both give
 * the same bits. */
#include "dbo_kernel.h"

#include <float.h>
#include <stddef.h>

/* So many gears are crossed one by one before they are looked up; where FAR times the next one is left to travel, they
 * are looked up at once. */
#define SINGLE 2U
#define FAR 4

#if defined(FLT_EVAL_METHOD) && FLT_EVAL_METHOD != 0 && !defined(DBO_Q31)
#error "float must be computed as float: compile for hardware or software float32, not x87"
#endif

#if defined(__ARM_ARCH_ISA_THUMB) && __ARM_ARCH_ISA_THUMB == 1
#define THUMB_1 1
#else
#define THUMB_1 0
#endif

/* Parts of a look-up: in the place of their call, but for a Cortex-M0+, where all in one finds no room in the
 * registers. */
#if defined(__GNUC__) && THUMB_1
#define PART static __attribute__((noinline))
#elif defined(__GNUC__) || defined(__clang__)
#define PART static inline __attribute__((always_inline))
#else
#define PART static
#endif

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

/* ---- the table and the state ------------------------------------------------------------------------- */

static uint32_t row_of(const dbo_backlash *op, uint32_t gear) { return (gear * op->row_factor) >> op->row_shift; }

static const dbo_gear *gear_at(const dbo_backlash *op, uint32_t gear) { return op->gears + row_of(op, gear); }

/* count x width; in halves of 16 bits on a Cortex-M0+, which has no product of 64 bits. */
static dbo_position times(uint32_t count, int32_t width) {
#if THUMB_1
    const uint32_t high = count * ((uint32_t)width >> 16), low = count * ((uint32_t)width & 0xFFFFU);
    return (dbo_position)(((uint64_t)high << 16) + low);
#else
    return (dbo_position)((uint64_t)count * (uint32_t)width);
#endif
}

/* Where a gear begins with all gears below it crossed and no others; gear n where the last one ends. */
PART void find_begin(const dbo_backlash *op, uint32_t gear, dbo_begin *begin) {
    const uint32_t row = row_of(op, gear), before = gear - row * op->run;
    begin->x = op->begins[row].x;
    begin->y = op->begins[row].y;
    if (before > 0U) {
        begin->x += times(before, op->gears[row].width);
        begin->y += times(before, op->gears[row].height);
    }
}

/* The turn of a checkpoint. */
static uint32_t turn_of(uint32_t checkpoint) { return checkpoint * DBO_SPACING + DBO_SPACING - 1U; }

/* X_B, Y_B and the checkpoints from the ends of the runs, from the highest run on. */
static void add_up(const dbo_backlash *op, dbo_backlash_state *state) {
    const uint32_t depth = state->depth, lowest = state->set > state->zero ? state->set : state->zero;
    int ones = (state->set == 0U) == (depth % 2U == 0U);
    dbo_begin low, high;
    state->x = 0;
    state->y = 0;
    find_begin(op, op->n, &high);
    for (uint32_t k = 1U; k <= depth + 1U; k++) {
        uint32_t from = k == depth ? lowest : 0U;
        if (k < depth) from = state->turns[k];
        find_begin(op, from, &low);
        if (ones) {
            state->x += high.x - low.x;
            state->y += high.y - low.y;
        }
        if (k < depth && k % DBO_SPACING == DBO_SPACING - 1U) {
            state->checkpoints[k / DBO_SPACING].x = state->x;
            state->checkpoints[k / DBO_SPACING].y = state->y;
        }
        high = low;
        ones = !ones;
    }
}

static int bit_of(const uint32_t *words, uint32_t gear) { return (int)(words[gear >> 5] >> (gear & 31U) & 1U); }

void dbo_backlash_load(const dbo_backlash *op, dbo_backlash_state *state, const uint32_t *words) {
    uint32_t end = op->n;
    int ones = words != NULL && bit_of(words, end - 1U);
    state->depth = 0U;
    for (uint32_t i = words != NULL ? end - 1U : 0U; i > 0U; i--) { /* from the highest place where a run may begin */
        if (bit_of(words, i - 1U) == ones) continue;
        state->turns[state->depth++] = (dbo_place)end;
        end = i;
        ones = !ones;
    }
    state->set = (dbo_place)(ones ? 0U : end);
    state->zero = (dbo_place)(ones ? end : 0U);
    add_up(op, state);
}

/* ---- the procedure, steps 1 to 4 --------------------------------------------------------------------- */

/* Whether a gear is crossed, where `left` and `room` are what would remain behind it. */
static int crosses(const dbo_backlash *op, const dbo_gear *gear, dbo_position left, dbo_position room) {
    if (left >= 0 && room >= 0) return 1;
    return left + (gear->width >> op->tolerance) >= 0 && room + (gear->height >> op->tolerance) >= 0;
}

/* How many gears of one width go into a way, below 2 x half, a power of two: by halves. */
static uint32_t fitting(dbo_position way, int32_t width, uint32_t half) {
    dbo_position wide = times(half, width);
    uint32_t count = 0U;
    for (;; wide /= 2) {
        if (way >= wide) {
            way -= wide;
            count += half;
        }
        half /= 2U;
        if (half == 0U) return count;
    }
}

/* The row from `row` to before `beyond` in which a way ends that is as long as that row begins, or longer: by halves. */
static uint32_t row_by_halves(const dbo_backlash *op, const dbo_begin *way, uint32_t row, uint32_t beyond) {
    while (beyond - row > 1U) {
        const uint32_t middle = (row + beyond) / 2U;
        if (op->begins[middle].x <= way->x && op->begins[middle].y <= way->y)
            row = middle;
        else
            beyond = middle;
    }
    return row;
}

/* In which row a way ends that goes as far as gear `from` and not to gear `end`, which begins at `at`. */
static uint32_t last_row(const dbo_backlash *op, uint32_t from, uint32_t end, const dbo_begin *way, const dbo_begin *at) {
    const uint32_t first = row_of(op, from);
    uint32_t row, beyond;
    if (way->x >= at->x) return row_by_halves(op, way, first, row_of(op, end - 1U) + 1U); /* for want of room */
    row = op->guide[(uint32_t)(way->x >> op->part_shift)];
    beyond = op->guide[(uint32_t)(way->x >> op->part_shift) + 1U] + 1U;
    while (beyond - row > 1U) {
        const uint32_t middle = (row + beyond) / 2U;
        if (op->begins[middle].x <= way->x)
            row = middle;
        else
            beyond = middle;
    }
    return op->begins[row].y <= way->y ? row : row_by_halves(op, way, first, row);
}

/* The first of gears from ... end - 1 that is not crossed, or `end`, and where it begins (`at`; before: where `end`
 * does). Gear `from` is crossed; `way` begins where gear 0 would. */
PART uint32_t first_open(const dbo_backlash *op, uint32_t from, uint32_t end, const dbo_begin *way, dbo_begin *at) {
    const uint32_t row = last_row(op, from, end, way, at);
    const dbo_gear *gear = op->gears + row;
    const dbo_position up = way->y - op->begins[row].y + (gear->height >> op->tolerance);
    uint32_t count = fitting(way->x - op->begins[row].x + (gear->width >> op->tolerance), gear->width, op->half_run);
    if (times(count, gear->height) > up) count = fitting(up, gear->height, op->half_run);
    count += row * op->run;
    if (count < end) {
        find_begin(op, count, at);
        return count;
    }
    return end;
}

/* The farthest turn with a checkpoint to which the way to `u` and the room up to `bound` reach, or `depth` where they
 * reach to none: by halves. All gears below it are crossed, since something is left behind each of them. `behind` is
 * what is left there. */
PART uint32_t farthest_turn(const dbo_backlash *op, const dbo_backlash_state *state, dbo_position u, dbo_position bound,
                            int rising, dbo_begin *behind) {
    uint32_t far = 0U, near = state->depth / DBO_SPACING, turn = state->depth;
    while (far < near) {
        const uint32_t middle = (far + near) / 2U;
        const dbo_checkpoint *checkpoint = state->checkpoints + middle;
        dbo_begin at = {0, 0};
        if (rising) find_begin(op, state->turns[turn_of(middle)], &at);
        at.x = rising ? u - (checkpoint->x + at.x) : checkpoint->x - u;
        at.y = rising ? bound - (checkpoint->y + at.y) : checkpoint->y - bound;
        if (at.x >= 0 && at.y >= 0) {
            near = middle;
            turn = turn_of(middle);
            *behind = at;
        } else {
            far = middle + 1U;
        }
    }
    return turn;
}

/* Keep the end of the run above the lowest one, which ends at `next`. */
PART void add_turn(const dbo_backlash *op, dbo_backlash_state *state, uint32_t next, uint32_t end, int rising) {
    if (state->depth % DBO_SPACING == DBO_SPACING - 1U) {
        dbo_checkpoint *checkpoint = state->checkpoints + state->depth / DBO_SPACING;
        dbo_begin low = {0, 0}, high; /* of the ones: up to `next`, or from there to `end` */
        if (!rising) find_begin(op, next, &low);
        find_begin(op, rising ? next : end, &high);
        checkpoint->x = state->x - (high.x - low.x);
        checkpoint->y = state->y - (high.y - low.y);
    }
    state->turns[state->depth++] = (dbo_place)end;
}

/* Cross gears one way, (6)-(9), as long as the next one is crossed: the input `u` is far enough, and the output has
 * room up to `bound`. Returns the last one crossed, n where there is none. The next one is the first of the lowest run
 * that is open on this way: of the lowest of all, or of that above it; where it ends they melt into one. What is left
 * to travel falls with every gear crossed: below zero only behind one that is crossed by the tolerance, and no gear is
 * crossed after that. */
static uint32_t pass_gears(const dbo_backlash *op, dbo_backlash_state *state, dbo_position u,
                           dbo_position bound, int rising) {
    dbo_position left = rising ? u - state->x : state->x - u, room = rising ? bound - state->y : state->y - bound;
    uint32_t next = rising ? state->zero : state->set, depth = state->depth, end, last, single = SINGLE;
    int turned = next == 0U, searched = depth < DBO_SPACING;
    const dbo_gear *gear;
    if (next == op->n) return op->n;
    gear = gear_at(op, next);
    if (!crosses(op, gear, left - gear->width, room - gear->height)) return op->n;
    end = turned ? (rising ? state->set : state->zero) : state->turns[depth - 1U];
    if (left >= FAR * (dbo_position)gear->width) single = 0U;
    do {
        if (single == 0U && !searched) {
            dbo_begin behind = {0, 0};
            const uint32_t turn = farthest_turn(op, state, u, bound, rising, &behind);
            searched = 1;
            if (turn < depth) {
                const int melts = ((depth - turn) % 2U != 0U) != turned; /* into the run above the turn */
                depth = melts ? turn - 1U : turn;
                turned = 0;
                left = behind.x;
                room = behind.y;
                next = state->turns[depth];
                end = state->turns[depth - 1U];
                last = next - 1U;
                gear = gear_at(op, next);
                continue;
            }
        }
        if (single > 0U || next + 1U == end) {
            if (single > 0U) single--;
            left -= gear->width;
            room -= gear->height;
            next++;
        } else {
            dbo_begin way = {0, 0}, at;
            if (next > 0U) find_begin(op, next, &way);
            way.x += left;
            way.y += room;
            find_begin(op, end, &at);
            next = at.x <= way.x && at.y <= way.y ? end : first_open(op, next, end, &way, &at);
            left = way.x - at.x;
            room = way.y - at.y;
            if (next < end) {
                last = next - 1U;
                break;
            }
        }
        last = next - 1U;
        if (next == end) {
            if (!turned) depth--;
            turned = 0;
            next = depth > 0U ? state->turns[--depth] : op->n;
            end = depth > 0U ? state->turns[depth - 1U] : op->n;
            if (next == op->n) break;
        }
        gear = gear_at(op, next);
    } while (crosses(op, gear, left - gear->width, room - gear->height));
    state->x = rising ? u - left : u + left;
    state->y = rising ? bound - room : bound + room;
    state->depth = (dbo_place)depth;
    state->set = (dbo_place)(rising ? 0U : next);
    state->zero = (dbo_place)(rising ? next : 0U);
    if (turned) add_turn(op, state, next, end, rising);
    return last;
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

/* The gears stop flipping from the highest to the lowest, so the runs come as they stand on the stack. With those up
 * to i spanning low ... high, gear i stays 1 where the drive is as far from low as from high or farther. */
static void decay(const dbo_backlash *op, dbo_backlash_state *state, uint32_t covered, dbo_position target) {
    dbo_begin span;
    dbo_position low = 0, high, slack;
    uint32_t end = state->set;
    int ones = 0;
    find_begin(op, covered, &span);
    high = op->memory_on_output ? span.y : span.x;
    slack = high / 1048576; /* a tie, as with even gears halfway, stays 1 */
    for (uint32_t i = covered; i > 0U && target > 0; i--) {
        const dbo_gear *gear = gear_at(op, i - 1U);
        const int stays = target - low >= (high - target) - slack;
        if (stays)
            low += op->memory_on_output ? gear->height : gear->width;
        else
            high -= op->memory_on_output ? gear->height : gear->width;
        if (stays == ones) continue;
        ones = stays;
        if (i < end) {
            state->turns[state->depth++] = (dbo_place)end;
            end = i;
        } else if (state->depth > 0U) { /* a spare gear above is 1 */
            end = state->turns[--state->depth];
        }
    }
    state->set = (dbo_place)(ones ? 0U : end);
    state->zero = (dbo_place)(ones ? end : 0U);
    add_up(op, state);
}

void dbo_backlash_settle(const dbo_backlash *op, dbo_backlash_state *state, uint32_t covered,
                         const uint32_t *spare, dbo_signal drive) {
    const dbo_position place = position_of(drive, op->memory_on_output ? op->y_shift : op->x_shift);
    dbo_backlash_load(op, state, spare);
    decay(op, state, covered, place - (op->memory_on_output ? state->y : state->x));
    for (uint32_t j = 0U; j < op->term_count; j++) state->memory[j] = drive_of(op, place) * ((int64_t)1 << 24);
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
