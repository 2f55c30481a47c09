/* TITLE
 * ORIGIN
 * Compile without fast-math and without contraction (-ffp-contract=off). */
#include "NAME.h"

/*+ tables */

void NAME_init(NAME_state *state) {
    for (uint32_t k = 0U; k < 3U; k++) state->segments[k] = 0U;
/*? terms */
    for (uint32_t k = 0U; k < TERMSU; k++) state->memory[k] = 0;
/*: terms */
    state->gears.turns = state->turns;
    state->gears.checkpoints = CHECKPOINTS;
    state->gears.memory = MEMORY;
    dbo_backlash_load(&op, &state->gears, SPARE);
    state->gears.last = state->gears.y;
/*? delay */
    state->delay_at = 0U;
    state->delay_filled = 0;
/*: delay */
    state->output = FIRST_OUTPUT;
}

void NAME_reset(NAME_state *state, NUMBER drive) {
    NUMBER x = drive;
    NAME_init(state);
/*? counts */
    if (x == GUARD_IGNORED) return;
/*: counts */
/*? !counts */
    if (!(x >= -DRIVE_REACH && x <= DRIVE_REACH)) return;
/*: counts */
/*? inverse */
    state->output = x < LOWEST_OUTPUT ? LOWEST_OUTPUT : x > HIGHEST_OUTPUT ? HIGHEST_OUTPUT : x;
/*: inverse */
    dbo_backlash_settle(&op, &state->gears, COVEREDU, SPARE,
                        dbo_segments_step(drives, DRIVE_ROWSU, DRIVE_SHIFTU, &state->segments[2], x));
}

NUMBER NAME_step(NAME_state *state, NUMBER input) {
    NUMBER x = input;
/*? counts */
    if (x == GUARD_IGNORED) return state->output;
/*: counts */
/*? !counts */
    if (!(x >= -REACH && x <= REACH)) return state->output;
/*: counts */
    dbo_signal u;
    dbo_position y;
    state->gears.turns = state->turns;
    state->gears.checkpoints = CHECKPOINTS;
    state->gears.memory = MEMORY;
    u = dbo_segments_step(before, BEFORE_ROWSU, BEFORE_SHIFTU, &state->segments[0], x);
    y = dbo_backlash_step(&op, &state->gears, u, LIMITS);
/*? counts */
    x = dbo_counts_of(dbo_segments_step(behind, BEHIND_ROWSU, BEHIND_SHIFTU, &state->segments[1], dbo_counts_of(y, Y_SHIFTU)), 0U);
/*: counts */
/*? !counts */
    x = dbo_segments_step(behind, BEHIND_ROWSU, BEHIND_SHIFTU, &state->segments[1], (float)dbo_counts_of(y, Y_SHIFTU));
/*: counts */
/*? slew */
/*? counts */
    if ((int64_t)x - state->output < -CHANGE) x = (int32_t)(state->output - CHANGE);
    if ((int64_t)x - state->output > CHANGE) x = (int32_t)(state->output + CHANGE);
/*: counts */
/*? !counts */
    if (x < state->output - CHANGE) x = state->output - CHANGE;
    if (x > state->output + CHANGE) x = state->output + CHANGE;
/*: counts */
/*: slew */
/*? inverse */
    x = x < LOWEST_OUTPUT ? LOWEST_OUTPUT : x > HIGHEST_OUTPUT ? HIGHEST_OUTPUT : x;
/*: inverse */
/*+ delay_line */
    state->output = x;
    return x;
}
