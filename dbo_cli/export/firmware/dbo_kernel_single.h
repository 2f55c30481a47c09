/* The Discrete Backlash Operator at a fixed time step in float32 or in 32-bit fixed point.
 *
 * C99, no allocation, no recursion, no library calls. The procedure is that of the float64 kernel of the
 * package, step by step; here positions along either axis are relative to (X_0, Y_0), the memory's
 * immediate part kappa of the output is in the gears' widths already, and everything that a fixed time step
 * makes constant is a table. (1) to (18) are the equations of Aye and Ang (2018).
 *
 * DBO_Q31: positions are 64-bit whole numbers, so that sums are exact; widths and slopes are 32-bit ones,
 * and a product is 32 x 32 to 64 bits. Nothing overflows: inputs are limited to one range beyond either end.
 * DBO_FLOAT: widths are whole multiples of one power of two, so that X_B and Y_B are exact as well.
 */
#ifndef DBO_KERNEL_H
#define DBO_KERNEL_H

#include <stdint.h>

/* the arithmetic: DBO_FLOAT or DBO_Q31 */

#if defined(DBO_Q31)
typedef int64_t dbo_position; /* along the input or the output axis */
typedef int32_t dbo_width;
typedef int32_t dbo_number; /* what goes in and comes out */
typedef int64_t dbo_memory; /* L_j in 2^-24 of a count */
#else
typedef float dbo_position;
typedef float dbo_width;
typedef float dbo_number;
typedef struct {
    float value;
    float lost; /* what adding to the value rounded off: without it slow memories would stand still */
} dbo_memory;
#endif

typedef struct {
    dbo_width width;  /* on the input, kappa x height included */
    dbo_width height; /* on the output */
    dbo_width slope;  /* height / width; q31: times 2^slope_shift */
} dbo_gear;

/* One relaxation term. q31: factors are times 2 to the power of their shift. */
typedef struct {
    dbo_width carried; /* c_j a_j where memory follows the output, c_j where it follows the input */
    dbo_width rest;    /* 1 - a_j */
#if defined(DBO_Q31)
    uint8_t carried_shift;
    uint8_t rest_shift;
#endif
} dbo_term;

/* A backlash operator. Gear i stands in row (i * row_factor) >> row_shift: one row for `run` equal gears. */
typedef struct {
    const dbo_gear *gears;
    uint32_t n;
    uint32_t run;
    uint32_t row_factor;
    uint32_t row_shift;
    dbo_width tolerance; /* so much of a gear may be missing when it counts as crossed; q31: 2^-tolerance */
    const dbo_term *terms;
    uint32_t term_count;
    int memory_on_output;  /* 0: memory follows the input (forward); 1: the output (inverse) */
    dbo_width drive_offset; /* position of (X_0, Y_0) on the remembered axis; q31: counts */
#if defined(DBO_Q31)
    uint32_t slope_shift;
    uint32_t drive_shift; /* a count of the remembered axis is 2^drive_shift positions */
    dbo_position least;   /* inputs are kept within least ... most */
    dbo_position most;
#endif
} dbo_backlash;

typedef struct {
    uint32_t *words; /* (n + 31) / 32 of them: bit i % 32 of word i / 32 is b_i */
    dbo_memory *memory;
    uint32_t set;  /* S (4) */
    uint32_t zero; /* Z (5) */
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
    dbo_position y;
    dbo_width slope;
} dbo_segment;

/* X_B, Y_B, S and Z from the words. */
void dbo_backlash_load(const dbo_backlash *op, dbo_backlash_state *state);

/* The state of an actuator that was switched on and trimmed to `drive` (a position) and rests there;
 * `covered` gears take part. */
void dbo_backlash_settle(const dbo_backlash *op, dbo_backlash_state *state, uint32_t covered,
                         dbo_position drive);

/* One sample; limits may be NULL, and must be where memory follows the input. */
dbo_position dbo_backlash_step(const dbo_backlash *op, dbo_backlash_state *state, dbo_position u,
                               const dbo_limits *limits);

/* The segments' value at u; `segment` is the one found last. `shift` is of the slopes (q31). */
dbo_position dbo_segments_step(const dbo_segment *segments, uint32_t count, uint32_t shift,
                               uint32_t *segment, dbo_number u);

#if defined(DBO_Q31)
/* A position in counts of 2^shift positions each, rounded, kept within the 32-bit numbers. */
int32_t dbo_counts_of(dbo_position value, uint32_t shift);
#endif

#endif
