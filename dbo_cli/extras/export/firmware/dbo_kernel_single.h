/* The Discrete Backlash Operator at a fixed time step in float32 or in 32-bit fixed point.
 *
 * C99, no allocation, no recursion, no library calls. The procedure is that of the float64 kernel of the
 * package, step by step; here positions along either axis are relative to (X_0, Y_0), the memory's
 * immediate part kappa of the output is in the gears' widths already, and everything that a fixed time step
 * makes constant is a table. (1) to (18) are the equations of Aye and Ang (2018).
 *
 * Positions along either axis are whole numbers, so that (2)-(3) hold exactly and for ever: a range is 2^30
 * counts, and a count some 2^10 positions; memories are whole, too. DBO_Q31: all other numbers are whole as
 * well; a product is 32 x 32 to 64 bits, and what goes beyond the range saturates. DBO_FLOAT: slopes, points
 * and what goes in and out are float32.
 */
#ifndef DBO_KERNEL_H
#define DBO_KERNEL_H

#include <stdint.h>

/* The arithmetic is chosen by whoever includes this: DBO_FLOAT or DBO_Q31. */

typedef int64_t dbo_position; /* along the input or the output axis */
typedef int64_t dbo_memory;   /* L_j in 2^-24 of its count: with less, slow memories would stand still */

#if defined(DBO_Q31)
typedef int32_t dbo_number;   /* what goes in and comes out, and factors */
typedef int64_t dbo_signal;   /* what points and scales give: positions */
#else
typedef float dbo_number;
typedef float dbo_signal; /* counts */
#endif

typedef struct {
    int32_t width;    /* on the input, kappa x height included */
    int32_t height;   /* on the output */
    dbo_number slope; /* height / width; q31: times 2^slope_shift */
} dbo_gear;

/* One relaxation term: factors times 2 to the power of their shift, which those carried share. */
typedef struct {
    int32_t carried; /* c_j a_j where memory follows the output, c_j where it follows the input */
    int32_t rest;    /* 1 - a_j */
    uint32_t rest_shift;
} dbo_term;

/* The index of a gear, and n: DBO_PLACE is as small a type as holds them. */
typedef DBO_PLACE dbo_place;

/* Where a row begins with all gears below it crossed and no others: (X_B - X_0, Y_B - Y_0). */
typedef struct {
    dbo_position x;
    dbo_position y;
} dbo_begin;

/* A backlash operator. Gear i stands in row (i * row_factor) >> row_shift: one row for a run of equal gears. */
typedef struct {
    const dbo_gear *gears;
    const dbo_begin *begins; /* one a row, and where the last gear ends */
    const dbo_place *guide;  /* in which row each part of the input's range begins; a part is 2^part_shift positions */
    uint32_t part_shift;
    uint32_t n;
    uint32_t run; /* equal gears that share a row */
    uint32_t half_run; /* the greatest power of two that is no greater */
    uint32_t row_factor;
    uint32_t row_shift;
    uint32_t tolerance; /* a gear counts as crossed when all but 2^-tolerance of it is travelled */
    const dbo_term *terms;
    uint32_t term_count;
    uint32_t carried_shift;
    int memory_on_output;    /* 0: memory follows the input (forward); 1: the output (inverse) */
    int32_t drive_offset;    /* (X_0, Y_0) on the remembered axis, from the reference on, in memories' counts */
    uint32_t drive_shift;    /* one of those is 2^shift positions */
    uint32_t slope_shift;    /* q31 */
    uint32_t x_shift;        /* a count is 2^shift positions */
    uint32_t y_shift;
    dbo_position least; /* inputs are kept within least ... most */
    dbo_position most;
} dbo_backlash;

/* What the gears above a turn add to X_B - X_0 and to Y_B - Y_0. */
typedef struct {
    dbo_position x;
    dbo_position y;
} dbo_checkpoint;

/* The state. Its bits are runs of ones and zeros, whose ends are a stack: going on changes the lowest end, turning adds
 * one, and a run that is crossed melts into the next. The lowest run ends at S or Z, the greater of the two, and those
 * above it at turns[depth - 1], turns[depth - 2] and so on, the highest at n. Every DBO_SPACING-th turn has a
 * checkpoint: a move that wipes out many turns looks up there how far it goes. */
typedef struct {
    dbo_place *turns;            /* n places */
    dbo_checkpoint *checkpoints; /* (n - 1) / DBO_SPACING */
    dbo_memory *memory;
    dbo_place depth;
    dbo_place set;  /* S (4) */
    dbo_place zero; /* Z (5) */
    dbo_position x; /* X_B - X_0 (2) */
    dbo_position y; /* Y_B - Y_0 (3) */
    dbo_position last;
} dbo_backlash_state;

/* Limits on the output, as positions; step < 0: no slew limit. */
typedef struct {
    dbo_position low;
    dbo_position high;
    dbo_position step;
} dbo_limits;

/* One segment of a piecewise linear function: from x on, y + slope (u - x). q31: slope times 2^shift. */
typedef struct {
    dbo_number x;
    dbo_signal y;
    dbo_number slope;
} dbo_segment;

/* The state B (1) from its (n + 31) / 32 words of bits, bit i % 32 of word i / 32 being b_i; NULL: B = 0. */
void dbo_backlash_load(const dbo_backlash *op, dbo_backlash_state *state, const uint32_t *words);

/* The state of an actuator that was switched on and trimmed to `drive` and rests there;
 * `covered` gears take part, others stay as `spare` has them (NULL: open). */
void dbo_backlash_settle(const dbo_backlash *op, dbo_backlash_state *state, uint32_t covered,
                         const uint32_t *spare, dbo_signal drive);

/* One sample; limits may be NULL, and must be where memory follows the input. */
dbo_position dbo_backlash_step(const dbo_backlash *op, dbo_backlash_state *state, dbo_signal u,
                               const dbo_limits *limits);

/* The segments' value at u; `segment` is the one found last. `shift` is of the slopes (q31). */
dbo_signal dbo_segments_step(const dbo_segment *segments, uint32_t count, uint32_t shift,
                             uint32_t *segment, dbo_number u);

/* value / 2^shift, rounded, kept within the 32-bit numbers: a position in counts. */
int32_t dbo_counts_of(int64_t value, uint32_t shift);

#endif
