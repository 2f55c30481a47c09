/* The recursions of the Discrete Backlash Operator and the Discrete Point Operator.
 *
 * C99, no allocation, no library calls: the fast path of the Python package and, unchanged, firmware.
 * Source: Y. N. Aye and W. T. Ang, "A Discrete Backlash Operator for Identification and Compensation
 * of Hysteresis and Non-linearity for Piezoelectric Actuator" (2018); (1) to (18) are its equations.
 *
 * The caller keeps every array. Widths of one axis must be whole multiples of one power of two small
 * enough for their sum to be exact (the package rounds them so, by at most 2^-53 of the sum), and none
 * less than 2^-42 of that sum; then
 * X_B and Y_B, kept up to date by adding and subtracting, equal (2)-(3) exactly and for ever, and a sum
 * over gears side by side is a difference of two numbers of the table: how many gears are crossed in one step
 * is looked up, not counted, whatever their widths.
 * Compile without floating-point contraction and without fast-math; IEEE 754 float64 is assumed.
 */
#ifndef DBO_KERNEL_H
#define DBO_KERNEL_H

#include <stddef.h>
#include <stdint.h>

/* The index of a gear, and n. DBO_PLACE: a smaller type that holds them, where there is little memory. */
#if !defined(DBO_PLACE)
#define DBO_PLACE uint32_t
#endif
#if !defined(DBO_SPACING)
#define DBO_SPACING 64 /* turns that share a checkpoint; chosen: 0.25 bytes a gear */
#endif
typedef DBO_PLACE dbo_place;

/* A row of the table stands for `run` equal gears side by side: a column of (10), its slope dy/dx, the fraction
 * of it that counts as crossed, and where the first of them begins, with all gears below it crossed and no
 * others: (X_B - X_0, Y_B - Y_0). */
typedef struct {
    double dx;
    double dy;
    double slope;
    double crossing_fraction;
    double x;
    double y;
} dbo_gear;

#define DBO_ROW_FACTOR(run) ((((uint64_t)1 << 32) + (uint64_t)(run) - 1) / (uint64_t)(run))

/* A backlash operator: never written to. Without relaxation terms = 0 and gain may be NULL.
 * The last run may be shorter, and one more row stands behind it, which begins where the last gear ends and is
 * else like the last. n * run must be less than 2^32.
 * `guide`, if not NULL, cuts the range of the input into equal parts, and says in which row each begins and the last
 * one ends: parts + 1 numbers. Nothing but time depends on it. */
typedef struct {
    const dbo_gear *gears;
    size_t n;
    size_t run;
    uint64_t row_factor; /* DBO_ROW_FACTOR(run), to divide by `run` by multiplying */
    const dbo_place *guide;
    size_t parts;
    double parts_per_x;
    double x0;
    double y0;
    int extend;           /* outside the range: 1 goes on with the slope of gear n-1, 0 holds Y_B */
    size_t terms;         /* relaxation terms L_j beside the gears */
    const double *gain;   /* c_j, one per term; those below 0 must leave something of every slope of the forward gears */
    double reference;     /* the value of the remembered axis at which nothing is remembered */
    int memory_on_output; /* 0: L_j follows the input (forward); 1: it follows the output (inverse) */
} dbo_backlash;

/* What the gears above a turn add to X_B - X_0 and to Y_B - Y_0. */
typedef struct {
    double x;
    double y;
} dbo_checkpoint;

/* The state. Its bits are runs of ones and zeros, since a move changes the lowest first, and the ends of the runs
 * are a stack: going on changes the lowest end, turning adds one, and a run that is crossed melts into the next.
 * The lowest run ends at S or Z, the greater of the two, and those above it at turns[depth - 1], turns[depth - 2]
 * and so on, the highest at n. Every DBO_SPACING-th turn has a checkpoint: a move that wipes out many turns looks up
 * there how far it goes. A step writes to `turns` and `checkpoints` at `depth` alone: a copy of the structure, with
 * memory of its own, may share them and be dropped.
 * Point `turns` to n places, `checkpoints` to (n - 1) / DBO_SPACING and `memory` to its own, fill the memory, and call
 * dbo_backlash_load. */
typedef struct {
    dbo_place *turns;
    dbo_checkpoint *checkpoints;
    double *memory; /* L_j, one per term */
    size_t depth;
    size_t set;     /* S (4) */
    size_t zero;    /* Z (5) */
    double last;    /* the output before, for the slew limit; NaN where there is none */
    double x;       /* X_B - X_0 (2) */
    double y;       /* Y_B - Y_0 (3) */
} dbo_backlash_state;

/* Limits on the output; where they bind, the state is that of the operator with exchanged axes driven
 * by the clipped output. Not for memory on the input. */
typedef struct {
    double low;
    double high;
    double slack;       /* a sample counts as clipped when clipping moved it by more than this */
    const double *step; /* largest change since the sample before; NULL: no such limit */
    size_t step_stride; /* 0: one number for all samples, 1: one for each */
} dbo_limits;

/* What a fixed time between samples makes constant for memory or limits on the output: per row of the
 * table the input width dx + kappa dy, with kappa = sum c_j (1 - a_j), that counts as crossed; the slope
 * dy / (dx + kappa dy); the output's part that counts as crossed; and where the row begins along dx + kappa dy. */
typedef struct {
    double reach;
    double slope;
    double room;
    double begin;
} dbo_fixed_gear;

typedef struct {
    double kappa;
    const double *decay; /* a_j = exp(-dt/tau_j), one per term */
    const double *rest;  /* 1 - a_j */
    const dbo_fixed_gear *gears;
    const dbo_place *guide; /* as that of the operator, along dx + kappa dy; NULL: that of the operator serves */
    double parts_per_u;
} dbo_fixed_step;

/* Samples that limits clipped; add to it over as many runs as you like. Indices are relative to the run. */
typedef struct {
    size_t clipped;
    size_t first_clipped;
} dbo_counts;

/* One segment of a point operator: its start relative to (X_0, Y_0), (13)-(14), and its slope. */
typedef struct {
    double x;
    double y;
    double slope;
} dbo_segment;

/* The state B (1) from its (n + 63) / 64 words of bits, bit i % 64 of word i / 64 being b_i; NULL: B = 0. */
void dbo_backlash_load(const dbo_backlash *op, dbo_backlash_state *state, const uint64_t *words);

/* The other way. */
void dbo_backlash_bits(const dbo_backlash *op, const dbo_backlash_state *state, uint64_t *words);

/* The state of an actuator that has been switched on and trimmed to `drive` and rests there: after an
 * oscillation of the drive that decays to it from the whole range of gears 0 to `covered` - 1, while others
 * stay as `spare` has them (words of bits; NULL: open). The drive is the output: of an inverse operator alone.
 * Fills all of the state; `turns` and `memory` must be in place. */
void dbo_backlash_settle(const dbo_backlash *op, dbo_backlash_state *state, size_t covered,
                         const uint64_t *spare, double drive);

/* Its gears alone, and nothing of a drive that goes on to `drive`: they leave some of the way to it. */
void dbo_backlash_decay(const dbo_backlash *op, dbo_backlash_state *state, size_t covered, const uint64_t *spare,
                        double drive);

/* One input, one output. `decay` has one factor exp(-dt/tau_j) per term (all zero: at rest at this
 * sample); `limits` and `counts` may be NULL. */
double dbo_backlash_step(const dbo_backlash *op, dbo_backlash_state *state, double x,
                         const double *decay, const dbo_limits *limits, dbo_counts *counts);

/* The output was `y`, whatever was asked for: the state of the operator with exchanged axes driven by it. As
 * for limits: not for memory on the input. */
void dbo_backlash_apply(const dbo_backlash *op, dbo_backlash_state *state, double y, const double *decay);

/* `count` inputs; `y` may be `x`. Row k of `decay` begins at decay + k*decay_stride (stride 0: the same
 * for all samples). */
void dbo_backlash_run(const dbo_backlash *op, dbo_backlash_state *state, const double *x, double *y,
                      size_t count, const double *decay, size_t decay_stride,
                      const dbo_limits *limits, dbo_counts *counts);

/* Fill `rest` (one per term), `gears` (one per row of the table) and `guide` (parts + 1, or NULL) and return them with
 * `decay`. */
dbo_fixed_step dbo_prepare_fixed_step(const dbo_backlash *op, const double *decay, double *rest,
                                      dbo_fixed_gear *gears, dbo_place *guide);

/* As dbo_backlash_run and dbo_backlash_step at a fixed time step, the same bits with less work: for
 * operators with limits or with memory on the output. */
void dbo_backlash_run_fixed(const dbo_backlash *op, const dbo_fixed_step *fixed,
                            dbo_backlash_state *state, const double *x, double *y, size_t count,
                            const dbo_limits *limits, dbo_counts *counts);

double dbo_backlash_step_fixed(const dbo_backlash *op, const dbo_fixed_step *fixed,
                               dbo_backlash_state *state, double x, const dbo_limits *limits,
                               dbo_counts *counts);

/* Rows phi with Y_B part of the output = sum phi_i dy_i; with `group_size` > 1 that many neighbours share
 * one column, their mean. `rows` is count x ceil(n/group_size), `crossed` has how many gears of each column are crossed. */
void dbo_backlash_engagement(const dbo_backlash *op, dbo_backlash_state *state, const double *x,
                             double *rows, double *crossed, size_t count, size_t group_size);

/* L_j after each sample, rows of `terms` numbers: L = a L + (1 - a)(x - reference). */
void dbo_memory_run(size_t terms, double reference, double *memory, const double *x, double *rows,
                    size_t count, const double *decay, size_t decay_stride);

/* (13)-(16); `segment` is C, the segment found last, any valid one to begin with. */
double dbo_point_step(const dbo_segment *segments, size_t m, double x0, double y0, size_t *segment,
                      double x);

void dbo_point_run(const dbo_segment *segments, size_t m, double x0, double y0, const double *x,
                   double *y, size_t count);

#endif
