/* See dbo_plays.h. */
#include "dbo_plays.h"

#define LANES DBO_PLAY_LANES
#define MOST_STEPS 64 /* of the safeguarded Newton iteration: halving alone would need no more */

static double folded(const double *sum) {
    return ((sum[0] + sum[1]) + (sum[2] + sum[3])) + ((sum[4] + sum[5]) + (sum[6] + sum[7]));
}

/* Move all plays to the input v. */
static void follow(const dbo_plays *op, double *z, double v) {
    for (size_t i = 0; i < op->padded; i += LANES)
        for (size_t j = i; j < i + LANES; j++) {
            const double low = v - op->up[j], high = v + op->down[j];
            double held = z[j];
            held = held > high ? high : held;
            held = held < low ? low : held;
            z[j] = held;
        }
}

static double weighted(const dbo_plays *op, const double *z, double share) {
    double sum[LANES] = {0.0};
    if (op->by_rate) {
        for (size_t i = 0; i < op->padded; i += LANES)
            for (size_t j = 0; j < LANES; j++) sum[j] += (op->weight[i + j] + share * op->by_rate[i + j]) * z[i + j];
    } else {
        for (size_t i = 0; i < op->padded; i += LANES)
            for (size_t j = 0; j < LANES; j++) sum[j] += op->weight[i + j] * z[i + j];
    }
    return folded(sum);
}

static double curve(const dbo_plays *op, double x) {
    if (x <= 0.0) return op->linear * x;
    if (x >= 1.0) return (op->cubic + op->linear) + (3.0 * op->cubic + op->linear) * (x - 1.0);
    return (op->cubic * (x * x) + op->linear) * x;
}

static double curve_slope(const dbo_plays *op, double x) {
    if (x <= 0.0) return op->linear;
    if (x >= 1.0) return 3.0 * op->cubic + op->linear;
    return 3.0 * op->cubic * (x * x) + op->linear;
}

void dbo_plays_run(const dbo_plays *op, double *z, const double *x, double *y, size_t count, const double *share) {
    for (size_t k = 0; k < count; k++) {
        const double v = x[k];
        if (op->by_rate) {
            follow(op, z, v);
            y[k] = weighted(op, z, share[k]);
        } else {
            double sum[LANES] = {0.0};
            for (size_t i = 0; i < op->padded; i += LANES)
                for (size_t j = 0; j < LANES; j++) {
                    const double low = v - op->up[i + j], high = v + op->down[i + j];
                    double held = z[i + j];
                    held = held > high ? high : held;
                    held = held < low ? low : held;
                    z[i + j] = held;
                    sum[j] += op->weight[i + j] * held;
                }
            y[k] = folded(sum);
        }
        if (op->curved) y[k] = y[k] + curve(op, v);
    }
}

void dbo_plays_rows(const dbo_plays *op, double *z, const double *x, double *rows, size_t count) {
    for (size_t k = 0; k < count; k++) {
        follow(op, z, x[k]);
        for (size_t i = 0; i < op->n; i++) rows[k * op->n + i] = z[i];
    }
}

/* Where curve(x) - curve(at) + slope (x - at) = wanted, going from `at` towards it; the left side rises. */
static double on_curve(const dbo_plays *op, double at, double slope, double wanted) {
    const double begin = curve(op, at);
    double way = wanted / (slope + curve_slope(op, at)), near = at, far = at + way;
    for (int k = 0; k < MOST_STEPS; k++) {
        const double missing = wanted - ((curve(op, far) - begin) + slope * (far - at));
        if (wanted > 0.0 ? missing <= 0.0 : missing >= 0.0) break;
        near = far;
        way = way + way;
        far = at + way;
    }
    double x = far;
    for (int k = 0; k < MOST_STEPS; k++) {
        const double missing = wanted - ((curve(op, x) - begin) + slope * (x - at));
        if (missing == 0.0) break;
        if (wanted > 0.0 ? missing > 0.0 : missing < 0.0)
            near = x;
        else
            far = x;
        double next = x + missing / (slope + curve_slope(op, x));
        if (near < far ? !(next > near && next < far) : !(next > far && next < near)) next = near + 0.5 * (far - near);
        if (next == x) break;
        x = next;
    }
    return x;
}

/* The input at which the output is y; z is where the plays stand. */
static double solved(const dbo_plays *op, const double *z, double y, double share) {
    double at = z[0], reached = weighted(op, z, share);
    if (op->curved) reached = reached + curve(op, at);
    if (y == reached) return at;
    const int rising = y > reached;
    double slope = op->weight[0];
    if (op->by_rate) slope = slope + share * op->by_rate[0];
    for (size_t i = 1; i < op->n; i++) {
        double edge = rising ? z[i] + op->up[i] : z[i] - op->down[i];
        if (rising ? edge < at : edge > at) edge = at;
        double next = slope * (edge - at);
        if (op->curved) next = next + (curve(op, edge) - curve(op, at));
        next = reached + next;
        if (rising ? next >= y : next <= y) break;
        reached = next;
        at = edge;
        slope = slope + op->weight[i];
        if (op->by_rate) slope = slope + share * op->by_rate[i];
    }
    return op->curved ? on_curve(op, at, slope, y - reached) : at + (y - reached) / slope;
}

void dbo_plays_solve(const dbo_plays *op, double *z, const double *y, double *x, size_t count, const double *share) {
    for (size_t k = 0; k < count; k++) {
        x[k] = solved(op, z, y[k], share ? share[k] : 0.0);
        follow(op, z, x[k]);
    }
}
