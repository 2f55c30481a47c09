/* $TITLE
 * $ORIGIN */
#include "$NAME.h"

$TABLES
void ${NAME}_init(${NAME}_state *state) {
    for (uint32_t k = 0U; k < 3U; k++) state->segments[k] = 0U;
    state->gears.turns = state->turns;
    state->gears.checkpoints = $CHECKPOINTS;
    state->gears.memory = $MEMORY;
$INIT
    dboq_backlash_settle(&op, &state->gears, 0U, $SPARE, $FIRST_DRIVE);
    state->output = $FIRST_OUTPUT;
}

void ${NAME}_reset(${NAME}_state *state, int32_t drive) {
    ${NAME}_init(state);
    if (drive == ${GUARD}_IGNORED) return;
    state->output = drive < $LEAST ? $LEAST : drive > $MOST ? $MOST : drive;
    dboq_backlash_settle(&op, &state->gears, ${COVERED}U, $SPARE,
                         dboq_segments_step(drive_segments, ${DRIVE_ROWS}U, ${DRIVE_SHIFT}U, &state->segments[2], drive));
}

int32_t ${NAME}_step(${NAME}_state *state, int32_t input) {
    int32_t x = input;
    dboq_signal u;
    dboq_position y;
    if (x == ${GUARD}_IGNORED) return state->output;
    state->gears.turns = state->turns;
    state->gears.checkpoints = $CHECKPOINTS;
    state->gears.memory = $MEMORY;
$STEP
    u = dboq_segments_step(before_segments, ${BEFORE_ROWS}U, ${BEFORE_SHIFT}U, &state->segments[0], x);
    y = dboq_backlash_step(&op, &state->gears, u, &limits);
    u = dboq_segments_step(behind_segments, ${BEHIND_ROWS}U, ${BEHIND_SHIFT}U, &state->segments[1], dboq_counts_of(y, ${Y_SHIFT}U));
    x = dboq_counts_of(u, 0U);
    if ((int64_t)x - state->output < -$MOST_CHANGE) x = (int32_t)(state->output - $MOST_CHANGE);
    if ((int64_t)x - state->output > $MOST_CHANGE) x = (int32_t)(state->output + $MOST_CHANGE);
    x = x < $LEAST ? $LEAST : x > $MOST ? $MOST : x;
    state->output = x;
    return x;
}
