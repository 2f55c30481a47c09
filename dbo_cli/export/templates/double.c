/* $TITLE
 * $ORIGIN
 * Compile without fast-math and without contraction (-ffp-contract=off). */
#include "$NAME.h"

$TABLES
void ${NAME}_init(${NAME}_state *state) {
$INIT
    state->output = $FIRST_OUTPUT;
}

void ${NAME}_reset(${NAME}_state *state, double drive) {
    double x = drive;
    ${NAME}_init(state);
    if (!(x >= -$DRIVE_REACH && x <= $DRIVE_REACH)) return;
    state->output = x < $LEAST ? $LEAST : x > $MOST ? $MOST : x;
$RESET
}

double ${NAME}_step(${NAME}_state *state, double input) {
    double x = input;
    if (!(x >= -$REACH && x <= $REACH)) return state->output;
$STEP
    state->output = x;
    return x;
}
