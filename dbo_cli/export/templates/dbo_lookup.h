/* The Discrete Backlash Operator of few gears, inverse, with every state's corner in a table (the paper, Section VI):
 * nothing is added up, a transition is an index. The same bits as dbo_kernel.c. Without relaxation. C99, no library. */
#ifndef DBO_LOOKUP_H
#define DBO_LOOKUP_H

#include "dbo_kernel.h"

/* X_B - X_0 (2) and Y_B - Y_0 (3) of one state. */
typedef struct {
    double x;
    double y;
} dbo_corner;

/* `op` has one row a gear; `corners` has 2^n rows. */
typedef struct {
    const dbo_backlash *op;
    const dbo_corner *corners;
    const uint8_t *lowest; /* index of the lowest one of a number below 2^n; n for 0 */
} dbo_lookup;

typedef struct {
    uint32_t state; /* B (1) */
    double last;
} dbo_lookup_state;

double dbo_lookup_step(const dbo_lookup *t, dbo_lookup_state *s, double x, const dbo_limits *limits);

/* As dbo_backlash_settle. */
void dbo_lookup_settle(const dbo_lookup *t, dbo_lookup_state *s, uint32_t covered, uint32_t spare,
                       double drive);

#endif
