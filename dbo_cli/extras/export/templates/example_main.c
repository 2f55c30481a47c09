/* Where the calls stand in a program: replace the two functions by the ones of your board. */
#include "NAME.h"

#include <stdio.h>

/* INPUT_TEXT in, once every sample: a ramp up and back, since a leap rings an actuator. */
static NUMBER next_input(unsigned k) {
    NUMBER steps = (NUMBER)(k < 100U ? k : 200U - k);
    return SAMPLE / 100 * steps;
}

/* OUTPUT_TEXT out. */
static void put_output(NUMBER output) { printf("%.9g\n", (double)output); }

int main(void) {
    NAME_state state;
    NAME_init(&state); /* the drive stands at its lower end; NAME_reset after a trim */
    for (unsigned k = 0; k < 200U; k++) put_output(NAME_step(&state, next_input(k)));
    return 0;
}
