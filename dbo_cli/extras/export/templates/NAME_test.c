/* TITLE
 * The self-test: plays inputs and compares every output with what the package computed, to the last bit.
 * On a computer: prints what differs and exits with 1. On a target without a console compile with
 * -DDBO_NO_MAIN and call NAME_self_test. */
#include "NAME.h"

#ifndef DBO_NO_MAIN
#include <stdio.h>
#endif

unsigned NAME_self_test(void);

/*+ vectors */

typedef union {
    NUMBER value;
    BITS bits;
} bits_of;

/* Play one run; returns how many samples differ. */
static unsigned play(const char *label, NAME_state *state, const NUMBER *inputs,
                     const NUMBER *expected, unsigned count) {
    unsigned wrong = 0;
    for (unsigned k = 0; k < count; k++) {
        bits_of got, wanted;
        got.value = NAME_step(state, inputs[k]);
        wanted.value = expected[k];
        if (got.bits == wanted.bits) continue;
#ifndef DBO_NO_MAIN
        if (wrong < 10U)
            printf("NAME: %s, sample %u: %.17g where %.17g is expected\n", label, k + 1U, (double)got.value, (double)wanted.value);
#endif
        wrong++;
    }
    (void)label;
    return wrong;
}

unsigned NAME_self_test(void) {
    NAME_state state;
    unsigned wrong = 0;
/*+ runs */
    return wrong;
}

/*? alone */
#ifndef DBO_NO_MAIN
int main(void) {
    const unsigned wrong = NAME_self_test();
    if (wrong > 0)
        printf("NAME: %u of COUNT samples differ; were the flags as README.md says?\n", wrong);
    else
        printf("NAME: COUNT samples, every bit as expected\n");
    return wrong > 0;
}
#endif
/*: alone */
