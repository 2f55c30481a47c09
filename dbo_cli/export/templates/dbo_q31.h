/* The Discrete Backlash Operator, inverse, at a fixed time step in 32-bit fixed point (q31).
 *
 * C99, no allocation, no recursion, no library calls. The procedure is that of the float64 kernel of the
 * package, step by step; here positions along either axis are relative to (X_0, Y_0), the memory's
 * immediate part kappa of the output is in the gears' widths already, and everything that a fixed time step
 * makes constant is a table. (1) to (18) are the equations of Aye and Ang (2018).
 *
 * Positions along either axis are whole numbers, so that (2)-(3) hold exactly and for ever: a range is 2^30
 * counts, and a count some 2^10 positions; memories are whole, too. All other numbers are whole as well; a product
 * is 32 x 32 to 64 bits, and what goes beyond the range saturates.
 */
#ifndef DBO_Q31_H
#define DBO_Q31_H

#include <stdint.h>

/* The index of a gear, and n. DBOQ_PLACE: a smaller type that holds them, where there is little memory. */
#if !defined(DBOQ_PLACE)
#define DBOQ_PLACE uint32_t
#endif
#if !defined(DBOQ_SPACING)
#define DBOQ_SPACING 64 /* turns that share a checkpoint */
#endif

typedef int64_t dboq_position; /* along the input or the output axis */
typedef int64_t dboq_memory;   /* L_j in 2^-24 of its count: with less, slow memories would stand still */

typedef int32_t dboq_number;   /* what goes in and comes out, and factors */
typedef int64_t dboq_signal;   /* what points and scales give: positions */

typedef struct {
    int32_t width;    /* on the input, kappa x height included */
    int32_t height;   /* on the output */
    dboq_number slope; /* height / width, times 2^slope_shift */
} dboq_gear;

/* One relaxation term: factors times 2 to the power of their shift, which those carried share. */
typedef struct {
    int32_t carried; /* c_j a_j */
    int32_t rest;    /* 1 - a_j */
    uint32_t rest_shift;
} dboq_term;

typedef DBOQ_PLACE dboq_place;

/* Where a row begins with all gears below it crossed and no others: (X_B - X_0, Y_B - Y_0). */
typedef struct {
    dboq_position x;
    dboq_position y;
} dboq_begin;

/* A backlash operator. Gear i stands in row (i * row_factor) >> row_shift: one row for a run of equal gears. */
typedef struct {
    const dboq_gear *gears;
    const dboq_begin *begins; /* one a row, and where the last gear ends */
    const dboq_place *guide;  /* in which row each part of the input's range begins; a part is 2^part_shift positions */
    uint32_t part_shift;
    uint32_t n;
    uint32_t run; /* equal gears that share a row */
    uint32_t half_run; /* the greatest power of two that is no greater */
    uint32_t row_factor;
    uint32_t row_shift;
    uint32_t tolerance; /* a gear counts as crossed when all but 2^-tolerance of it is travelled */
    const dboq_term *terms;
    uint32_t term_count;
    uint32_t carried_shift;
    int32_t drive_offset;    /* Y_0 from the reference on, in memories' counts */
    uint32_t drive_shift;    /* one of those is 2^shift positions */
    uint32_t slope_shift;
    dboq_position least; /* inputs are kept within least ... most */
    dboq_position most;
} dboq_backlash;

/* What the gears above a turn add to X_B - X_0 and to Y_B - Y_0. */
typedef struct {
    dboq_position x;
    dboq_position y;
} dboq_checkpoint;

/* The state. Its bits are runs of ones and zeros, whose ends are a stack: going on changes the lowest end, turning adds
 * one, and a run that is crossed melts into the next. The lowest run ends at S or Z, the greater of the two, and those
 * above it at turns[depth - 1], turns[depth - 2] and so on, the highest at n. Every DBOQ_SPACING-th turn has a
 * checkpoint: a move that wipes out many turns looks up there how far it goes. */
typedef struct {
    dboq_place *turns;            /* n places */
    dboq_checkpoint *checkpoints; /* (n - 1) / DBOQ_SPACING */
    dboq_memory *memory;
    dboq_place depth;
    dboq_place set;  /* S (4) */
    dboq_place zero; /* Z (5) */
    dboq_position x; /* X_B - X_0 (2) */
    dboq_position y; /* Y_B - Y_0 (3) */
    dboq_position last;
} dboq_backlash_state;

/* Limits on the output, as positions; step < 0: no slew limit. */
typedef struct {
    dboq_position low;
    dboq_position high;
    dboq_position step;
} dboq_limits;

/* One segment of a piecewise linear function: from x on, y + slope (u - x); slope times 2^shift. */
typedef struct {
    dboq_number x;
    dboq_signal y;
    dboq_number slope;
} dboq_segment;

/* The state B (1) from its (n + 31) / 32 words of bits, bit i % 32 of word i / 32 being b_i; NULL: B = 0. */
void dboq_backlash_load(const dboq_backlash *op, dboq_backlash_state *state, const uint32_t *words);

/* The state of an actuator that was switched on and trimmed to `drive` and rests there;
 * `covered` gears take part, others stay as `spare` has them (NULL: open). */
void dboq_backlash_settle(const dboq_backlash *op, dboq_backlash_state *state, uint32_t covered,
                         const uint32_t *spare, dboq_signal drive);

/* One sample. */
dboq_position dboq_backlash_step(const dboq_backlash *op, dboq_backlash_state *state, dboq_signal u,
                               const dboq_limits *limits);

/* The segments' value at u; `segment` is the one found last. `shift` is of the slopes. */
dboq_signal dboq_segments_step(const dboq_segment *segments, uint32_t count, uint32_t shift,
                             uint32_t *segment, dboq_number u);

/* value / 2^shift, rounded, kept within the 32-bit numbers: a position in counts. */
int32_t dboq_counts_of(int64_t value, uint32_t shift);

#endif
