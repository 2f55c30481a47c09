/* See dbo_kernel.h. The readable twin of this file is kernel.py; both give the same bits. */
#include "dbo_kernel.h"

#define ALL_ONES UINT64_MAX
#define ENDLESS (1.0e300 * 1.0e300) /* infinity, without a header for it */

/* The state stays in registers only where these are inlined; left to choose, compilers do not. DBO_SMALL
 * leaves the choice to them and expects grouped tables, for less than half of the code. */
#if defined(DBO_SMALL)
#define INLINE static
#define EXPANDED_TABLES 0
#elif defined(__GNUC__) || defined(__clang__)
#define INLINE static inline __attribute__((always_inline))
#elif defined(_MSC_VER)
#define INLINE static __forceinline
#else
#define INLINE static inline
#endif
#ifndef EXPANDED_TABLES
#define EXPANDED_TABLES 1
#endif

/* Where float64 is software, sums and comparisons of whole numbers cost a tenth of its. The bits are the same. */
#if defined(DBO_SOFT_DOUBLE) || (defined(__arm__) && !(defined(__ARM_FP) && (__ARM_FP & 8))) || \
    (defined(__riscv) && !(defined(__riscv_flen) && __riscv_flen >= 64)) || defined(__XTENSA__)
#define SOFT_DOUBLE 1
#else
#define SOFT_DOUBLE 0
#endif

/* ---- find first set (4), and last: the compiler's instruction, or de Bruijn as in the paper's [10] ---- */

#if !defined(DBO_PORTABLE_SCAN) && (defined(__GNUC__) || defined(__clang__))
INLINE unsigned first_one(uint64_t word) { return (unsigned)__builtin_ctzll(word); }
INLINE unsigned last_one(uint64_t word) { return 63U - (unsigned)__builtin_clzll(word); }
#elif !defined(DBO_PORTABLE_SCAN) && defined(_MSC_VER) && defined(_WIN64)
#include <intrin.h>
INLINE unsigned first_one(uint64_t word) {
    unsigned long index;
    _BitScanForward64(&index, word);
    return (unsigned)index;
}
INLINE unsigned last_one(uint64_t word) {
    unsigned long index;
    _BitScanReverse64(&index, word);
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
INLINE unsigned last_one(uint64_t word) {
    for (unsigned reach = 1; reach < 64; reach *= 2) word |= word >> reach;
    return first_one(word ^ word >> 1);
}
#endif

/* ---- float64 numbers in 64-bit words ---------------------------------------------------------------- */

typedef union {
    double value;
    uint64_t bits;
} float64;

INLINE uint64_t bits_of(double value) {
    float64 u;
    u.value = value;
    return u.bits;
}

INLINE double number_of(uint64_t bits) {
    float64 u;
    u.bits = bits;
    return u.value;
}

/* The exponent, whatever the sign, with its offset. */
INLINE unsigned exponent_of(double value) { return (unsigned)(bits_of(value) << 1 >> 53); }

/* ---- the state's bits; above them which words are full, which hold a one, and each word's sums ------- */

/* Four sums for each word, float64 each: of all gears below it and of its own that are crossed, and of all
 * gears up to its end. They are exact, since all widths of an axis lie on one binary grid. */
enum { HERE_X, HERE_Y, END_X, END_Y, SUMS };

typedef struct {
    const dbo_gear *gears;
    size_t n;
    int grouped; /* a constant where this is inlined */
    size_t run;
    uint64_t row_factor;
    uint64_t *words;
    uint64_t *full; /* bit k: word k is all ones */
    uint64_t *some; /* bit k: word k is not zero */
    uint64_t *sums; /* SUMS for each word */
    size_t set;
    size_t zero;
    double x;
    double y;
    size_t at; /* the word crossed last: its sums are (x, y) less the rest; NOWHERE: all sums are kept */
    double rest_x;
    double rest_y;
} walk;

#define NOWHERE SIZE_MAX

static size_t index_words(size_t n) { return ((n + 63) / 64 + 63) / 64; }

size_t dbo_backlash_words(size_t n) { return (1 + SUMS) * ((n + 63) / 64) + 2 * index_words(n); }

INLINE size_t row_of(const walk *w, size_t gear) {
    return w->grouped || !EXPANDED_TABLES ? (size_t)(((uint64_t)gear * w->row_factor) >> 32) : gear;
}

/* Z (5) above word k, which has just become full; the words below it are full already. (The walk's members
 * come one by one: a pointer to it would keep it out of the registers.) */
static size_t zero_above(const uint64_t *words, uint64_t *full, size_t n, size_t k) {
    full[k >> 6] |= (uint64_t)1 << (k & 63);
    for (size_t i = k >> 6; i < index_words(n); i++)
        if (full[i] != ALL_ONES) {
            k = 64 * i + first_one(~full[i]);
            return 64 * k < n ? 64 * k + first_one(~words[k]) : n;
        }
    return n;
}

/* S (4) above word k, which has just become zero; the words below it are zero already. */
static size_t one_above(const uint64_t *words, uint64_t *some, size_t n, size_t k) {
    some[k >> 6] &= ~((uint64_t)1 << (k & 63));
    for (size_t i = k >> 6; i < index_words(n); i++)
        if (some[i] != 0) {
            k = 64 * i + first_one(some[i]);
            return 64 * k + first_one(words[k]);
        }
    return n;
}

/* A sum up to the end of the word below word k. */
INLINE uint64_t begin_of(const walk *w, size_t k, size_t which) {
    return k > 0 ? w->sums[SUMS * (k - 1) + which] : 0;
}

/* The sums of word k after `dx` and `dy` more of it have been crossed. */
INLINE void add_crossed(walk *w, size_t k, double dx, double dy) {
    uint64_t *sums = w->sums + SUMS * k;
    sums[HERE_X] = bits_of(number_of(sums[HERE_X]) + dx);
    sums[HERE_Y] = bits_of(number_of(sums[HERE_Y]) + dy);
}

/* Gears crossed one by one change only (x, y); the sums of their word follow when it is left. */
INLINE void leave_word(walk *w) {
    uint64_t *sums = w->sums + SUMS * w->at;
    if (w->at == NOWHERE) return;
    sums[HERE_X] = bits_of(w->x - w->rest_x);
    sums[HERE_Y] = bits_of(w->y - w->rest_y);
    w->at = NOWHERE;
}

INLINE void enter_word(walk *w, size_t k) {
    const uint64_t *sums = w->sums + SUMS * k;
    leave_word(w);
    w->rest_x = w->x - number_of(sums[HERE_X]);
    w->rest_y = w->y - number_of(sums[HERE_Y]);
    w->at = k;
}

/* To the upper neighbour: set b_Z (6)-(7), which is `gear`. All lower bits are ones now, so S is 0 and the
 * next Z lies above the old one. A word can only leave zero at its lowest bit. */
INLINE void move_up(walk *w, const dbo_gear *gear) {
    const size_t z = w->zero, k = z >> 6;
    const uint64_t word = w->words[k] | (uint64_t)1 << (z & 63);
    if (k != w->at) enter_word(w, k);
    w->x += gear->dx;
    w->y += gear->dy;
    w->words[k] = word;
    if ((z & 63) == 0) w->some[k >> 6] |= (uint64_t)1 << (k & 63);
    w->set = 0;
    w->zero = word != ALL_ONES ? (z & ~(size_t)63) + first_one(~word) : zero_above(w->words, w->full, w->n, k);
}

/* To the lower neighbour: clear b_S (8)-(9). All lower bits are zeros now, so Z is 0. A word can only
 * cease to be full at its lowest bit. */
INLINE void move_down(walk *w, const dbo_gear *gear) {
    const size_t s = w->set, k = s >> 6;
    const uint64_t word = w->words[k] & ~((uint64_t)1 << (s & 63));
    if (k != w->at) enter_word(w, k);
    w->x -= gear->dx;
    w->y -= gear->dy;
    w->words[k] = word;
    if ((s & 63) == 0) w->full[k >> 6] &= ~((uint64_t)1 << (k & 63));
    w->zero = 0;
    w->set = word != 0 ? (s & ~(size_t)63) + first_one(word) : one_above(w->words, w->some, w->n, k);
}

INLINE walk begin(const dbo_backlash *op, const dbo_backlash_state *state, int grouped) {
    walk w;
    w.grouped = grouped;
    w.gears = op->gears;
    w.n = op->n;
    w.run = op->run;
    w.row_factor = op->row_factor;
    w.words = state->words;
    w.full = w.words + (op->n + 63) / 64;
    w.some = w.full + index_words(op->n);
    w.sums = w.some + index_words(op->n);
    w.at = NOWHERE;
    w.rest_x = w.rest_y = 0.0;
    w.set = state->set;
    w.zero = state->zero;
    w.x = state->x;
    w.y = state->y;
    return w;
}

INLINE void finish(walk *w, dbo_backlash_state *state) {
    leave_word(w);
    state->set = w->set;
    state->zero = w->zero;
    state->x = w->x;
    state->y = w->y;
}

void dbo_backlash_load(const dbo_backlash *op, dbo_backlash_state *state) {
    walk w = begin(op, state, op->grouped);
    double end_x = 0.0, end_y = 0.0;
    w.x = w.y = 0.0;
    for (size_t i = 0; i < index_words(op->n); i++) w.full[i] = w.some[i] = 0;
    for (size_t k = 0; 64 * k < w.n; k++) {
        double crossed_x = 0.0, crossed_y = 0.0;
        w.sums[SUMS * k + HERE_X] = bits_of(end_x);
        w.sums[SUMS * k + HERE_Y] = bits_of(end_y);
        for (size_t i = 64 * k; i < 64 * (k + 1) && i < w.n; i++) {
            const dbo_gear *gear = op->gears + row_of(&w, i);
            const int crossed = (int)(w.words[k] >> (i & 63) & 1);
            end_x += gear->dx;
            end_y += gear->dy;
            if (!crossed) continue;
            crossed_x += gear->dx;
            crossed_y += gear->dy;
        }
        add_crossed(&w, k, crossed_x, crossed_y);
        w.sums[SUMS * k + END_X] = bits_of(end_x);
        w.sums[SUMS * k + END_Y] = bits_of(end_y);
        w.x += crossed_x;
        w.y += crossed_y;
        if (w.words[k] == ALL_ONES) w.full[k >> 6] |= (uint64_t)1 << (k & 63);
        if (w.words[k] != 0) w.some[k >> 6] |= (uint64_t)1 << (k & 63);
    }
    w.zero = w.words[0] != ALL_ONES ? first_one(~w.words[0]) : zero_above(w.words, w.full, w.n, 0);
    w.set = w.words[0] != 0 ? first_one(w.words[0]) : one_above(w.words, w.some, w.n, 0);
    finish(&w, state);
}

/* ---- many gears at once ------------------------------------------------------------------------------ */

/* Gears crossed one by one before words are: so many cost about as much as the way by words, and a smooth drive
 * seldom crosses more in a sample. Where what is left to travel is 2^FAR times the next gear, words come first. */
#define SINGLE 4
#define FAR 2

/* What gears are crossed towards: the input `u`, as long as the output has room up to `bound`; both count from
 * (X_0, Y_0). kappa of the output is the memory's immediate part. What plays no part is infinite. */
typedef struct {
    double u;
    double kappa;
    double bound;
    const dbo_fixed_gear *fixed;
} goal;

/* The input at (x, y). Without memory there is nothing to add: a branch costs less than that on small chips. */
INLINE double input_at(const goal *to, double x, double y, int plain) {
    return plain || (!EXPANDED_TABLES && to->kappa == 0.0) ? x : x + to->kappa * y;
}

/* a >= b, of which one is not zero. The bits of numbers below zero fall as the numbers rise. */
INLINE int at_least(double a, double b) {
#if SOFT_DOUBLE
    const int64_t first = (int64_t)bits_of(a), second = (int64_t)bits_of(b);
    return (first < 0 ? first ^ INT64_MAX : first) >= (second < 0 ? second ^ INT64_MAX : second);
#else
    return a >= b;
#endif
}

/* Whether the gear of a row is crossed from (x, y). `plain` here and below: kappa is 0, and there is no bound. */
INLINE int crosses(const walk *w, const goal *to, size_t row, double x, double y, int rising, int plain) {
    const dbo_gear *gear = w->gears + row;
    const double d = to->u - input_at(to, x, y, plain), travelled = rising ? d : -d;
    const double room = rising ? to->bound - y : y - to->bound;
    if (plain) return at_least(travelled, gear->dx * gear->crossing_fraction);
    if (to->fixed) return at_least(travelled, to->fixed[row].reach) && at_least(room, to->fixed[row].room);
    return at_least(travelled, (gear->dx + to->kappa * gear->dy) * gear->crossing_fraction) &&
           at_least(room, gear->dy * gear->crossing_fraction);
}

/* Whether (x, y) has surely not gone beyond the goal. */
INLINE int short_of(const goal *to, double x, double y, int rising, int plain) {
    const double at = input_at(to, x, y, plain);
    return (rising ? at_least(to->u, at) : at_least(at, to->u)) &&
           (plain || (rising ? at_least(to->bound, y) : at_least(y, to->bound)));
}

INLINE unsigned count_ones(uint64_t word) {
    word -= word >> 1 & UINT64_C(0x5555555555555555);
    word = (word & UINT64_C(0x3333333333333333)) + (word >> 2 & UINT64_C(0x3333333333333333));
    word = (word + (word >> 4)) & UINT64_C(0x0F0F0F0F0F0F0F0F);
    return (unsigned)((word * UINT64_C(0x0101010101010101)) >> 56);
}

/* Bits of a word, below place `end`, whose gears can still be crossed: zeros on the way up. */
INLINE uint64_t open_gears(uint64_t word, size_t end, int rising) {
    const uint64_t open = rising ? ~word : word;
    return end < 64 ? open & ~(ALL_ONES << end) : open;
}

/* A number for a length along an axis with which sums of widths are exact, and how many of up to 64 equal ones go
 * into another. `top` is the exponent of the axis' whole length. */
#if SOFT_DOUBLE
typedef int64_t span; /* in halves of the last digit of the whole; beyond 2^56 it is that, below zero it is zero */

static span span_of(double length, unsigned top) {
    const uint64_t bits = bits_of(length);
    const unsigned exponent = (unsigned)(bits >> 52); /* from 2048 on for numbers below zero */
    if (exponent >= 2048 || exponent + 61 < top) return 0;
    if (exponent > top + 2) return (span)1 << 56;
    return (span)(((bits << 12 >> 12 | (uint64_t)1 << 52) << 3) >> (top + 2 - exponent));
}

static double length_of(span number, unsigned top) {
    return (double)number * number_of((uint64_t)(top - 53) << 52);
}

static unsigned fitting(span reach, span width) {
    unsigned count = 0;
    for (unsigned half = 32; half > 0; half /= 2)
        if (reach >= (span)half * width) {
            reach -= (span)half * width;
            count += half;
        }
    return count;
}
#else
typedef double span;

INLINE span span_of(double length, unsigned top) {
    (void)top;
    return length;
}

INLINE double length_of(span number, unsigned top) { return span_of(number, top); }

INLINE unsigned fitting(span reach, span width) {
    const span count = reach / width;
    return count > 0.0 ? count < 64.0 ? (unsigned)count : 64U : 0U;
}
#endif

/* About which gears of word k are crossed from (x, y), not all of those open: what is left to travel is rounded
 * each time. Returns the bits of those that remain; x and y become exact. */
INLINE uint64_t about_crossed(const walk *w, const goal *to, size_t k, uint64_t open, double *x, double *y,
                              int rising, int plain) {
    const uint64_t *total = w->sums + SUMS * ((w->n - 1) >> 6);
    const unsigned top_x = exponent_of(number_of(total[END_X])), top_y = exponent_of(number_of(total[END_Y]));
    const double d = to->u - input_at(to, *x, *y, plain), up = to->bound - *y;
    const span room = span_of(rising ? up : -up, top_y);
    span left = span_of(rising ? d : -d, top_x), sum_x = 0, sum_y = 0;
    const int gapless = open == ALL_ONES << first_one(open);
    while (open != 0) {
        const size_t place = first_one(open), run = (size_t)(((uint64_t)(64 * k + place) * w->row_factor) >> 32);
        const size_t row = w->grouped || !EXPANDED_TABLES ? run : 64 * k + place;
        const size_t run_end = (run + 1) * w->run - 64 * k, end = run_end < 64 ? run_end : 64;
        const uint64_t beyond = end < 64 ? open & ALL_ONES << end : 0;
        const dbo_gear *gear = w->gears + row;
        const double reach =
            plain ? gear->dx : to->fixed ? to->fixed[row].reach : gear->dx + to->kappa * gear->dy;
        const span width = span_of(reach, top_x), dy = span_of(gear->dy, top_y);
        const unsigned side = (unsigned)(end - place), count = gapless ? side : count_ones(open ^ beyond);
        unsigned crossed = count;
        if (left < (span)count * width || (!plain && room - sum_y < (span)count * dy)) {
            const unsigned across = fitting(left, width), upward = plain ? across : fitting(room - sum_y, dy);
            crossed = across < upward ? across : upward;
        }
        left -= (span)crossed * width;
        sum_x += (span)crossed * (plain ? width : span_of(gear->dx, top_x));
        sum_y += (span)crossed * dy;
        if (crossed < count) {
            if (count == side)
                open &= ALL_ONES << (place + crossed);
            else
                for (; crossed > 0; crossed--) open &= open - 1;
            break;
        }
        open = beyond;
    }
    *x += length_of(rising ? sum_x : -sum_x, top_x);
    *y += length_of(rising ? sum_y : -sum_y, top_y);
    return open;
}

/* Cross gears of word k, not all of those open, from (x, y); returns the bits of those crossed. */
INLINE uint64_t pass_in_word(const walk *w, const goal *to, size_t k, const uint64_t open, double *x, double *y,
                             int rising, int plain) {
    const int about = SOFT_DOUBLE || w->run > 1; /* else each gear takes as long there as here */
    uint64_t left = about ? about_crossed(w, to, k, open, x, y, rising, plain) : open;
    int missed = 0;
    while (left != 0) { /* what rounding missed, one way and the other */
        const size_t row = row_of(w, 64 * k + first_one(left));
        if (!crosses(w, to, row, *x, *y, rising, plain)) break;
        *x += rising ? w->gears[row].dx : -w->gears[row].dx;
        *y += rising ? w->gears[row].dy : -w->gears[row].dy;
        left &= left - 1;
        missed = 1;
    }
    while (!missed && left != open) {
        const unsigned i = last_one(open ^ left);
        const size_t row = row_of(w, 64 * k + i);
        const double back_x = rising ? *x - w->gears[row].dx : *x + w->gears[row].dx;
        const double back_y = rising ? *y - w->gears[row].dy : *y + w->gears[row].dy;
        if (crosses(w, to, row, back_x, back_y, rising, plain)) break;
        *x = back_x;
        *y = back_y;
        left |= (uint64_t)1 << i;
    }
    return open ^ left;
}

/* All gears of words from ... end - 1 have been crossed. */
INLINE void mark_words(walk *w, size_t from, size_t end, int rising) {
    for (size_t k = from; k < end; k = (k | 63) + 1) {
        const uint64_t marked = open_gears(ALL_ONES << (k & 63), end - (k & ~(size_t)63), 0);
        w->full[k >> 6] = rising ? w->full[k >> 6] | marked : w->full[k >> 6] & ~marked;
        w->some[k >> 6] = rising ? w->some[k >> 6] | marked : w->some[k >> 6] & ~marked;
    }
}

/* Cross words from k on of which all gears are open, as many as end short of the goal; returns the next one. */
INLINE size_t pass_open_words(walk *w, const goal *to, size_t k, double *x, double *y, int rising, int plain) {
    const size_t words = (w->n + 63) / 64;
    const uint64_t other = (rising ? w->some[k >> 6] : ~w->full[k >> 6]) >> (k & 63);
    const size_t most = other != 0 ? first_one(other) : 64 - (k & 63);
    const size_t end = words - k < most ? words : k + most;
    const double begin_x = number_of(begin_of(w, k, END_X)), begin_y = number_of(begin_of(w, k, END_Y));
    const double from_x = rising ? *x - begin_x : *x + begin_x, from_y = rising ? *y - begin_y : *y + begin_y;
    size_t reached = k;
    for (size_t half = 32; half > 0 && reached < end; half /= 2) {
        const uint64_t *sums = w->sums + SUMS * (reached + half - 1);
        double far_x, far_y;
        if (half > end - reached) continue;
        far_x = rising ? from_x + number_of(sums[END_X]) : from_x - number_of(sums[END_X]);
        far_y = rising ? from_y + number_of(sums[END_Y]) : from_y - number_of(sums[END_Y]);
        if (!short_of(to, far_x, far_y, rising, plain)) continue;
        reached += half;
        *x = far_x;
        *y = far_y;
    }
    return reached;
}

/* All gears of word k are crossed that are `open`. */
INLINE void cross_word(walk *w, size_t k, uint64_t open, int rising) {
    uint64_t *sums = w->sums + SUMS * k;
    w->words[k] ^= open;
    sums[HERE_X] = rising ? sums[END_X] : begin_of(w, k, END_X);
    sums[HERE_Y] = rising ? sums[END_Y] : begin_of(w, k, END_Y);
}

/* Cross gears one way, (6)-(9), whole words where that is possible: what is left to travel, and the room, fall
 * with every crossing, rounding or not, so that all open gears of a word are crossed where its last one is; and
 * that one surely is where its far end is short of the goal. The next gear is known to be crossed. Returns the
 * gear crossed last. */
INLINE size_t pass_words(walk *w, const goal *to, const int rising, const int plain) {
    const size_t n = w->n, from = (rising ? w->zero : w->set) >> 6;
    size_t next = n, last = 0, k = from;
    uint64_t passed = 0;
    double x = w->x, y = w->y;
    leave_word(w);
    for (; 64 * k < n; k++) {
        const uint64_t *sums = w->sums + SUMS * k;
        uint64_t open = open_gears(w->words[k], n - 64 * k, rising);
        double far_x, far_y;
        if (open == 0) continue;
        if (!EXPANDED_TABLES && (rising ? w->words[k] == 0 : w->words[k] == ALL_ONES)) {
            const size_t end = pass_open_words(w, to, k, &x, &y, rising, plain);
            for (; k < end; k++) {
                last = k;
                passed = open_gears(w->words[k], n - 64 * k, rising);
                cross_word(w, k, passed, rising);
            }
            if (64 * k >= n) break;
            sums = w->sums + SUMS * k;
            open = open_gears(w->words[k], n - 64 * k, rising);
            if (open == 0) continue;
        }
        far_x = rising ? x + (number_of(sums[END_X]) - number_of(sums[HERE_X]))
                       : x - (number_of(sums[HERE_X]) - number_of(begin_of(w, k, END_X)));
        far_y = rising ? y + (number_of(sums[END_Y]) - number_of(sums[HERE_Y]))
                       : y - (number_of(sums[HERE_Y]) - number_of(begin_of(w, k, END_Y)));
        if (!short_of(to, far_x, far_y, rising, plain)) {
            const size_t row = row_of(w, 64 * k + last_one(open));
            const double dx = rising ? w->gears[row].dx : -w->gears[row].dx;
            const double dy = rising ? w->gears[row].dy : -w->gears[row].dy;
            if (!crosses(w, to, row, far_x - dx, far_y - dy, rising, plain)) break;
        }
        last = k;
        passed = open;
        cross_word(w, k, open, rising);
        x = far_x;
        y = far_y;
    }
    mark_words(w, from, k, rising);
    w->x = x;
    w->y = y;
    if (64 * k < n) {
        const uint64_t open = open_gears(w->words[k], n - 64 * k, rising);
        const uint64_t crossed = pass_in_word(w, to, k, open, &x, &y, rising, plain);
        next = 64 * k + first_one(open ^ crossed);
        if (crossed != 0) {
            last = k;
            passed = crossed;
            add_crossed(w, k, x - w->x, y - w->y);
            w->x = x;
            w->y = y;
            w->words[k] ^= crossed;
            if (rising)
                w->some[k >> 6] |= (uint64_t)1 << (k & 63);
            else
                w->full[k >> 6] &= ~((uint64_t)1 << (k & 63));
        }
    }
    w->set = rising ? 0 : next;
    w->zero = rising ? next : 0;
    return 64 * last + last_one(passed);
}

static size_t pass_words_plain(walk *w, double u, int rising) {
    const goal to = {u, 0.0, rising ? ENDLESS : -ENDLESS, 0};
    return rising ? pass_words(w, &to, 1, 1) : pass_words(w, &to, 0, 1);
}

static size_t pass_words_within(walk *w, const goal *to, int rising) {
    return rising ? pass_words(w, to, 1, 0) : pass_words(w, to, 0, 0);
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

INLINE engaged engage(const dbo_backlash *op, const walk *w, size_t i) {
    engaged e;
    const dbo_gear *gear = w->gears + row_of(w, i < w->n ? i : w->n - 1);
    e.reach = gear->dx * (i < w->n ? gear->crossing_fraction : 1.0 - gear->crossing_fraction);
    e.slope = i < w->n || op->extend ? gear->slope : 0.0;
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
INLINE double cross_up(const dbo_backlash *op, walk *w, double u, engaged *up, engaged *down,
                       engaged first, int *outside) {
    double slope = up->slope, d = u - w->x;
    size_t single = exponent_of(d) > exponent_of(up->reach) + FAR ? 0 : SINGLE;
    while (w->zero < w->n && d >= up->reach) {
        if (single-- == 0) {
            slope = engage(op, w, pass_words_plain(w, u, 1)).slope;
            single = SINGLE;
        } else {
            slope = up->slope;
            move_up(w, w->gears + row_of(w, w->zero));
        }
        *up = engage(op, w, w->zero);
        *down = first;
        d = u - w->x;
    }
    *outside = d >= up->reach;
    return d >= 0.0 ? up->slope : slope;
}

INLINE double cross_down(const dbo_backlash *op, walk *w, double u, engaged *up, engaged *down,
                         engaged first, int *outside) {
    double slope = down->slope, d = u - w->x;
    size_t single = exponent_of(d) > exponent_of(down->reach) + FAR ? 0 : SINGLE;
    while (w->set < w->n && -d >= down->reach) {
        if (single-- == 0) {
            slope = engage(op, w, pass_words_plain(w, u, 0)).slope;
            single = SINGLE;
        } else {
            slope = down->slope;
            move_down(w, w->gears + row_of(w, w->set));
        }
        *down = engage(op, w, w->set);
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
                        const int remembers, const int grouped) {
    walk w = begin(op, state, grouped);
    engaged up = engage(op, &w, w.zero), down = engage(op, &w, w.set);
    const engaged first = engage(op, &w, 0);
    const double x0 = op->x0, y0 = op->y0;
    for (size_t k = 0, quiet = 0; k < count; k++, quiet++) {
        const double u = x[k] - x0, d = u - w.x;
        const int rising = d >= 0.0;
        double slope = rising ? up.slope : down.slope;
        if (rising ? d >= up.reach : -d >= down.reach) {
            int outside;
            slope = rising ? cross_up(op, &w, u, &up, &down, first, &outside)
                           : cross_down(op, &w, u, &up, &down, first, &outside);
            if (outside && counts) note(&counts->outside, &counts->first_outside, k);
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

/* Whether some FAR gears like that of a row, which is crossed, fit into the way: as exponents tell, which is cheap. */
INLINE int far_off(const walk *w, const goal *to, size_t row) {
    const dbo_gear *gear = w->gears + row;
    const double reach = to->fixed ? to->fixed[row].reach : gear->dx + to->kappa * gear->dy;
    return exponent_of(to->u - input_at(to, w->x, w->y, 0)) > exponent_of(reach) + FAR &&
           exponent_of(to->bound - w->y) > exponent_of(gear->dy) + FAR;
}

/* Cross gears one way. Returns the gear crossed last, n where there was none. */
INLINE size_t pass_gears(walk *w, double u, double kappa, double bound, int rising,
                         const dbo_fixed_gear *fixed) {
    const goal to = {u, kappa, bound, fixed};
    size_t last = w->n, next = rising ? w->zero : w->set, single = SINGLE;
    while (next < w->n) {
        const size_t row = row_of(w, next);
        if (!crosses(w, &to, row, w->x, w->y, rising, 0)) break;
        if (last == w->n && far_off(w, &to, row)) single = 0;
        if (single-- == 0) return pass_words_within(w, &to, rising);
        last = next;
        if (rising)
            move_up(w, w->gears + row);
        else
            move_down(w, w->gears + row);
        next = rising ? w->zero : w->set;
    }
    return last;
}

/* Drive the exchanged operator one way, to the relative output `y`, crossing gears by their dy. */
static void follow_output(walk *w, double y, int rising, const dbo_fixed_gear *fixed) {
    pass_gears(w, rising ? ENDLESS : -ENDLESS, 0.0, y, rising, fixed);
}

/* The relative output for the relative input `u`, `d` beyond that of the state, never crossing a gear that would
 * leave [low, high]. */
INLINE double solve(const dbo_backlash *op, walk *w, double u, double d, double kappa, double low, double high,
                    const dbo_fixed_gear *fixed, int *outside) {
    const int rising = d >= 0.0;
    const size_t last = rising ? pass_gears(w, u, kappa, high, 1, fixed)
                               : pass_gears(w, u, kappa, low, 0, fixed);
    size_t next = rising ? w->zero : w->set;
    if (last < w->n) {
        d = u - (w->x + kappa * w->y);
        if (rising ? d < 0.0 : d > 0.0) next = last; /* crossed by the tolerance */
    }
    {
        const size_t row = row_of(w, next < w->n ? next : w->n - 1);
        const dbo_gear *gear = w->gears + row;
        const double slope = fixed ? fixed[row].slope : gear->dy / (gear->dx + kappa * gear->dy);
        if (next == w->n) {
            const double width = gear->dx + kappa * gear->dy;
            *outside = (rising ? d : -d) >= width * (1.0 - gear->crossing_fraction);
            if (!op->extend) return w->y;
        }
        return w->y + d * slope;
    }
}

/* The output within [low, high], the state that of the exchanged operator driven by it. */
INLINE double solve_within(const dbo_backlash *op, walk *w, double u, double kappa, double low,
                           double high, double slack, const dbo_fixed_gear *fixed, int *outside,
                           int *clipped) {
    const double low_part = low - op->y0, high_part = high - op->y0;
    const double d = u - (w->x + kappa * w->y);
    double y;
    if (d >= 0.0 ? high_part < w->y : low_part > w->y) { /* the limits lie on the other side */
        follow_output(w, d >= 0.0 ? high_part : low_part, d < 0.0, fixed);
        *clipped = 1;
        return d >= 0.0 ? high : low;
    }
    y = op->y0 + solve(op, w, u, d, kappa, low_part, high_part, fixed, outside);
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
                             const dbo_fixed_gear *fixed, const dbo_limits *limits, size_t k,
                             dbo_counts *counts) {
    double remembered = 0.0, u, y, drive;
    int outside = 0, clipped = 0;
    for (size_t j = 0; j < op->terms; j++) {
        state->memory[j] = a[j] * state->memory[j];
        remembered += op->gain[j] * state->memory[j];
    }
    u = ((x - op->x0) - remembered) - kappa * (op->y0 - op->reference);
    if (limits) {
        double low = limits->low, high = limits->high;
        if (limits->step && state->last == state->last)
            window(limits, limits->step[k * limits->step_stride], state->last, &low, &high);
        y = solve_within(op, w, u, kappa, low, high, limits->slack, fixed, &outside, &clipped);
    } else {
        y = op->y0 + solve(op, w, u, u - (w->x + kappa * w->y), kappa, -ENDLESS, ENDLESS, fixed, &outside);
    }
    if (outside && counts) note(&counts->outside, &counts->first_outside, k);
    if (clipped && counts) note(&counts->clipped, &counts->first_clipped, k);
    drive = y - op->reference;
    for (size_t j = 0; j < op->terms; j++) state->memory[j] += (rest ? rest[j] : 1.0 - a[j]) * drive;
    state->last = y;
    return y;
}

static void run_general(const dbo_backlash *op, dbo_backlash_state *state, const double *x, double *y,
                        size_t count, const double *decay, size_t decay_stride,
                        const dbo_limits *limits, dbo_counts *counts) {
    walk w = begin(op, state, op->grouped);
    for (size_t k = 0; k < count; k++) {
        const double *a = decay + k * decay_stride;
        double kappa = 0.0;
        for (size_t j = 0; j < op->terms; j++) kappa += op->gain[j] * (1.0 - a[j]);
        y[k] = general_sample(op, state, &w, x[k], a, 0, kappa, 0, limits, k, counts);
    }
    finish(&w, state);
}

dbo_fixed_step dbo_prepare_fixed_step(const dbo_backlash *op, const double *decay, double *rest,
                                      dbo_fixed_gear *gears) {
    dbo_fixed_step fixed;
    const size_t rows = op->grouped ? (op->n + op->run - 1) / op->run : op->n;
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
    }
    return fixed;
}

INLINE void run_at_fixed_step(const dbo_backlash *op, const dbo_fixed_step *fixed,
                              dbo_backlash_state *state, const double *x, double *y, size_t count,
                              const dbo_limits *limits, dbo_counts *counts, const int grouped) {
    walk w = begin(op, state, grouped);
    for (size_t k = 0; k < count; k++)
        y[k] = general_sample(op, state, &w, x[k], fixed->decay, fixed->rest, fixed->kappa, fixed->gears,
                              limits, k, counts);
    finish(&w, state);
}

void dbo_backlash_run_fixed(const dbo_backlash *op, const dbo_fixed_step *fixed,
                            dbo_backlash_state *state, const double *x, double *y, size_t count,
                            const dbo_limits *limits, dbo_counts *counts) {
    if (EXPANDED_TABLES && !op->grouped)
        run_at_fixed_step(op, fixed, state, x, y, count, limits, counts, 0);
    else
        run_at_fixed_step(op, fixed, state, x, y, count, limits, counts, 1);
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
    const int expanded = EXPANDED_TABLES && !op->grouped;
    if (limits || (op->terms && op->memory_on_output))
        run_general(op, state, x, y, count, decay, decay_stride, limits, counts);
    else if (op->terms && expanded)
        run_forward(op, state, x, y, count, decay, decay_stride, counts, 1, 0);
    else if (op->terms)
        run_forward(op, state, x, y, count, decay, decay_stride, counts, 1, 1);
    else if (expanded)
        run_forward(op, state, x, y, count, decay, decay_stride, counts, 0, 0);
    else
        run_forward(op, state, x, y, count, decay, decay_stride, counts, 0, 1);
}

double dbo_backlash_step(const dbo_backlash *op, dbo_backlash_state *state, double x,
                         const double *decay, const dbo_limits *limits, dbo_counts *counts) {
    double y;
    dbo_backlash_run(op, state, &x, &y, 1, decay, 0, limits, counts);
    return y;
}

void dbo_backlash_apply(const dbo_backlash *op, dbo_backlash_state *state, double y, const double *decay) {
    walk w = begin(op, state, op->grouped);
    follow_output(&w, y - op->y0, y - op->y0 >= w.y, 0);
    remember(op, state->memory, decay, y);
    state->last = y;
    finish(&w, state);
}

/* ---- two states that are nearly the same --------------------------------------------------------------- */

size_t dbo_backlash_touched(const dbo_backlash *op, const dbo_backlash_state *state) {
    const size_t words = (op->n + 63) / 64, gear = state->set > state->zero ? state->set : state->zero;
    return gear / 64 + 1 < words ? gear / 64 + 1 : words;
}

void dbo_backlash_copy(const dbo_backlash *op, dbo_backlash_state *to, const dbo_backlash_state *from,
                       size_t touched) {
    const size_t words = (op->n + 63) / 64, indices = 2 * index_words(op->n);
    uint64_t *held = to->words;
    double *memory = to->memory;
    for (size_t k = 0; k < touched; k++) held[k] = from->words[k];
    for (size_t k = words; k < words + indices + SUMS * touched; k++) held[k] = from->words[k];
    for (size_t j = 0; j < op->terms; j++) memory[j] = from->memory[j];
    *to = *from;
    to->words = held;
    to->memory = memory;
}

/* ---- a state to begin with --------------------------------------------------------------------------- */

/* The gears stop flipping from the highest to the lowest. With those up to k spanning [low, high], gear k
 * stays 1 where the drive is as far from low as from high or farther; a tolerance decides a tie. */
void dbo_backlash_settle(const dbo_backlash *op, dbo_backlash_state *state, size_t covered,
                         const uint64_t *spare, double drive) {
    const int on_output = op->memory_on_output;
    const double place = drive - (on_output ? op->y0 : op->x0);
    double low = 0.0, high = 0.0, slack, target;
    walk w;
    for (size_t k = 0; k < (op->n + 63) / 64; k++) state->words[k] = spare ? spare[k] : 0;
    dbo_backlash_load(op, state);
    w = begin(op, state, op->grouped);
    target = place - (on_output ? w.y : w.x);
    for (size_t i = 0; i < covered; i++) {
        const dbo_gear *gear = op->gears + row_of(&w, i);
        high += on_output ? gear->dy : gear->dx;
    }
    slack = 1e-9 * high;
    for (size_t i = covered; i-- > 0 && target > 0.0;) {
        const dbo_gear *gear = op->gears + row_of(&w, i);
        const double width = on_output ? gear->dy : gear->dx;
        if (target - low >= (high - target) - slack) {
            state->words[i >> 6] |= (uint64_t)1 << (i & 63);
            low += width;
        } else {
            high -= width;
        }
    }
    for (size_t j = 0; j < op->terms; j++) state->memory[j] = drive - op->reference;
    state->last = drive;
    dbo_backlash_load(op, state);
    w = begin(op, state, op->grouped);
    if (on_output) {
        follow_output(&w, place, place >= w.y, 0);
    } else {
        const int rising = place >= w.x;
        pass_gears(&w, place, 0.0, rising ? ENDLESS : -ENDLESS, rising, 0);
    }
    finish(&w, state);
}

/* ---- features for identification -------------------------------------------------------------------- */

/* `crossed` counts the crossed gears of each column; counts are whole numbers, so there is no drift. */
void dbo_backlash_engagement(const dbo_backlash *op, dbo_backlash_state *state, const double *x,
                             double *rows, double *crossed, size_t count, size_t group_size) {
    const size_t columns = (op->n + group_size - 1) / group_size;
    const double part = 1.0 / (double)group_size;
    walk w = begin(op, state, op->grouped);
    for (size_t j = 0; j < columns; j++) crossed[j] = 0.0;
    for (size_t i = 0; i < op->n; i++)
        if (w.words[i >> 6] >> (i & 63) & 1) crossed[i / group_size] += 1.0;
    for (size_t k = 0; k < count; k++, rows += columns) {
        const double u = x[k] - op->x0;
        double d = u - w.x;
        const int rising = d >= 0.0;
        size_t last = op->n, gear = rising ? w.zero : w.set;
        while (gear < w.n) {
            const engaged next = engage(op, &w, gear);
            if (!((rising ? d : -d) >= next.reach)) break;
            last = gear;
            if (rising)
                move_up(&w, w.gears + row_of(&w, gear));
            else
                move_down(&w, w.gears + row_of(&w, gear));
            crossed[last / group_size] += rising ? 1.0 : -1.0;
            gear = rising ? w.zero : w.set;
            d = u - w.x;
        }
        if (last < op->n && (rising ? d < 0.0 : d > 0.0)) gear = last;
        for (size_t j = 0; j < columns; j++) rows[j] = crossed[j] * part;
        if (gear == op->n) {
            if (!op->extend) continue;
            gear = op->n - 1;
        }
        rows[gear / group_size] += d / w.gears[row_of(&w, gear)].dx * part;
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
