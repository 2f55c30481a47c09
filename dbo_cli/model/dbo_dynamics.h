/* The linear dynamics behind the gears: second-order sections and lags, and their inverse.
 *
 * C99, no allocation, no library calls; the same rules as dbo_kernel.h. All numbers that depend on a model or on the time between
 * samples are made by the caller (dynamics.py), once for an even clock.
 */
#ifndef DBO_DYNAMICS_H
#define DBO_DYNAMICS_H

#include <stddef.h>

/* Numbers of one section for one time step: how p (the output of 1/D) and q (its rate over the natural
 * frequency) change with q itself, with u - p, and with the change of the input u. */
typedef struct {
    double p_by_q;
    double p_by_lead;
    double p_by_change;
    double q_by_q;
    double q_by_lead;
    double q_by_change;
} dbo_section_step;

/* An antiresonance adds to p a part of u - p and of q; both 0 without one. */
typedef struct {
    double by_lead;
    double by_q;
} dbo_section_output;

typedef struct {
    double p;
    double q;
    double u; /* the input at the sample before */
} dbo_section_state;

/* The inverse of one section on an even clock: a causal recursion of two numbers a, b, and a sum over
 * `ahead` samples of the future, both driven by the change of the signal from sample to sample. */
typedef struct {
    double aa, ab, ba, bb; /* a, b after a sample by a, b before */
    double a_in, b_in;     /* and by the change of the signal */
    double a_out, b_out;   /* what they add to the signal */
    size_t ahead;
    const double *weight; /* of the changes 1, 2, ... `ahead` samples ahead */
} dbo_section_inverse;

typedef struct {
    double y; /* the signal at the sample before */
    double a;
    double b;
} dbo_inverse_state;

/* `count` samples through all sections, one after the other; `y` may be `x`. Row k of `step` has one entry
 * a section and begins at step + k*stride (stride 0: an even clock). */
void dbo_dynamics_run(size_t sections, const dbo_section_output *output, dbo_section_state *state,
                      const double *x, double *y, size_t count, const dbo_section_step *step,
                      size_t stride);

/* The input of one section for `count` samples of its output; `y` holds `ahead` samples more. */
void dbo_dynamics_undo(const dbo_section_inverse *section, dbo_inverse_state *state, const double *y,
                       double *u, size_t count);

#endif
