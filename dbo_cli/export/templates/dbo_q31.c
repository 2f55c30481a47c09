/* See dbo_q31.h. */
#include "dbo_q31.h"

#include <stddef.h>

/* So many gears are crossed one by one before they are looked up; where FAR times the next one is left to travel, they
 * are looked up at once. */
#define SINGLE 2U
#define FAR 4

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

/* ---- whole numbers ----------------------------------------------------------------------------------- */

#define FARTHEST ((dboq_position)1 << 60) /* beyond every position, and a difference of two fits 64 bits */

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

int32_t dboq_counts_of(int64_t value, uint32_t shift) {
    return (int32_t)within(scaled_down(value, shift), INT32_MIN, INT32_MAX);
}

/* slope x way / 2^shift; a way beyond 32 bits, outside of the gears, loses its last 16 bits first. */
static dboq_signal along(dboq_number slope, dboq_position way, uint32_t shift) {
    if (way >= INT32_MIN && way <= INT32_MAX) return scaled_down((int64_t)slope * way, shift);
    return scaled_down((int64_t)slope * within(scaled_down(way, 16U), INT32_MIN, INT32_MAX), shift - 16U);
}

/* ---- memories ---------------------------------------------------------------------------------------- */

/* The remembered signal as the memories hold it. */
static int64_t drive_of(const dboq_backlash *op, dboq_position value) {
    return within((int64_t)dboq_counts_of(value, op->drive_shift) + op->drive_offset, INT32_MIN, INT32_MAX);
}

/* What the memories add up to, in positions. */
static dboq_position recalled(const dboq_backlash *op, const dboq_memory *memory) {
    int64_t sum = 0;
    for (uint32_t j = 0U; j < op->term_count; j++)
        sum += (int64_t)op->terms[j].carried * (int32_t)floored(memory[j], 24U);
    return scaled_down(sum, op->carried_shift);
}

static void remember(const dboq_backlash *op, dboq_memory *memory, int64_t drive) {
    for (uint32_t j = 0U; j < op->term_count; j++) {
        const int64_t way = drive - floored(memory[j], 24U);
        memory[j] += floored(way * op->terms[j].rest, op->terms[j].rest_shift - 24U);
    }
}

/* ---- the table and the state ------------------------------------------------------------------------- */

static uint32_t row_of(const dboq_backlash *op, uint32_t gear) { return (gear * op->row_factor) >> op->row_shift; }

static const dboq_gear *gear_at(const dboq_backlash *op, uint32_t gear) { return op->gears + row_of(op, gear); }

/* count x width; in halves of 16 bits on a Cortex-M0+, which has no product of 64 bits. */
static dboq_position times(uint32_t count, int32_t width) {
#if THUMB_1
    const uint32_t high = count * ((uint32_t)width >> 16), low = count * ((uint32_t)width & 0xFFFFU);
    return (dboq_position)(((uint64_t)high << 16) + low);
#else
    return (dboq_position)((uint64_t)count * (uint32_t)width);
#endif
}

/* Where a gear begins with all gears below it crossed and no others; gear n where the last one ends. */
PART void find_begin(const dboq_backlash *op, uint32_t gear, dboq_begin *begin) {
    const uint32_t row = row_of(op, gear), before = gear - row * op->run;
    begin->x = op->begins[row].x;
    begin->y = op->begins[row].y;
    if (before > 0U) {
        begin->x += times(before, op->gears[row].width);
        begin->y += times(before, op->gears[row].height);
    }
}

/* The turn of a checkpoint. */
static uint32_t turn_of(uint32_t checkpoint) { return checkpoint * DBOQ_SPACING + DBOQ_SPACING - 1U; }

/* X_B, Y_B and the checkpoints from the ends of the runs, from the highest run on. */
static void add_up(const dboq_backlash *op, dboq_backlash_state *state) {
    const uint32_t depth = state->depth, lowest = state->set > state->zero ? state->set : state->zero;
    int ones = (state->set == 0U) == (depth % 2U == 0U);
    dboq_begin low, high;
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
        if (k < depth && k % DBOQ_SPACING == DBOQ_SPACING - 1U) {
            state->checkpoints[k / DBOQ_SPACING].x = state->x;
            state->checkpoints[k / DBOQ_SPACING].y = state->y;
        }
        high = low;
        ones = !ones;
    }
}

static int bit_of(const uint32_t *words, uint32_t gear) { return (int)(words[gear >> 5] >> (gear & 31U) & 1U); }

void dboq_backlash_load(const dboq_backlash *op, dboq_backlash_state *state, const uint32_t *words) {
    uint32_t end = op->n;
    int ones = words != NULL && bit_of(words, end - 1U);
    state->depth = 0U;
    for (uint32_t i = words != NULL ? end - 1U : 0U; i > 0U; i--) { /* from the highest place where a run may begin */
        if (bit_of(words, i - 1U) == ones) continue;
        state->turns[state->depth++] = (dboq_place)end;
        end = i;
        ones = !ones;
    }
    state->set = (dboq_place)(ones ? 0U : end);
    state->zero = (dboq_place)(ones ? end : 0U);
    add_up(op, state);
}

/* ---- the procedure, steps 1 to 4 --------------------------------------------------------------------- */

/* Whether a gear is crossed, where `left` and `room` are what would remain behind it. */
static int crosses(const dboq_backlash *op, const dboq_gear *gear, dboq_position left, dboq_position room) {
    if (left >= 0 && room >= 0) return 1;
    return left + (gear->width >> op->tolerance) >= 0 && room + (gear->height >> op->tolerance) >= 0;
}

/* How many gears of one width go into a way, below 2 x half, a power of two: by halves. */
static uint32_t fitting(dboq_position way, int32_t width, uint32_t half) {
    dboq_position wide = times(half, width);
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
static uint32_t row_by_halves(const dboq_backlash *op, const dboq_begin *way, uint32_t row, uint32_t beyond) {
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
static uint32_t last_row(const dboq_backlash *op, uint32_t from, uint32_t end, const dboq_begin *way, const dboq_begin *at) {
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
PART uint32_t first_open(const dboq_backlash *op, uint32_t from, uint32_t end, const dboq_begin *way, dboq_begin *at) {
    const uint32_t row = last_row(op, from, end, way, at);
    const dboq_gear *gear = op->gears + row;
    const dboq_position up = way->y - op->begins[row].y + (gear->height >> op->tolerance);
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
PART uint32_t farthest_turn(const dboq_backlash *op, const dboq_backlash_state *state, dboq_position u, dboq_position bound,
                            int rising, dboq_begin *behind) {
    uint32_t far = 0U, near = state->depth / DBOQ_SPACING, turn = state->depth;
    while (far < near) {
        const uint32_t middle = (far + near) / 2U;
        const dboq_checkpoint *checkpoint = state->checkpoints + middle;
        dboq_begin at = {0, 0};
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
PART void add_turn(const dboq_backlash *op, dboq_backlash_state *state, uint32_t next, uint32_t end, int rising) {
    if (state->depth % DBOQ_SPACING == DBOQ_SPACING - 1U) {
        dboq_checkpoint *checkpoint = state->checkpoints + state->depth / DBOQ_SPACING;
        dboq_begin low = {0, 0}, high; /* of the ones: up to `next`, or from there to `end` */
        if (!rising) find_begin(op, next, &low);
        find_begin(op, rising ? next : end, &high);
        checkpoint->x = state->x - (high.x - low.x);
        checkpoint->y = state->y - (high.y - low.y);
    }
    state->turns[state->depth++] = (dboq_place)end;
}

/* Cross gears one way, (6)-(9), as long as the next one is crossed: the input `u` is far enough, and the output has
 * room up to `bound`. Returns the last one crossed, n where there is none. The next one is the first of the lowest run
 * that is open on this way: of the lowest of all, or of that above it; where it ends they melt into one. What is left
 * to travel falls with every gear crossed: below zero only behind one that is crossed by the tolerance, and no gear is
 * crossed after that. */
static uint32_t pass_gears(const dboq_backlash *op, dboq_backlash_state *state, dboq_position u,
                           dboq_position bound, int rising) {
    dboq_position left = rising ? u - state->x : state->x - u, room = rising ? bound - state->y : state->y - bound;
    uint32_t next = rising ? state->zero : state->set, depth = state->depth, end, last, single = SINGLE;
    int turned = next == 0U, searched = depth < DBOQ_SPACING;
    const dboq_gear *gear;
    if (next == op->n) return op->n;
    gear = gear_at(op, next);
    if (!crosses(op, gear, left - gear->width, room - gear->height)) return op->n;
    end = turned ? (rising ? state->set : state->zero) : state->turns[depth - 1U];
    if (left >= FAR * (dboq_position)gear->width) single = 0U;
    do {
        if (single == 0U && !searched) {
            dboq_begin behind = {0, 0};
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
            dboq_begin way = {0, 0}, at;
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
    state->depth = (dboq_place)depth;
    state->set = (dboq_place)(rising ? 0U : next);
    state->zero = (dboq_place)(rising ? next : 0U);
    if (turned) add_turn(op, state, next, end, rising);
    return last;
}

/* Drive the operator with exchanged axes one way, to the output `y`. */
static void follow_output(const dboq_backlash *op, dboq_backlash_state *state, dboq_position y, int rising) {
    (void)pass_gears(op, state, rising ? FARTHEST : -FARTHEST, y, rising);
}

/* The output for the input `u`, never crossing a gear that would leave low ... high. */
static dboq_position solve(const dboq_backlash *op, dboq_backlash_state *state, dboq_position u, dboq_position low,
                          dboq_position high) {
    const int rising = u >= state->x;
    const uint32_t last = pass_gears(op, state, u, rising ? high : low, rising);
    uint32_t next = rising ? state->zero : state->set;
    const dboq_position d = u - state->x;
    if (last < op->n && (rising ? d < 0 : d > 0)) next = last; /* crossed by the tolerance */
    return state->y + along(gear_at(op, next < op->n ? next : op->n - 1U)->slope, d, op->slope_shift);
}

/* The output within low ... high, the state that of the exchanged operator driven by it. */
static dboq_position solve_within(const dboq_backlash *op, dboq_backlash_state *state, dboq_position u,
                                 dboq_position low, dboq_position high) {
    const int rising = u >= state->x;
    dboq_position y;
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

dboq_position dboq_backlash_step(const dboq_backlash *op, dboq_backlash_state *state, dboq_signal u,
                               const dboq_limits *limits) {
    dboq_position low = limits->low, high = limits->high, x = u, y;
    if (op->term_count > 0U) x -= recalled(op, state->memory);
    if (limits->step >= 0) { /* the range wins over the slew limit */
        const dboq_position least = state->last - limits->step, most = state->last + limits->step;
        low = least < low ? low : least > high ? high : least;
        high = most > high ? high : most < limits->low ? limits->low : most;
    }
    y = solve_within(op, state, within(x, op->least, op->most), low, high);
    state->last = y;
    if (op->term_count > 0U) remember(op, state->memory, drive_of(op, y));
    return y;
}

/* The gears stop flipping from the highest to the lowest, so the runs come as they stand on the stack. With those up
 * to i spanning low ... high, gear i stays 1 where the drive is as far from low as from high or farther. */
static void decay(const dboq_backlash *op, dboq_backlash_state *state, uint32_t covered, dboq_position target) {
    dboq_begin span;
    dboq_position low = 0, high, slack;
    uint32_t end = state->set;
    int ones = 0;
    find_begin(op, covered, &span);
    high = span.y;
    slack = high / 1048576; /* a tie, as with even gears halfway, stays 1 */
    for (uint32_t i = covered; i > 0U && target > 0; i--) {
        const dboq_gear *gear = gear_at(op, i - 1U);
        const int stays = target - low >= (high - target) - slack;
        if (stays)
            low += gear->height;
        else
            high -= gear->height;
        if (stays == ones) continue;
        ones = stays;
        if (i < end) {
            state->turns[state->depth++] = (dboq_place)end;
            end = i;
        } else if (state->depth > 0U) { /* a spare gear above is 1 */
            end = state->turns[--state->depth];
        }
    }
    state->set = (dboq_place)(ones ? 0U : end);
    state->zero = (dboq_place)(ones ? end : 0U);
    add_up(op, state);
}

void dboq_backlash_settle(const dboq_backlash *op, dboq_backlash_state *state, uint32_t covered,
                         const uint32_t *spare, dboq_signal drive) {
    dboq_backlash_load(op, state, spare);
    decay(op, state, covered, drive - state->y);
    for (uint32_t j = 0U; j < op->term_count; j++) state->memory[j] = drive_of(op, drive) * ((int64_t)1 << 24);
    follow_output(op, state, drive, drive >= state->y);
    state->last = drive;
}

/* ---- points and scales, folded into one piecewise linear function ------------------------------------ */

dboq_signal dboq_segments_step(const dboq_segment *segments, uint32_t count, uint32_t shift,
                             uint32_t *segment, dboq_number u) {
    uint32_t c = *segment;
    if ((c + 1U < count && u >= segments[c + 1U].x) || (c > 0U && u < segments[c].x)) {
        uint32_t beyond = count;
        c = 0U;
        while (c + 1U < beyond) { /* by halves: a jump costs little more than a step */
            const uint32_t middle = (c + beyond) / 2U;
            if (u >= segments[middle].x)
                c = middle;
            else
                beyond = middle;
        }
    }
    *segment = c;
    return segments[c].y + along(segments[c].slope, (dboq_position)u - segments[c].x, shift);
}
