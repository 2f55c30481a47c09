/* See dbo_kernel.h. The readable twin of this file is kernel.py; both give the same bits. */
#include "dbo_kernel.h"

#define ALL_ONES UINT64_MAX

/* The state stays in registers only where these are inlined; left to choose, compilers do not. */
#if defined(__GNUC__) || defined(__clang__)
#define INLINE static inline __attribute__((always_inline))
#elif defined(_MSC_VER)
#define INLINE static __forceinline
#else
#define INLINE static inline
#endif

/* ---- find first set (4): the compiler's instruction, or de Bruijn as in the paper's reference [10] -- */

#if !defined(DBO_PORTABLE_SCAN) && (defined(__GNUC__) || defined(__clang__))
INLINE unsigned first_one(uint64_t word) { return (unsigned)__builtin_ctzll(word); }
#elif !defined(DBO_PORTABLE_SCAN) && defined(_MSC_VER) && defined(_WIN64)
#include <intrin.h>
INLINE unsigned first_one(uint64_t word) {
    unsigned long index;
    _BitScanForward64(&index, word);
    return (unsigned)index;
}
#else
/* The lowest one, alone, times a de Bruijn sequence leaves a different six-bit number on top for each
 * of the 64 places; the table, made from the sequence itself, turns it back into the place. */
INLINE unsigned first_one(uint64_t word) {
    static const unsigned char place[64] = {
        0,  1,  2,  53, 3,  7,  54, 27, 4,  38, 41, 8,  34, 55, 48, 28, 62, 5,  39, 46, 44, 42,
        22, 9,  24, 35, 59, 56, 49, 18, 29, 11, 63, 52, 6,  26, 37, 40, 33, 47, 61, 45, 43, 21,
        23, 58, 17, 10, 51, 25, 36, 32, 60, 20, 57, 16, 50, 31, 19, 15, 30, 14, 13, 12};
    return place[((word & (~word + 1)) * UINT64_C(0x022FDD63CC95386D)) >> 58];
}
#endif

/* ---- the state's bits, with one index level above: which words are full, which hold a one ----------- */

typedef struct {
    const dbo_gear *gears;
    size_t n;
    size_t word_count;
    uint64_t *words;
    uint64_t *full; /* bit k: word k is all ones */
    uint64_t *some; /* bit k: word k is not zero */
    size_t set;
    size_t zero;
    double x;
    double y;
} walk;

static size_t index_words(size_t n) { return ((n + 63) / 64 + 63) / 64; }

size_t dbo_backlash_words(size_t n) { return (n + 63) / 64 + 2 * index_words(n); }

/* Z (5) above word k, which has just become full; the words below it are full already. (The walk comes by
 * value: a pointer to it would keep it out of the registers.) */
static size_t zero_above(const walk w, size_t k) {
    w.full[k >> 6] |= (uint64_t)1 << (k & 63);
    for (size_t i = k >> 6; i < index_words(w.n); i++)
        if (w.full[i] != ALL_ONES) {
            k = 64 * i + first_one(~w.full[i]);
            return k < w.word_count ? 64 * k + first_one(~w.words[k]) : w.n;
        }
    return w.n;
}

/* S (4) above word k, which has just become zero; the words below it are zero already. */
static size_t one_above(const walk w, size_t k) {
    w.some[k >> 6] &= ~((uint64_t)1 << (k & 63));
    for (size_t i = k >> 6; i < index_words(w.n); i++)
        if (w.some[i] != 0) {
            k = 64 * i + first_one(w.some[i]);
            return 64 * k + first_one(w.words[k]);
        }
    return w.n;
}

/* To the upper neighbour: set b_Z (6)-(7). All lower bits are ones now, so S is 0 and the next Z lies
 * above the old one. A word can only leave zero at its lowest bit. */
INLINE void move_up(walk *w) {
    const size_t z = w->zero, k = z >> 6;
    const uint64_t word = w->words[k] | (uint64_t)1 << (z & 63);
    w->x += w->gears[z].dx;
    w->y += w->gears[z].dy;
    w->words[k] = word;
    if ((z & 63) == 0) w->some[k >> 6] |= (uint64_t)1 << (k & 63);
    w->set = 0;
    w->zero = word != ALL_ONES ? (z & ~(size_t)63) + first_one(~word) : zero_above(*w, k);
}

/* To the lower neighbour: clear b_S (8)-(9). All lower bits are zeros now, so Z is 0. A word can only
 * cease to be full at its lowest bit. */
INLINE void move_down(walk *w) {
    const size_t s = w->set, k = s >> 6;
    const uint64_t word = w->words[k] & ~((uint64_t)1 << (s & 63));
    w->x -= w->gears[s].dx;
    w->y -= w->gears[s].dy;
    w->words[k] = word;
    if ((s & 63) == 0) w->full[k >> 6] &= ~((uint64_t)1 << (k & 63));
    w->zero = 0;
    w->set = word != 0 ? (s & ~(size_t)63) + first_one(word) : one_above(*w, k);
}

INLINE walk begin(const dbo_backlash *op, const dbo_backlash_state *state) {
    walk w;
    w.gears = op->gears;
    w.n = op->n;
    w.word_count = (op->n + 63) / 64;
    w.words = state->words;
    w.full = w.words + w.word_count;
    w.some = w.full + index_words(op->n);
    w.set = state->set;
    w.zero = state->zero;
    w.x = state->x;
    w.y = state->y;
    return w;
}

INLINE void finish(const walk *w, dbo_backlash_state *state) {
    state->set = w->set;
    state->zero = w->zero;
    state->x = w->x;
    state->y = w->y;
}

void dbo_backlash_load(const dbo_backlash *op, dbo_backlash_state *state) {
    walk w = begin(op, state);
    w.x = w.y = 0.0;
    for (size_t i = 0; i < index_words(op->n); i++) w.full[i] = w.some[i] = 0;
    for (size_t k = 0; k < w.word_count; k++) {
        if (w.words[k] == ALL_ONES) w.full[k >> 6] |= (uint64_t)1 << (k & 63);
        if (w.words[k] != 0) w.some[k >> 6] |= (uint64_t)1 << (k & 63);
        for (uint64_t ones = w.words[k]; ones; ones &= ones - 1) {
            const dbo_gear *gear = op->gears + 64 * k + first_one(ones);
            w.x += gear->dx; /* exact, in any order: the widths lie on one binary grid */
            w.y += gear->dy;
        }
    }
    w.zero = w.words[0] != ALL_ONES ? first_one(~w.words[0]) : zero_above(w, 0);
    w.set = w.words[0] != 0 ? first_one(w.words[0]) : one_above(w, 0);
    finish(&w, state);
}

/* ---- the procedure, steps 1 to 4 ------------------------------------------------------------------- */

INLINE void note(size_t *counter, size_t *first, size_t index) {
    if ((*counter)++ == 0) *first = index;
}

/* The gear that is engaged above or below the state, kept in registers; at index n, where there is
 * none (f1(0) = f0(2^n - 1) = n), `reach` is the tolerance beyond which a sample counts as outside. */
typedef struct {
    double reach;
    double slope;
} engaged;

INLINE engaged engage(const dbo_backlash *op, size_t i) {
    engaged e;
    const dbo_gear *gear = op->gears + (i < op->n ? i : op->n - 1);
    e.reach = gear->dx * (i < op->n ? gear->keep : 1.0 - gear->keep);
    e.slope = i < op->n || op->extend ? gear->slope : 0.0;
    return e;
}

INLINE uint64_t bits_of(double value) {
    union {
        double value;
        uint64_t bits;
    } u;
    u.value = value;
    return u.bits;
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
INLINE double cross_up(const dbo_backlash *op, walk *w, double u, engaged *up, engaged *down,
                       engaged first, int *outside) {
    double slope = up->slope, d = u - w->x;
    while (w->zero < w->n && d >= up->reach) {
        slope = up->slope;
        move_up(w);
        *up = engage(op, w->zero);
        *down = first;
        d = u - w->x;
    }
    *outside = d >= up->reach;
    return d >= 0.0 ? up->slope : slope;
}

INLINE double cross_down(const dbo_backlash *op, walk *w, double u, engaged *up, engaged *down,
                         engaged first, int *outside) {
    double slope = down->slope, d = u - w->x;
    while (w->set < w->n && -d >= down->reach) {
        slope = down->slope;
        move_down(w);
        *down = engage(op, w->set);
        *up = first;
        d = u - w->x;
    }
    *outside = -d >= down->reach;
    return d <= 0.0 ? down->slope : slope;
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
                        size_t count, const double *decay, size_t decay_stride, dbo_counts *counts,
                        const int remembers) {
    walk w = begin(op, state);
    engaged up = engage(op, w.zero), down = engage(op, w.set);
    const engaged first = engage(op, 0);
    const double x0 = op->x0, y0 = op->y0;
    for (size_t k = 0, quiet = 0; k < count; k++, quiet++) {
        const double u = x[k] - x0, d = u - w.x;
        const int rising = d >= 0.0;
        double slope = rising ? up.slope : down.slope;
        if (rising ? d >= up.reach : -d >= down.reach) {
            int outside;
            slope = rising ? cross_up(op, &w, u, &up, &down, first, &outside)
                           : cross_down(op, &w, u, &up, &down, first, &outside);
            if (outside) note(&counts->outside, &counts->first_outside, k);
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

/* A gear with the memory's immediate share kappa of the output added to its width on the input. */
INLINE double wide(const dbo_gear *gear, double kappa) { return gear->dx + kappa * gear->dy; }

/* Drive the exchanged operator one way, to the relative output `y`, crossing gears by their dy. */
static void follow_output(walk *w, double y, int rising) {
    if (rising) {
        while (w->zero < w->n && y - w->y >= w->gears[w->zero].dy * w->gears[w->zero].keep) move_up(w);
    } else {
        while (w->set < w->n && w->y - y >= w->gears[w->set].dy * w->gears[w->set].keep) move_down(w);
    }
}

/* The relative output for the relative input `u`, never crossing a gear that would leave [low, high]. */
static double solve(const dbo_backlash *op, walk *w, double u, double kappa, double low, double high,
                    int *outside) {
    double d = u - (w->x + kappa * w->y);
    const int rising = d >= 0.0;
    size_t last = w->n, next;
    if (rising) {
        for (const dbo_gear *g; w->zero < w->n; d = u - (w->x + kappa * w->y)) {
            g = w->gears + w->zero;
            if (!(d >= wide(g, kappa) * g->keep && high - w->y >= g->dy * g->keep)) break;
            last = w->zero;
            move_up(w);
        }
        next = w->zero;
    } else {
        for (const dbo_gear *g; w->set < w->n; d = u - (w->x + kappa * w->y)) {
            g = w->gears + w->set;
            if (!(-d >= wide(g, kappa) * g->keep && w->y - low >= g->dy * g->keep)) break;
            last = w->set;
            move_down(w);
        }
        next = w->set;
    }
    if (last < w->n && (rising ? d < 0.0 : d > 0.0)) next = last; /* crossed by the tolerance */
    {
        const dbo_gear *gear = w->gears + (next < w->n ? next : w->n - 1);
        const double width = wide(gear, kappa);
        if (next < w->n) return w->y + d * (gear->dy / width);
        *outside = (rising ? d : -d) >= width * (1.0 - gear->keep);
        return op->extend ? w->y + d * (gear->dy / width) : w->y;
    }
}

/* The output within [low, high], the state that of the exchanged operator driven by it. */
static double solve_within(const dbo_backlash *op, walk *w, double u, double kappa, double low,
                           double high, double slack, int *outside, int *clipped) {
    const double low_part = low - op->y0, high_part = high - op->y0;
    const double d = u - (w->x + kappa * w->y);
    double y;
    if (d >= 0.0 ? high_part < w->y : low_part > w->y) { /* the limits lie on the other side */
        follow_output(w, d >= 0.0 ? high_part : low_part, d < 0.0);
        *clipped = 1;
        return d >= 0.0 ? high : low;
    }
    y = op->y0 + solve(op, w, u, kappa, low_part, high_part, outside);
    if (y > high) {
        *clipped = y - high > slack;
        if (d < 0.0) follow_output(w, high_part, 0);
        return high;
    }
    if (y < low) {
        *clipped = low - y > slack;
        if (d >= 0.0) follow_output(w, low_part, 1);
        return low;
    }
    return y;
}

static void run_general(const dbo_backlash *op, dbo_backlash_state *state, const double *x, double *y,
                        size_t count, const double *decay, size_t decay_stride,
                        const dbo_limits *limits, dbo_counts *counts) {
    walk w = begin(op, state);
    const double endless = 1.0e300 * 1.0e300;
    for (size_t k = 0; k < count; k++) {
        const double *a = decay + k * decay_stride;
        double kappa = 0.0, remembered = 0.0, u;
        int outside = 0, clipped = 0;
        for (size_t j = 0; j < op->terms; j++) {
            remembered += op->gain[j] * (a[j] * state->memory[j]);
            kappa += op->gain[j] * (1.0 - a[j]);
        }
        u = ((x[k] - op->x0) - remembered) - kappa * (op->y0 - op->reference);
        if (limits) {
            double low = limits->low, high = limits->high;
            if (limits->step && state->last == state->last) { /* the range wins over the slew limit */
                const double step = limits->step[k * limits->step_stride];
                const double least = state->last - step, most = state->last + step;
                low = least < low ? low : least > high ? high : least;
                high = most > limits->high ? limits->high : most < limits->low ? limits->low : most;
            }
            y[k] = solve_within(op, &w, u, kappa, low, high, limits->slack, &outside, &clipped);
        } else {
            y[k] = op->y0 + solve(op, &w, u, kappa, -endless, endless, &outside);
        }
        if (outside) note(&counts->outside, &counts->first_outside, k);
        if (clipped) note(&counts->clipped, &counts->first_clipped, k);
        remember(op, state->memory, a, y[k]);
        state->last = y[k];
    }
    finish(&w, state);
}

void dbo_backlash_run(const dbo_backlash *op, dbo_backlash_state *state, const double *x, double *y,
                      size_t count, const double *decay, size_t decay_stride,
                      const dbo_limits *limits, dbo_counts *counts) {
    if (limits || (op->terms && op->memory_on_output))
        run_general(op, state, x, y, count, decay, decay_stride, limits, counts);
    else if (op->terms)
        run_forward(op, state, x, y, count, decay, decay_stride, counts, 1);
    else
        run_forward(op, state, x, y, count, decay, decay_stride, counts, 0);
}

double dbo_backlash_step(const dbo_backlash *op, dbo_backlash_state *state, double x,
                         const double *decay, const dbo_limits *limits, dbo_counts *counts) {
    double y;
    dbo_backlash_run(op, state, &x, &y, 1, decay, 0, limits, counts);
    return y;
}

/* ---- features for identification -------------------------------------------------------------------- */

/* `crossed` counts the crossed gears of each column; counts are whole numbers, so there is no drift. */
void dbo_backlash_engagement(const dbo_backlash *op, dbo_backlash_state *state, const double *x,
                             double *rows, double *crossed, size_t count, size_t share) {
    const size_t columns = (op->n + share - 1) / share;
    const double part = 1.0 / (double)share;
    walk w = begin(op, state);
    for (size_t j = 0; j < columns; j++) crossed[j] = 0.0;
    for (size_t i = 0; i < op->n; i++)
        if (w.words[i >> 6] >> (i & 63) & 1) crossed[i / share] += 1.0;
    for (size_t k = 0; k < count; k++, rows += columns) {
        const double u = x[k] - op->x0;
        double d = u - w.x;
        const int rising = d >= 0.0;
        size_t last = op->n, gear;
        while (rising && w.zero < w.n && d >= engage(op, w.zero).reach) {
            last = w.zero;
            move_up(&w);
            crossed[last / share] += 1.0;
            d = u - w.x;
        }
        while (!rising && w.set < w.n && -d >= engage(op, w.set).reach) {
            last = w.set;
            move_down(&w);
            crossed[last / share] -= 1.0;
            d = u - w.x;
        }
        gear = rising ? w.zero : w.set;
        if (last < op->n && (rising ? d < 0.0 : d > 0.0)) gear = last;
        for (size_t j = 0; j < columns; j++) rows[j] = crossed[j] * part;
        if (gear == op->n) {
            if (!op->extend) continue;
            gear = op->n - 1;
        }
        rows[gear / share] += d / op->gears[gear].dx * part;
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
    size_t segment = 0;
    for (size_t k = 0; k < count; k++) y[k] = dbo_point_step(segments, m, x0, y0, &segment, x[k]);
}
