/* See dbo_lookup.h; the procedure is that of dbo_kernel.c, step by step. */
#include "dbo_lookup.h"

#define ENDLESS (1.0e300 * 1.0e300) /* infinity, without a header for it */

/* Z (5) on the way up, S (4) on the way down; n where there is none. */
static uint32_t next_gear(const dbo_lookup *t, uint32_t state, int rising) {
    const uint32_t all = ((uint32_t)1 << t->op->n) - 1U;
    return t->lowest[rising ? ~state & all : state];
}

/* Cross gears one way, (6)-(9): the bit of the next one changes, the table knows where that leads. */
static uint32_t pass_gears(const dbo_lookup *t, dbo_lookup_state *s, double u, double bound, int rising) {
    const uint32_t n = (uint32_t)t->op->n;
    uint32_t last = n;
    for (uint32_t next = next_gear(t, s->state, rising); next < n; next = next_gear(t, s->state, rising)) {
        const dbo_corner *corner = t->corners + s->state;
        const dbo_gear *gear = t->op->gears + next;
        const double travelled = rising ? u - corner->x : corner->x - u;
        const double room = rising ? bound - corner->y : corner->y - bound;
        if (!(travelled >= gear->dx * gear->crossing_fraction && room >= gear->dy * gear->crossing_fraction)) break;
        last = next;
        s->state ^= (uint32_t)1 << next;
    }
    return last;
}

static void follow_output(const dbo_lookup *t, dbo_lookup_state *s, double y, int rising) {
    (void)pass_gears(t, s, rising ? ENDLESS : -ENDLESS, y, rising);
}

static double solve(const dbo_lookup *t, dbo_lookup_state *s, double u, double low, double high) {
    const uint32_t n = (uint32_t)t->op->n;
    const int rising = u - t->corners[s->state].x >= 0.0;
    const uint32_t last = pass_gears(t, s, u, rising ? high : low, rising);
    const dbo_corner *corner = t->corners + s->state;
    const double d = u - corner->x;
    uint32_t next = next_gear(t, s->state, rising);
    if (last < n && (rising ? d < 0.0 : d > 0.0)) next = last; /* crossed by the tolerance */
    return corner->y + d * t->op->gears[next < n ? next : n - 1U].slope;
}

static double solve_within(const dbo_lookup *t, dbo_lookup_state *s, double u, double low, double high) {
    const dbo_corner *corner = t->corners + s->state;
    const double low_part = low - t->op->y0, high_part = high - t->op->y0;
    const double d = u - corner->x;
    double y;
    if (d >= 0.0 ? high_part < corner->y : low_part > corner->y) {
        follow_output(t, s, d >= 0.0 ? high_part : low_part, d < 0.0);
        return d >= 0.0 ? high : low;
    }
    y = t->op->y0 + solve(t, s, u, low_part, high_part);
    if (y > high) {
        if (d < 0.0) follow_output(t, s, high_part, 0);
        return high;
    }
    if (y < low) {
        if (d >= 0.0) follow_output(t, s, low_part, 1);
        return low;
    }
    return y;
}

/* last + step, rounded towards `last`, as in the kernel: a slew limit is kept to the last bit. */
static double towards(double last, double step) {
    const double sum = last + step, part = sum - last;
    const double lost = (last - (sum - part)) + (step - part);
    const double digit = (sum < 0.0 ? -sum : sum) * 2.220446049250313e-16;
    return step > 0.0 ? (lost < 0.0 ? sum - digit : sum) : (lost > 0.0 ? sum + digit : sum);
}

double dbo_lookup_step(const dbo_lookup *t, dbo_lookup_state *s, double x, const dbo_limits *limits) {
    const dbo_backlash *op = t->op;
    double low = limits->low, high = limits->high;
    if (limits->step) { /* the range wins over the slew limit */
        const double least = towards(s->last, -*limits->step), most = towards(s->last, *limits->step);
        low = least < low ? low : least > high ? high : least;
        high = most > high ? high : most < limits->low ? limits->low : most;
    }
    s->last = solve_within(t, s, x - op->x0, low, high);
    return s->last;
}

void dbo_lookup_settle(const dbo_lookup *t, dbo_lookup_state *s, uint32_t covered, uint32_t spare,
                       double drive) {
    const dbo_backlash *op = t->op;
    const double place = drive - op->y0, target = place - t->corners[spare].y;
    double low = 0.0, high = t->corners[((uint32_t)1 << covered) - 1U].y;
    const double slack = 1e-9 * high;
    s->state = spare;
    for (uint32_t i = covered; i-- > 0U && target > 0.0;) {
        const double width = op->gears[i].dy;
        if (target - low >= (high - target) - slack) {
            s->state |= (uint32_t)1 << i;
            low += width;
        } else {
            high -= width;
        }
    }
    s->last = drive;
    follow_output(t, s, place, place >= t->corners[s->state].y);
}
