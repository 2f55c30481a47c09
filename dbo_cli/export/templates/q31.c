/* $TITLE
 * $ORIGIN */
#include "$NAME.h"

$NUMBERS
$TABLES
static void place(${NAME}_state *state) { /* a copy of the state has places of its own */
    state->gears.turns = state->turns;
    state->gears.checkpoints = state->checkpoints;
    state->gears.memory = state->memory;
}

void ${NAME}_init(${NAME}_state *state) {
    for (int k = 0; k < 3; k++) state->segments[k] = 0U;
    state->filled = 0;
    place(state);
    dboq_backlash_settle(&op, &state->gears, 0U, SPARE, FIRST_AT_GEARS);
    state->output = FIRST_DRIVE;
}

void ${NAME}_reset(${NAME}_state *state, int32_t drive) {
    ${NAME}_init(state);
    if (drive == ${GUARD}_IGNORED) return;
    state->output = drive < LOW ? LOW : drive > HIGH ? HIGH : drive;
    dboq_backlash_settle(&op, &state->gears, COVERED, SPARE,
                         dboq_segments_step(drive_segments, DRIVE_ROWS, DRIVE_SHIFT, &state->segments[2], drive));
}

int32_t ${NAME}_step(${NAME}_state *state, int32_t input) {
    int32_t x = input;
    dboq_signal u;
    dboq_position y;
    if (x == ${GUARD}_IGNORED) return state->output;
    place(state);
#ifdef DELAY_WINDOW
    for (int k = 0; k < DELAY_WINDOW; k++) /* at rest before the first sample */
        state->wanted[k] = !state->filled || k == DELAY_WINDOW - 1 ? x : state->wanted[k + 1];
    x = dboq_between(state->wanted, 2, DELAY_PART);
#endif
    state->filled = 1;
    u = dboq_segments_step(before_segments, BEFORE_ROWS, BEFORE_SHIFT, &state->segments[0], x);
    y = dboq_backlash_step(&op, &state->gears, u, &limits);
    u = dboq_segments_step(behind_segments, BEHIND_ROWS, BEHIND_SHIFT, &state->segments[1], dboq_counts_of(y, Y_SHIFT));
    x = dboq_counts_of(u, 0U);
#ifdef CHANGE
    if ((int64_t)x - state->output < -CHANGE) x = (int32_t)(state->output - CHANGE);
    if ((int64_t)x - state->output > CHANGE) x = (int32_t)(state->output + CHANGE);
#endif
    x = x < LOW ? LOW : x > HIGH ? HIGH : x;
    state->output = x;
    return x;
}
