/* See dbo_dynamics.h. */
#include "dbo_dynamics.h"

/* Sums over many neighbours go neighbour by neighbour over a chunk of samples, which compilers turn into
 * vector instructions; the order of the additions of one sample is the same whatever the chunk. */
#define CHUNK 512

void dbo_dynamics_run(size_t sections, const dbo_section_output *output, dbo_section_state *state,
                      const double *x, double *y, size_t count, const dbo_section_step *step,
                      size_t stride) {
    for (size_t k = 0; k < count; k++) {
        const dbo_section_step *row = step + k * stride;
        double value = x[k];
        for (size_t j = 0; j < sections; j++) {
            const dbo_section_step *c = row + j;
            dbo_section_state *s = state + j;
            const double lead = s->u - s->p, change = value - s->u;
            s->p += (c->p_by_q * s->q + c->p_by_lead * lead) + c->p_by_change * change;
            s->q = (c->q_by_q * s->q + c->q_by_lead * lead) + c->q_by_change * change;
            s->u = value;
            value = s->p + (output[j].by_lead * (value - s->p) + output[j].by_q * s->q);
        }
        y[k] = value;
    }
}

void dbo_dynamics_undo(const dbo_section_inverse *section, dbo_inverse_state *state, const double *y,
                       double *u, size_t count) {
    for (size_t begin = 0; begin < count; begin += CHUNK) {
        const size_t end = count - begin < CHUNK ? count : begin + CHUNK;
        for (size_t k = begin; k < end; k++) u[k] = 0.0;
        for (size_t j = section->ahead; j > 0; j--) {
            const double weight = section->weight[j - 1];
            for (size_t k = begin; k < end; k++) u[k] += weight * (y[k + j] - y[k + j - 1]);
        }
    }
    for (size_t k = 0; k < count; k++) {
        const double change = y[k] - state->y, a = state->a, b = state->b;
        state->a = (section->aa * a + section->ab * b) + section->a_in * change;
        state->b = (section->ba * a + section->bb * b) + section->b_in * change;
        state->y = y[k];
        u[k] = y[k] + ((section->a_out * state->a + section->b_out * state->b) + u[k]);
    }
}
