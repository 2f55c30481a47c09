/* Where the calls stand in a program: replace the two functions by the ones of your board. */
#include "NAME.h"

#include <stdio.h>

/*+ samples */

/* Inputs, once every sample: a ramp up and back, since a leap rings an actuator. */
static void next_inputs(unsigned k, NUMBER *in) {
    NUMBER steps = (NUMBER)(k < 100U ? k : 200U - k);
    for (unsigned c = 0; c < GUARD_CHANNELS; c++) in[c] = samples[c] / 100 * steps;
}

static void put_outputs(const NUMBER *out) {
    for (unsigned c = 0; c < GUARD_CHANNELS; c++)
        printf("%.9g%c", (double)out[c], c + 1U < GUARD_CHANNELS ? ' ' : '\n');
}

int main(void) {
    NAME_state state;
    NUMBER in[GUARD_CHANNELS], out[GUARD_CHANNELS];
    NAME_init(&state); /* the drives stand at their lower ends; NAME_reset after a trim */
    for (unsigned k = 0; k < 200U; k++) {
        next_inputs(k, in);
        NAME_step(&state, in, out);
        put_outputs(out);
    }
    return 0;
}
