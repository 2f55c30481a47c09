/* Weighted sums of play operators: what the Prandtl-Ishlinskii operator and its descendants are made of.
 *
 * C99, no allocation, no library calls; compare/plays.py makes the tables.
 * Arrays are padded to whole groups of DBO_PLAY_LANES plays with weight 0 and infinite reach, so that a compiler
 * may keep a group in vector registers; `n` counts the real ones. Play 0 has reach 0: it is the last input.
 */
#ifndef DBO_PLAYS_H
#define DBO_PLAYS_H

#include <stddef.h>

#define DBO_PLAY_LANES 8 /* chosen; the order of the sums, so part of the bits: LANES in compare/plays.py */

/* z_i = max(x - up_i, min(x + down_i, z_i)), y = curve(x) + sum (weight_i + s by_rate_i) z_i, s being 0 to 1.
 * by_rate is 0 where weights do not depend on the rate. The curve is cubic x^3 + linear x from 0 to 1 and goes
 * straight on beyond; `curved` tells whether there is one. */
typedef struct {
    size_t n, padded;
    const double *up, *down, *weight, *by_rate;
    int curved;
    double cubic, linear;
} dbo_plays;

/* y from x; z (padded) is the state. `share` is s of every sample, or 0 where by_rate is. */
void dbo_plays_run(const dbo_plays *op, double *z, const double *x, double *y, size_t count, const double *share);

/* The plays themselves: n numbers a sample. */
void dbo_plays_rows(const dbo_plays *op, double *z, const double *x, double *rows, size_t count);

/* x from y: from where the drive stands it goes towards y, play after play engages, and where y is reached it
 * stops. That needs the slope with all plays engaged to be above 0, not the slope of the first ones. */
void dbo_plays_solve(const dbo_plays *op, double *z, const double *y, double *x, size_t count, const double *share);

#endif
