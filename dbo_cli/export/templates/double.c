/* $TITLE
 * $ORIGIN
 * Compile without fast-math and without contraction (-ffp-contract=off). */
#include "$NAME.h"

$NUMBERS
/* Points, or a scale: x0 is its gain, and y0 its offset. */
typedef struct {
    const dbo_segment *segments;
    size_t count;
    double x0;
    double y0;
} curve;

$TABLES
static double through(${NAME}_state *state, int begin, int end, double x) {
    for (int k = begin; k < end; k++) {
        const curve *c = curves + k;
        x = c->segments ? dbo_point_step(c->segments, c->count, c->x0, c->y0, &state->segments[k], x)
                        : c->x0 * x + c->y0;
    }
    return x;
}

#ifndef LOOKUP
static void place(${NAME}_state *state) { /* a copy of the state has places of its own */
    state->gears.turns = state->turns;
    state->gears.checkpoints = state->checkpoints;
    state->gears.memory = state->memory;
}
#endif

void ${NAME}_init(${NAME}_state *state) {
    for (int k = 0; k < CURVES; k++) state->segments[k] = 0;
    state->filled = state->begun = 0;
    state->amplifier = 0.0;
#ifdef LOOKUP
    state->gears.state = SPARE;
#else
    for (int k = 0; k < TERMS; k++) state->memory[k] = 0.0;
    place(state);
    dbo_backlash_load(&op, &state->gears, SPARE);
#endif
    state->gears.last = FIRST_AT_GEARS;
    state->output = FIRST_DRIVE;
}

void ${NAME}_reset(${NAME}_state *state, double drive) {
    ${NAME}_init(state);
    if (!(drive >= -DRIVE_REACH && drive <= DRIVE_REACH)) return;
    state->output = drive < LOW ? LOW : drive > HIGH ? HIGH : drive;
    state->amplifier = drive;
    state->begun = 1;
#ifdef LOOKUP
    dbo_lookup_settle(&lookup, &state->gears, COVERED, SPARE, through(state, TO_GEARS, TO_DRIVE, drive));
#else
    dbo_backlash_settle(&op, &state->gears, COVERED, SPARE, through(state, TO_GEARS, TO_DRIVE, drive));
#endif
}

double ${NAME}_step(${NAME}_state *state, double input) {
    double x = input, low = LOW, high = HIGH;
#ifdef AMPLIFIER
    const double before = state->begun ? state->amplifier : 0.0;
    const double share = state->begun ? AMPLIFIER : 1.0;
    dbo_limits limits = {0.0, 0.0, 0.0, 0, 0};
#endif
    if (!(x >= -REACH && x <= REACH)) return state->output;
#ifdef DELAY_WINDOW
    for (int k = 0; k < DELAY_WINDOW; k++) /* at rest before the first sample */
        state->wanted[k] = !state->filled || k == DELAY_WINDOW - 1 ? x : state->wanted[k + 1];
    x = dbo_between(times, state->wanted, 2, DELAY_PART);
#endif
#ifdef SECTIONS
    double *window = state->windows;
    for (int s = 0; s < SECTIONS; s++) {
        const size_t ahead = sections[s].ahead;
        if (!state->filled) { /* at rest before the first sample */
            for (size_t k = 0; k <= ahead; k++) window[k] = x;
            state->sections[s].y = x;
            state->sections[s].a = state->sections[s].b = 0.0;
        }
        for (size_t k = 1; k <= ahead; k++) window[k - 1] = window[k];
        window[ahead] = x;
        dbo_dynamics_undo(&sections[s], &state->sections[s], window, &x, 1);
        window += ahead + 1;
    }
#endif
    state->filled = 1;
    x = through(state, 0, TO_GEARS, x);
#ifdef AMPLIFIER /* what the limits of the drive leave at the gears */
    if (low < state->output - CHANGE) low = state->output - CHANGE;
    if (high > state->output + CHANGE) high = state->output + CHANGE;
    limits.low = through(state, TO_GEARS, TO_DRIVE, before + share * (low - before));
    limits.high = through(state, TO_GEARS, TO_DRIVE, before + share * (high - before));
    if (limits.low > limits.high) {
        const double swapped = limits.low;
        limits.low = limits.high;
        limits.high = swapped;
    }
#endif
#ifdef LOOKUP
    x = dbo_lookup_step(&lookup, &state->gears, x, &limits);
#else
    place(state);
    x = state->begun ? dbo_backlash_step_fixed(&op, &fixed, &state->gears, x, &limits, 0)
                     : dbo_backlash_step(&op, &state->gears, x, at_rest, &limits, 0);
#endif
    state->begun = 1;
    x = through(state, TO_DRIVE, CURVES, x);
#ifdef AMPLIFIER
    state->amplifier = x;
    x = before + (x - before) / share;
#endif
    x = x < low ? low : x > high ? high : x; /* rounding on the way back through the points */
    state->output = x;
    return x;
}
