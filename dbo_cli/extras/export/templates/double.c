/* TITLE
 * ORIGIN
 * Compile without fast-math and without contraction (-ffp-contract=off). */
#include "NAME.h"

/*+ tables */

void NAME_init(NAME_state *state) {
/*? moving */
    state->moving = 0;
/*: moving */
/*? lag */
    state->lagging = 0;
/*: lag */
/*? terms */
    for (size_t k = 0; k < TERMS; k++) state->memory[k] = 0;
/*: terms */
/*? points */
    for (size_t k = 0; k < SEGMENTS; k++) state->segments[k] = 0;
/*: points */
/*? lookup */
    state->gears.memory = MEMORY;
    state->gears.state = SPARE_STATEU;
    state->gears.last = LOWEST_DRIVE;
/*: lookup */
/*? !lookup */
    state->gears.turns = state->turns;
    state->gears.checkpoints = CHECKPOINTS;
    state->gears.memory = MEMORY;
    dbo_backlash_load(&op, &state->gears, SPARE);
    state->gears.last = LOWEST_DRIVE;
/*: lookup */
/*? delay */
    state->delay_at = 0U;
    state->delay_filled = 0;
/*: delay */
    state->output = FIRST_OUTPUT;
}

void NAME_reset(NAME_state *state, double drive) {
    double x = drive;
    NAME_init(state);
    if (!(x >= -DRIVE_REACH && x <= DRIVE_REACH)) return;
/*? inverse */
    state->output = x < LOWEST_OUTPUT ? LOWEST_OUTPUT : x > HIGHEST_OUTPUT ? HIGHEST_OUTPUT : x;
/*: inverse */
/*+ drive_steps */
/*? lookup */
    dbo_lookup_settle(&lookup, &state->gears, COVEREDU, SPARE_STATEU, x);
/*: lookup */
/*? !lookup */
    dbo_backlash_settle(&op, &state->gears, COVERED, SPARE, x);
/*: lookup */
/*? lag */
    state->lag.p = state->lag.u = drive;
    state->lag.q = 0.0;
    state->lagging = 1;
/*: lag */
}

double NAME_step(NAME_state *state, double input) {
    double x = input;
    if (!(x >= -REACH && x <= REACH)) return state->output;
/*? !lookup */
    state->gears.turns = state->turns;
    state->gears.checkpoints = CHECKPOINTS;
/*: lookup */
    state->gears.memory = MEMORY;
/*+ step */
/*+ delay_line */
    state->output = x;
    return x;
}
