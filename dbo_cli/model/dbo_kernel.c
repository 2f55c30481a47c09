/* See dbo_kernel.h. */
#include "dbo_kernel.h"

#define ENDLESS (1.0e300 * 1.0e300) /* infinity, without a header for it */

/* The state stays in registers only where these are inlined; left to choose, compilers do not. DBO_SMALL
 * leaves the choice to them, for less than half of the code. */
#if defined(DBO_SMALL)
#define INLINE static
#define GROUPED(op) 1
#elif defined(__GNUC__) || defined(__clang__)
#define INLINE static inline __attribute__((always_inline))
#elif defined(_MSC_VER)
#define INLINE static __forceinline
#else
#define INLINE static inline
#endif

#if !defined(GROUPED)
#define GROUPED(op) ((op)->run > 1)
#endif

/* ---- float64 numbers in 64-bit words ---------------------------------------------------------------- */

INLINE uint64_t bits_of(double value) {
    union {
        double value;
        uint64_t bits;
    } u;
    u.value = value;
    return u.bits;
}

/* The exponent, whatever the sign, with its offset. */
INLINE unsigned exponent_of(double value) { return (unsigned)(bits_of(value) << 1 >> 53); }

INLINE int is_nan(double value) { return value != value; } /* math.h has none without a library on some chips */

/* a >= b, of which one is not zero. Where float64 is software, whole numbers compare for a fifth of its instructions;
 * the bits of numbers below zero fall as the numbers rise. */
INLINE int at_least(double a, double b) {
#if defined(DBO_SOFT_DOUBLE) || (defined(__arm__) && !(defined(__ARM_FP) && (__ARM_FP & 8))) || \
    (defined(__riscv) && !(defined(__riscv_flen) && __riscv_flen >= 64)) || defined(__XTENSA__)
    const int64_t first = (int64_t)bits_of(a), second = (int64_t)bits_of(b);
    return (first < 0 ? first ^ INT64_MAX : first) >= (second < 0 ? second ^ INT64_MAX : second);
#else
    return a >= b;
#endif
}

/* ---- the table and the state ------------------------------------------------------------------------ */

/* The state on its way through a block, in registers; `grouped`, a constant where this is inlined, is 0 where each
 * gear has a row of its own. */
typedef struct {
    const dbo_backlash *op;
    int grouped;
    dbo_place *turns;
    dbo_checkpoint *checkpoints;
    size_t depth;
    size_t set;
    size_t zero;
    double x;
    double y;
} walk;

INLINE walk begin(const dbo_backlash *op, const dbo_backlash_state *state, int grouped) {
    walk w;
    w.op = op;
    w.grouped = grouped;
    w.turns = state->turns;
    w.checkpoints = state->checkpoints;
    w.depth = state->depth;
    w.set = state->set;
    w.zero = state->zero;
    w.x = state->x;
    w.y = state->y;
    return w;
}

INLINE void finish(const walk *w, dbo_backlash_state *state) {
    state->depth = w->depth;
    state->set = w->set;
    state->zero = w->zero;
    state->x = w->x;
    state->y = w->y;
}

INLINE size_t row_of(const dbo_backlash *op, size_t gear, int grouped) {
    return grouped ? (size_t)(((uint64_t)gear * op->row_factor) >> 32) : gear;
}

/* A point of the plane of input and output. */
typedef struct {
    double x;
    double y;
} point;

/* Where a gear begins with all gears below it crossed and no others; gear n where the last one ends. */
INLINE point begin_of(const dbo_backlash *op, size_t gear, int grouped) {
    const size_t row = row_of(op, gear, grouped);
    const dbo_gear *first = op->gears + row;
    point begin;
    begin.x = first->x;
    begin.y = first->y;
    if (grouped && gear != row * op->run) {
        const double before = (double)(int32_t)(gear - row * op->run);
        begin.x += before * first->dx;
        begin.y += before * first->dy;
    }
    return begin;
}

/* The turn of a checkpoint. */
INLINE size_t turn_of(size_t checkpoint) { return checkpoint * DBO_SPACING + DBO_SPACING - 1; }

/* X_B, Y_B and the checkpoints from the ends of the runs, from the highest run on. */
static void add_up(const dbo_backlash *op, dbo_backlash_state *state) {
    const size_t depth = state->depth, lowest = state->set > state->zero ? state->set : state->zero;
    int ones = (state->set == 0) == (depth % 2 == 0);
    point high = begin_of(op, op->n, 1);
    state->x = state->y = 0.0;
    for (size_t k = 1; k <= depth + 1; k++) {
        const size_t end = k == depth ? lowest : 0;
        const point low = begin_of(op, k < depth ? state->turns[k] : end, 1);
        if (ones) {
            state->x += high.x - low.x;
            state->y += high.y - low.y;
        }
        if (k < depth && k % DBO_SPACING == DBO_SPACING - 1) {
            state->checkpoints[k / DBO_SPACING].x = state->x;
            state->checkpoints[k / DBO_SPACING].y = state->y;
        }
        high = low;
        ones = !ones;
    }
}

INLINE int bit_of(const uint64_t *words, size_t gear) { return (int)(words[gear >> 6] >> (gear & 63) & 1); }

void dbo_backlash_load(const dbo_backlash *op, dbo_backlash_state *state, const uint64_t *words) {
    size_t end = op->n;
    int ones = words && bit_of(words, end - 1);
    state->depth = 0;
    for (size_t i = words ? end : 1; i-- > 1;) { /* from the highest place where a run may begin */
        if ((i & 63) == 0 && words[i / 64 - 1] == (ones ? UINT64_MAX : 0)) {
            i -= 63;
        } else if (bit_of(words, i - 1) != ones) {
            state->turns[state->depth++] = (dbo_place)end;
            end = i;
            ones = !ones;
        }
    }
    state->set = ones ? 0 : end;
    state->zero = ones ? end : 0;
    add_up(op, state);
}

void dbo_backlash_bits(const dbo_backlash *op, const dbo_backlash_state *state, uint64_t *words) {
    size_t depth = state->depth, i = 0, end = state->set > state->zero ? state->set : state->zero;
    int ones = state->set == 0;
    for (size_t k = 0; k < (op->n + 63) / 64; k++) words[k] = 0;
    for (;; ones = !ones) {
        while (i < end) { /* as much of a word as the run reaches over */
            const size_t stop = (i | 63) < end ? (i | 63) + 1 : end;
            const uint64_t part = UINT64_MAX << (i & 63) & UINT64_MAX >> (63 - ((stop - 1) & 63));
            if (ones) words[i >> 6] |= part;
            i = stop;
        }
        if (depth == 0) break;
        end = state->turns[--depth];
    }
}

/* ---- gears crossed one way, (6)-(9) ------------------------------------------------------------------ */

/* So many gears are crossed one by one before they are looked up, and a smooth drive seldom crosses more in a
 * sample; where 2^FAR times the next gear are left to travel, they are looked up at once. */
#define SINGLE 8
#define FAR 3

/* So many gears about the place where the way ends by the guide are asked whether they are crossed: where that is
 * cheap all at once, with no branch to foretell, else one. */
#if defined(DBO_SMALL)
#define ASKED 1 /* a gear */
#else
#define ASKED 4 /* gears; chosen: the guide is off by two at most where widths are alike */
#endif

/* What gears are crossed towards: the input `u`, as long as the output has room up to `bound`; both count from
 * (X_0, Y_0). kappa of the output is the memory's immediate part. What plays no part is infinite. */
typedef struct {
    double u;
    double kappa;
    double bound;
    const dbo_fixed_step *fixed;
} goal;

/* How much of the way is left at a point (without memory chips add nothing, where adding costs), and of the room. `plain` here and below: kappa is 0, and there is no
 * bound. */
INLINE double left_at(const goal *to, double x, double y, int rising, int plain) {
    const double d = to->u - (plain || (ASKED == 1 && to->kappa == 0.0) ? x : x + to->kappa * y);
    return rising ? d : -d;
}

INLINE double room_at(const goal *to, double y, int rising) { return rising ? to->bound - y : y - to->bound; }

/* Whether a gear is crossed from where so much is left of the way and of the room. */
INLINE int crosses(const walk *w, const goal *to, size_t gear, double left, double room, int plain) {
    const size_t row = row_of(w->op, gear, w->grouped);
    const dbo_gear *at = w->op->gears + row;
    if (plain) return at_least(left, at->dx * at->crossing_fraction);
    if (to->fixed) return at_least(left, to->fixed->gears[row].reach) && at_least(room, to->fixed->gears[row].room);
    return at_least(left, (at->dx + to->kappa * at->dy) * at->crossing_fraction) &&
           at_least(room, at->dy * at->crossing_fraction);
}

INLINE int crosses_next(const walk *w, const goal *to, size_t next, int rising, int plain) {
    return crosses(w, to, next, left_at(to, w->x, w->y, rising, plain), room_at(to, w->y, rising), plain);
}

/* Where a row begins along dx + kappa dy. */
INLINE double row_begin(const dbo_backlash *op, const goal *to, size_t row, int plain) {
    if (plain) return op->gears[row].x;
    return to->fixed ? to->fixed->gears[row].begin : op->gears[row].x + to->kappa * op->gears[row].y;
}

/* The row in which a way ends that is shorter than all gears: by halves. */
INLINE size_t row_by_halves(const dbo_backlash *op, const goal *to, double way, size_t rows, int plain) {
    size_t row = 0;
    while (rows - row > 1) {
        const size_t middle = row + (rows - row) / 2;
        if (at_least(way, row_begin(op, to, middle, plain)))
            row = middle;
        else
            rows = middle;
    }
    return row;
}

/* In which gear the way to the input ends, about: (x, y) is where gear 0 would begin. */
INLINE size_t guess(const walk *w, const goal *to, double x, double y, int rising, int plain) {
    const dbo_backlash *op = w->op;
    const size_t rows = row_of(op, op->n - 1, w->grouped) + 1;
    const double kappa = plain ? 0.0 : to->kappa, way = left_at(to, x, y, rising, plain);
    size_t row, before = 0;
    if (!op->guide) {
        row = row_by_halves(op, to, way, rows, plain);
    } else {
        const double whole = op->gears[rows].x + kappa * op->gears[rows].y;
        if (!(way < whole)) return op->n;
        if (!(way > 0.0)) return 0;
        if (!plain && to->fixed && to->fixed->guide)
            row = to->fixed->guide[(size_t)(way * to->fixed->parts_per_u)];
        else
            row = op->guide[(size_t)(plain ? way * op->parts_per_x : way / whole * (double)op->parts)];
    }
    if (w->grouped && op->run > 1) {
        const double gears =
            (way - row_begin(op, to, row, plain)) / (op->gears[row].dx + kappa * op->gears[row].dy);
        if (gears > 0.0) before = gears < (double)(int32_t)op->run ? (size_t)gears : op->run;
    }
    return row * op->run + before;
}

/* A gear, and the point where it begins on this way. */
typedef struct {
    size_t gear;
    double x;
    double y;
} landing;

/* The first of gears from ... end - 1 that is not crossed, or `end`. Gear `from` begins at (x, y) and is crossed. What
 * is left to travel, and the room, fall with every gear (dx + kappa dy is above 0 also where kappa is not): so the gears crossed are those up to one, and
 * any way to find it is right that asks that gear itself and the next. Where neither is below zero behind a gear, it
 * was crossed. */
INLINE landing first_open(const walk *w, const goal *to, size_t from, size_t end, const int rising, const int plain) {
    const dbo_backlash *op = w->op;
    const point begin = begin_of(op, from, w->grouped);
    const double x0 = rising ? w->x - begin.x : w->x + begin.x, y0 = rising ? w->y - begin.y : w->y + begin.y;
    size_t crossed = from, open = end, gear = from, asked = ASKED;
    landing at = {from, w->x, w->y};
    if (end - from > 1) gear = guess(w, to, x0, y0, rising, plain);
    if (gear > 0 && asked > 1) gear--;
    for (unsigned tries = 1; open - crossed > 1; tries++) {
        size_t count = 0;
        double left = 0.0, room = 0.0, gears;
        if (asked > open - crossed - 1) asked = open - crossed - 1;
        if (gear <= crossed) gear = crossed + 1;
        if (gear + asked > open) gear = open - asked;
        for (size_t k = 0; k < asked; k++) {
            const point place = begin_of(op, gear + k, w->grouped);
            at.x = rising ? x0 + place.x : x0 - place.x;
            at.y = rising ? y0 + place.y : y0 - place.y;
            left = left_at(to, at.x, at.y, rising, plain);
            room = room_at(to, at.y, rising);
            count += (size_t)crosses(w, to, gear + k, left, room, plain);
        }
        at.gear = gear + asked - 1;
        if (count > 0) crossed = gear + count - 1;
        if (count < asked) open = gear + count;
        if (ASKED == 1 && count == 0 && left >= 0.0 && (plain || room >= 0.0)) crossed = gear - 1;
        if (open - crossed <= 1) break;
        gear = crossed + (open - crossed) / 2; /* by halves where widths mislead */
        asked = 1;
        if (tries % 2 == 0) continue;
        {
            const dbo_gear *row = op->gears + row_of(op, at.gear, w->grouped);
            gears = left / (plain ? row->dx : row->dx + to->kappa * row->dy);
            if (!plain && room / row->dy < gears) gears = room / row->dy;
        }
        if (gears > 0.0)
            gear = gears < (double)(int32_t)(end - from) ? at.gear + (size_t)gears : open;
        else
            gear = -gears < (double)(int32_t)(at.gear - from) ? at.gear - (size_t)-gears - (ASKED == 1) : crossed;
        if (ASKED > 1 && gear > 0) gear--;
        asked = ASKED;
    }
    if (at.gear != open) {
        const point place = begin_of(op, open, w->grouped);
        at.gear = open;
        at.x = rising ? x0 + place.x : x0 - place.x;
        at.y = rising ? y0 + place.y : y0 - place.y;
    }
    return at;
}

/* The farthest turn with a checkpoint to which a way and the room reach, or `depth` where they reach to none: by
 * halves. All gears below it are crossed, since neither is below zero behind any of them. */
static size_t farthest_turn(const dbo_backlash *op, const dbo_place *turns, const dbo_checkpoint *checkpoints,
                            size_t depth, goal to, int rising, int plain) {
    size_t far = 0, near = depth / DBO_SPACING, turn = depth;
    while (far < near) {
        const size_t middle = far + (near - far) / 2;
        point at = {0.0, 0.0};
        if (rising) at = begin_of(op, turns[turn_of(middle)], 1);
        at.x += checkpoints[middle].x;
        at.y += checkpoints[middle].y;
        if (left_at(&to, at.x, at.y, rising, plain) >= 0.0 && (plain || room_at(&to, at.y, rising) >= 0.0)) {
            near = middle;
            turn = turn_of(middle);
        } else {
            far = middle + 1;
        }
    }
    return turn;
}

/* What the gears above `end` add to X_B and Y_B, where the lowest run ends at `next` and the one above it there. */
static dbo_checkpoint checkpoint_of(const dbo_backlash *op, double x, double y, size_t next, size_t end, int rising) {
    const point middle = begin_of(op, next, 1), high = begin_of(op, end, 1);
    dbo_checkpoint above;
    above.x = x - (rising ? middle.x : high.x - middle.x);
    above.y = y - (rising ? middle.y : high.y - middle.y);
    return above;
}

/* Gears to cross next: `next` to end - 1, a run that is open on this way. `turned`: it is the lowest of all, so the
 * state turns here. */
typedef struct {
    size_t next;
    size_t end;
    int turned;
} open_run;

/* Go to the farthest turn with a checkpoint that the way reaches, all at once; returns whether there is one. */
INLINE int jump(walk *w, const goal *to, open_run *run, const int rising, const int plain) {
    const size_t turn = farthest_turn(w->op, w->turns, w->checkpoints, w->depth, *to, rising, plain);
    const int reached = turn < w->depth;
    if (reached) {
        const int melts = ((w->depth - turn) % 2 != 0) != run->turned; /* into the run above the turn */
        const point begin = begin_of(w->op, w->turns[turn], w->grouped);
        w->x = w->checkpoints[turn / DBO_SPACING].x + (rising ? begin.x : 0.0);
        w->y = w->checkpoints[turn / DBO_SPACING].y + (rising ? begin.y : 0.0);
        w->depth = melts ? turn - 1 : turn;
        run->turned = 0;
        run->next = w->turns[w->depth];
        run->end = w->turns[w->depth - 1];
    }
    return reached;
}

INLINE void cross_one(walk *w, size_t gear, const int rising) {
    const dbo_gear *at = w->op->gears + row_of(w->op, gear, w->grouped);
    w->x += rising ? at->dx : -at->dx;
    w->y += rising ? at->dy : -at->dy;
}

/* The run is crossed: it melts with the one above, and the next open one lies above that. */
INLINE void melt(walk *w, open_run *run) {
    const size_t n = w->op->n;
    if (!run->turned) w->depth--;
    run->turned = 0;
    run->next = w->depth > 0 ? w->turns[--w->depth] : n;
    run->end = w->depth > 0 ? w->turns[w->depth - 1] : n;
}

/* The way ends within the lowest run of all: its end is one more turn. */
INLINE void add_turn(walk *w, const open_run *run, const int rising) {
    if (w->depth % DBO_SPACING == DBO_SPACING - 1)
        w->checkpoints[w->depth / DBO_SPACING] = checkpoint_of(w->op, w->x, w->y, run->next, run->end, rising);
    w->turns[w->depth++] = (dbo_place)run->end;
}

/* Cross gears one way as long as the next one is crossed; returns the last, n where there was none. With `column`,
 * every gear adds one to that of its group, or takes it away. */
INLINE size_t pass_gears(walk *w, const goal *to, const int rising, const int plain, double *column,
                         size_t group_size) {
    const size_t n = w->op->n;
    int landed = 0, searched = w->depth < DBO_SPACING || column;
    size_t last, single = SINGLE;
    open_run run;
    run.next = rising ? w->zero : w->set;
    run.turned = run.next == 0;
    if (run.next == n || !crosses_next(w, to, run.next, rising, plain)) return n;
    run.end = run.turned ? (rising ? w->set : w->zero) : w->turns[w->depth - 1];
    if (exponent_of(left_at(to, w->x, w->y, rising, plain)) >
        exponent_of(w->op->gears[row_of(w->op, run.next, w->grouped)].dx) + FAR)
        single = 0;
    do {
        if (single == 0 && !searched) {
            searched = 1;
            if (jump(w, to, &run, rising, plain)) {
                last = run.next - 1;
                continue;
            }
        }
        if (single > 0 || run.next + 1 == run.end || column) {
            if (column) column[run.next / group_size] += rising ? 1.0 : -1.0;
            cross_one(w, run.next++, rising);
            if (single > 0) single--;
        } else {
            const landing found = first_open(w, to, run.next, run.end, rising, plain);
            w->x = found.x;
            w->y = found.y;
            run.next = found.gear;
            landed = run.next < run.end;
        }
        last = run.next - 1;
        if (run.next == run.end) melt(w, &run);
    } while (!landed && run.next < n && crosses_next(w, to, run.next, rising, plain));
    if (run.turned) add_turn(w, &run, rising);
    w->set = rising ? 0 : run.next;
    w->zero = rising ? run.next : 0;
    return last;
}

/* ---- the procedure, steps 1 to 4 ------------------------------------------------------------------- */

/* The gear that is engaged above or below the state, kept in registers; at index n, where there is
 * none (f1(0) = f0(2^n - 1) = n), `reach` is the tolerance within which a sample stays at it. */
typedef struct {
    double reach;
    double slope;
} engaged;

INLINE engaged engage(const walk *w, size_t i) {
    const dbo_backlash *op = w->op;
    const dbo_gear *gear = op->gears + row_of(op, i, w->grouped); /* the row behind the last is like it */
    engaged e;
    e.reach = gear->dx * (i < op->n ? gear->crossing_fraction : 1.0 - gear->crossing_fraction);
    e.slope = i < op->n || op->extend ? gear->slope : 0.0;
    return e;
}

/* Samples that stay in the engaged gear and on one side of X_B; returns how many. Of two positive numbers
 * the greater has the greater bits, and every other number, its sign turned where the way is down, has
 * greater bits than `reach`: one comparison finds what leaves the gear either way. */
INLINE size_t run_within(const walk *w, engaged gear, int rising, double x0, double y0,
                         const double *x, double *y, size_t count) {
    const uint64_t turned = rising ? 0 : (uint64_t)1 << 63, reach = bits_of(gear.reach);
    const double start = w->x, height = w->y, slope = gear.slope;
    size_t k = 0;
    for (; k < count; k++) {
        const double d = (x[k] - x0) - start;
        if ((bits_of(d) ^ turned) >= reach) break;
        y[k] = y0 + (height + slope * d);
    }
    return k;
}

/* Steps 2 and 4: move while gears are crossed, one direction only for one sample, so that it always ends.
 * Returns the slope that serves the sample. One that crosses a gear by the tolerance falls short of the new
 * X_B and keeps that gear's own slope: an operator and its inverse then see the same fraction of the same
 * gear, and decide alike. */
INLINE double cross(walk *w, double u, engaged *up, engaged *down, const int rising) {
    const goal to = {u, 0.0, 0.0, 0};
    const size_t last = pass_gears(w, &to, rising, 1, 0, 1);
    const double d = u - w->x;
    *up = engage(w, w->zero);
    *down = engage(w, w->set);
    if (last < w->op->n && (rising ? d < 0.0 : d > 0.0))
        return w->op->gears[row_of(w->op, last, w->grouped)].slope;
    return rising ? up->slope : down->slope;
}

/* L_j after a sample of the remembered signal; returns sum c_j L_j. */
INLINE double remember(const dbo_backlash *op, double *memory, const double *a, double signal) {
    const double drive = signal - op->reference;
    double sum = 0.0;
    for (size_t j = 0; j < op->terms; j++) {
        memory[j] = a[j] * memory[j] + (1.0 - a[j]) * drive;
        sum += op->gain[j] * memory[j];
    }
    return sum;
}

/* No limits, and no memory on the output: the common case, with everything in registers. */
INLINE void run_forward(const dbo_backlash *op, dbo_backlash_state *state, const double *x, double *y,
                        size_t count, const double *decay, size_t decay_stride,
                        const int remembers, const int grouped) {
    walk w = begin(op, state, grouped);
    engaged up = engage(&w, w.zero), down = engage(&w, w.set);
    const double x0 = op->x0, y0 = op->y0;
    for (size_t k = 0, quiet = 0; k < count; k++, quiet++) {
        const double u = x[k] - x0, d = u - w.x;
        const int rising = d >= 0.0;
        double slope = rising ? up.slope : down.slope;
        if (rising ? d >= up.reach : -d >= down.reach) {
            slope = rising ? cross(&w, u, &up, &down, 1) : cross(&w, u, &up, &down, 0);
            quiet = 0;
        }
        if (remembers) {
            const double sum = remember(op, state->memory, decay + k * decay_stride, x[k]);
            y[k] = y0 + ((w.y + slope * (u - w.x)) + sum);
        } else {
            y[k] = y0 + (w.y + slope * (u - w.x));
            if (quiet > 1) /* worth it only where crossings are far apart */
                k += run_within(&w, rising ? up : down, rising, x0, y0, x + k + 1, y + k + 1, count - k - 1);
        }
    }
    if (count) state->last = y[count - 1];
    finish(&w, state);
}

/* ---- memory on the output, and limits on the output ------------------------------------------------- */

/* Drive the exchanged operator one way, to the relative output `y`, crossing gears by their dy. */
static void follow_output(walk *w, double y, int rising, const dbo_fixed_step *fixed) {
    const goal to = {rising ? ENDLESS : -ENDLESS, 0.0, y, fixed};
    (void)pass_gears(w, &to, rising, 0, 0, 1);
}

/* The relative output for the relative input `u`, `d` beyond that of the state, never crossing a gear that would
 * leave [low, high]. */
INLINE double solve(const dbo_backlash *op, walk *w, double u, double d, double kappa, double low, double high,
                    const dbo_fixed_step *fixed) {
    const int rising = d >= 0.0;
    const goal to = {u, kappa, rising ? high : low, fixed};
    const size_t last = rising ? pass_gears(w, &to, 1, 0, 0, 1) : pass_gears(w, &to, 0, 0, 0, 1);
    size_t next = rising ? w->zero : w->set;
    if (last < op->n) {
        d = u - (w->x + kappa * w->y);
        if (rising ? d < 0.0 : d > 0.0) next = last; /* crossed by the tolerance */
    }
    {
        const size_t row = row_of(op, next < op->n ? next : op->n - 1, w->grouped);
        const dbo_gear *gear = op->gears + row;
        const double slope = fixed ? fixed->gears[row].slope : gear->dy / (gear->dx + kappa * gear->dy);
        return next == op->n && !op->extend ? w->y : w->y + d * slope;
    }
}

/* The output within [low, high], the state that of the exchanged operator driven by it. */
INLINE double solve_within(const dbo_backlash *op, walk *w, double u, double kappa, double low,
                           double high, double slack, const dbo_fixed_step *fixed, int *clipped) {
    const double low_part = low - op->y0, high_part = high - op->y0;
    const double d = u - (w->x + kappa * w->y);
    double y;
    if (d >= 0.0 ? high_part < w->y : low_part > w->y) { /* the limits lie on the other side */
        follow_output(w, d >= 0.0 ? high_part : low_part, d < 0.0, fixed);
        *clipped = 1;
        return d >= 0.0 ? high : low;
    }
    y = op->y0 + solve(op, w, u, d, kappa, low_part, high_part, fixed);
    if (y > high) {
        *clipped = y - high > slack;
        if (d < 0.0) follow_output(w, high_part, 0, fixed);
        return high;
    }
    if (y < low) {
        *clipped = low - y > slack;
        if (d >= 0.0) follow_output(w, low_part, 1, fixed);
        return low;
    }
    return y;
}

/* last + step, rounded towards `last`: what the sum lost (two-sum, exact) tells which way it was rounded, and
 * one part in 2^52 is at least its last digit. A slew limit is then kept to the last bit. */
INLINE double towards(double last, double step) {
    const double sum = last + step, part = sum - last;
    const double lost = (last - (sum - part)) + (step - part);
    const double digit = (sum < 0.0 ? -sum : sum) * 2.220446049250313e-16;
    return step > 0.0 ? (lost < 0.0 ? sum - digit : sum) : (lost > 0.0 ? sum + digit : sum);
}

/* The limits of one sample, the largest change since the one before among them; the range wins. */
INLINE void window(const dbo_limits *limits, double step, double last, double *low, double *high) {
    const double least = towards(last, -step), most = towards(last, step);
    *low = least < limits->low ? limits->low : least > limits->high ? limits->high : least;
    *high = most > limits->high ? limits->high : most < limits->low ? limits->low : most;
}

/* One sample: what the memory still holds of the past, the gears for the rest, and the memory after it.
 * `rest` may be NULL: 1 - a_j is worked out here. */
INLINE double general_sample(const dbo_backlash *op, dbo_backlash_state *state, walk *w, double x,
                             const double *a, const double *rest, double kappa,
                             const dbo_fixed_step *fixed, const dbo_limits *limits, size_t k,
                             dbo_counts *counts) {
    double remembered = 0.0, u, y, drive;
    int clipped = 0;
    for (size_t j = 0; j < op->terms; j++) {
        state->memory[j] = a[j] * state->memory[j];
        remembered += op->gain[j] * state->memory[j];
    }
    u = ((x - op->x0) - remembered) - kappa * (op->y0 - op->reference);
    if (limits) {
        double low = limits->low, high = limits->high;
        if (limits->step && !is_nan(state->last))
            window(limits, limits->step[k * limits->step_stride], state->last, &low, &high);
        y = solve_within(op, w, u, kappa, low, high, limits->slack, fixed, &clipped);
    } else {
        y = op->y0 + solve(op, w, u, u - (w->x + kappa * w->y), kappa, -ENDLESS, ENDLESS, fixed);
    }
    if (clipped && counts && counts->clipped++ == 0) counts->first_clipped = k;
    drive = y - op->reference;
    for (size_t j = 0; j < op->terms; j++) state->memory[j] += (rest ? rest[j] : 1.0 - a[j]) * drive;
    state->last = y;
    return y;
}

dbo_fixed_step dbo_prepare_fixed_step(const dbo_backlash *op, const double *decay, double *rest,
                                      dbo_fixed_gear *gears, dbo_place *guide) {
    dbo_fixed_step fixed;
    const size_t rows = row_of(op, op->n - 1, 1) + 1;
    fixed.kappa = 0.0;
    fixed.decay = decay;
    fixed.rest = rest;
    fixed.gears = gears;
    for (size_t j = 0; j < op->terms; j++) {
        rest[j] = 1.0 - decay[j];
        fixed.kappa += op->gain[j] * rest[j];
    }
    for (size_t row = 0; row < rows; row++) {
        const dbo_gear *gear = op->gears + row;
        const double width = gear->dx + fixed.kappa * gear->dy;
        gears[row].reach = width * gear->crossing_fraction;
        gears[row].slope = gear->dy / width;
        gears[row].room = gear->dy * gear->crossing_fraction;
        gears[row].begin = gear->x + fixed.kappa * gear->y;
    }
    fixed.guide = guide;
    fixed.parts_per_u = (double)op->parts / (op->gears[rows].x + fixed.kappa * op->gears[rows].y);
    for (size_t part = 0, row = 0; guide && part <= op->parts; part++) {
        const double begin = (double)part / fixed.parts_per_u;
        while (row + 1 < rows && gears[row + 1].begin <= begin) row++;
        guide[part] = (dbo_place)row;
    }
    return fixed;
}

/* With `fixed`, a constant where this is inlined, all samples have its factors. */
INLINE void run_general(const dbo_backlash *op, const dbo_fixed_step *fixed, dbo_backlash_state *state,
                        const double *x, double *y, size_t count, const double *decay, size_t decay_stride,
                        const dbo_limits *limits, dbo_counts *counts, const int grouped) {
    walk w = begin(op, state, grouped);
    for (size_t k = 0; k < count; k++) {
        const double *a = decay + k * decay_stride;
        double kappa = fixed ? fixed->kappa : 0.0;
        for (size_t j = 0; !fixed && j < op->terms; j++) kappa += op->gain[j] * (1.0 - a[j]);
        y[k] = general_sample(op, state, &w, x[k], a, fixed ? fixed->rest : 0, kappa, fixed, limits, k, counts);
    }
    finish(&w, state);
}

void dbo_backlash_run_fixed(const dbo_backlash *op, const dbo_fixed_step *fixed,
                            dbo_backlash_state *state, const double *x, double *y, size_t count,
                            const dbo_limits *limits, dbo_counts *counts) {
    if (GROUPED(op))
        run_general(op, fixed, state, x, y, count, fixed->decay, 0, limits, counts, 1);
    else
        run_general(op, fixed, state, x, y, count, fixed->decay, 0, limits, counts, 0);
}

double dbo_backlash_step_fixed(const dbo_backlash *op, const dbo_fixed_step *fixed,
                               dbo_backlash_state *state, double x, const dbo_limits *limits,
                               dbo_counts *counts) {
    double y;
    dbo_backlash_run_fixed(op, fixed, state, &x, &y, 1, limits, counts);
    return y;
}

void dbo_backlash_run(const dbo_backlash *op, dbo_backlash_state *state, const double *x, double *y,
                      size_t count, const double *decay, size_t decay_stride,
                      const dbo_limits *limits, dbo_counts *counts) {
    if (limits || (op->terms && op->memory_on_output))
        run_general(op, 0, state, x, y, count, decay, decay_stride, limits, counts, 1);
    else if (op->terms && GROUPED(op))
        run_forward(op, state, x, y, count, decay, decay_stride, 1, 1);
    else if (op->terms)
        run_forward(op, state, x, y, count, decay, decay_stride, 1, 0);
    else if (GROUPED(op))
        run_forward(op, state, x, y, count, decay, decay_stride, 0, 1);
    else
        run_forward(op, state, x, y, count, decay, decay_stride, 0, 0);
}

double dbo_backlash_step(const dbo_backlash *op, dbo_backlash_state *state, double x,
                         const double *decay, const dbo_limits *limits, dbo_counts *counts) {
    double y;
    dbo_backlash_run(op, state, &x, &y, 1, decay, 0, limits, counts);
    return y;
}

void dbo_backlash_apply(const dbo_backlash *op, dbo_backlash_state *state, double y, const double *decay) {
    walk w = begin(op, state, 1);
    follow_output(&w, y - op->y0, y - op->y0 >= w.y, 0);
    remember(op, state->memory, decay, y);
    state->last = y;
    finish(&w, state);
}

/* ---- a state to begin with --------------------------------------------------------------------------- */

/* The gears stop flipping from the highest to the lowest. With those up to k spanning [low, high], gear k
 * stays 1 where the drive is as far from low as from high or farther; a tolerance decides a tie. So the runs come
 * from the highest on, as they stand on the stack. */
void dbo_backlash_decay(const dbo_backlash *op, dbo_backlash_state *state, size_t covered, const uint64_t *spare,
                        double drive) {
    double low = 0.0, high = begin_of(op, covered, 1).y, slack, target;
    size_t end;
    int ones = 0;
    dbo_backlash_load(op, state, spare);
    target = (drive - op->y0) - state->y;
    slack = 1e-9 * high;
    end = state->set;
    for (size_t i = covered; i > 0 && target > 0.0; i--) {
        const double height = op->gears[row_of(op, i - 1, 1)].dy;
        const int stays = target - low >= (high - target) - slack;
        if (stays)
            low += height;
        else
            high -= height;
        if (stays == ones) continue;
        ones = stays;
        if (i < end) {
            state->turns[state->depth++] = (dbo_place)end;
            end = i;
        } else if (state->depth > 0) { /* a spare gear above is 1 */
            end = state->turns[--state->depth];
        }
    }
    state->set = ones ? 0 : end;
    state->zero = ones ? end : 0;
    add_up(op, state);
    for (size_t j = 0; j < op->terms; j++) state->memory[j] = drive - op->reference;
    state->last = drive;
}

void dbo_backlash_settle(const dbo_backlash *op, dbo_backlash_state *state, size_t covered, const uint64_t *spare,
                         double drive) {
    walk w;
    dbo_backlash_decay(op, state, covered, spare, drive);
    w = begin(op, state, 1);
    follow_output(&w, drive - op->y0, drive - op->y0 >= w.y, 0);
    finish(&w, state);
}

/* ---- features for identification -------------------------------------------------------------------- */

/* Counts are whole numbers, so there is no drift. */
void dbo_backlash_engagement(const dbo_backlash *op, dbo_backlash_state *state, const double *x,
                             double *rows, double *crossed, size_t count, size_t group_size) {
    const size_t columns = (op->n + group_size - 1) / group_size;
    const double part = 1.0 / (double)group_size;
    walk w = begin(op, state, 1);
    for (size_t k = 0; k < count; k++, rows += columns) {
        const goal to = {x[k] - op->x0, 0.0, 0.0, 0};
        const int rising = to.u - w.x >= 0.0;
        const size_t last = rising ? pass_gears(&w, &to, 1, 1, crossed, group_size)
                                   : pass_gears(&w, &to, 0, 1, crossed, group_size);
        const double d = to.u - w.x;
        size_t gear = rising ? w.zero : w.set;
        if (last < op->n && (rising ? d < 0.0 : d > 0.0)) gear = last;
        for (size_t j = 0; j < columns; j++) rows[j] = crossed[j] * part;
        if (gear == op->n) {
            if (!op->extend) continue;
            gear = op->n - 1;
        }
        rows[gear / group_size] += d / op->gears[row_of(op, gear, 1)].dx * part;
    }
    finish(&w, state);
}

void dbo_memory_run(size_t terms, double reference, double *memory, const double *x, double *rows,
                    size_t count, const double *decay, size_t decay_stride) {
    for (size_t k = 0; k < count; k++) {
        const double *a = decay + k * decay_stride;
        const double drive = x[k] - reference;
        for (size_t j = 0; j < terms; j++) {
            memory[j] = a[j] * memory[j] + (1.0 - a[j]) * drive;
            rows[k * terms + j] = memory[j];
        }
    }
}

/* ---- the point operator (13)-(16) -------------------------------------------------------------------- */

/* The paper leaves a breakpoint to the segment found last; here it always begins the upper one, so that
 * the last bit of the output does not depend on the past either. The end segments extend. */
double dbo_point_step(const dbo_segment *segments, size_t m, double x0, double y0, size_t *segment,
                      double x) {
    const double u = x - x0;
    size_t c = *segment;
    while (c + 1 < m && u >= segments[c + 1].x) c++;
    while (c > 0 && u < segments[c].x) c--;
    *segment = c;
    return y0 + (segments[c].y + segments[c].slope * (u - segments[c].x));
}

void dbo_point_run(const dbo_segment *segments, size_t m, double x0, double y0, const double *x,
                   double *y, size_t count) {
    size_t c = 0, k = 0;
    while (k < count) {
        y[k] = dbo_point_step(segments, m, x0, y0, &c, x[k]);
        {
            const dbo_segment at = segments[c];
            const double low = c > 0 ? at.x : -ENDLESS, high = c + 1 < m ? segments[c + 1].x : ENDLESS;
            for (k++; k < count; k++) { /* samples that stay in the segment */
                const double u = x[k] - x0;
                if (!(u >= low && u < high)) break;
                y[k] = y0 + (at.y + at.slope * (u - at.x));
            }
        }
    }
}
