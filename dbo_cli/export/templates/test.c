/* $TITLE
 * The self-test: plays inputs and compares every output with what the package computed, as README.md says.
 * On a computer: prints what differs and exits with 1. On a target without a console compile with
 * -DDBO_NO_MAIN and call ${NAME}_self_test. */
#include "$NAME.h"

#ifndef DBO_NO_MAIN
#include <stdio.h>
#endif

unsigned ${NAME}_self_test(void);

$VECTORS
$DIFFERENCE
/* Play one run; returns how many samples differ. */
static unsigned play(const char *label, ${NAME}_state *state, const $NUMBER *inputs,
                     const $NUMBER *expected, unsigned count) {
    unsigned wrong = 0;
    for (unsigned k = 0; k < count; k++) {
        const $NUMBER got = ${NAME}_step(state, inputs[k]);
        const unsigned differs = difference(got, expected[k]);
        if (differs == 0U) continue;
#ifndef DBO_NO_MAIN
        if (wrong < 10U)
            printf("$NAME: %s, sample %u: %.17g where %.17g is expected\n", label, k + 1U, (double)got,
                   (double)expected[k]);
#endif
        wrong += differs;
    }
    (void)label;
    return wrong;
}

unsigned ${NAME}_self_test(void) {
    ${NAME}_state state;
    unsigned wrong = 0;
$RUNS
    return wrong > MAY_DIFFER ? wrong : 0U;
}

#ifndef DBO_NO_MAIN
int main(void) {
    const unsigned wrong = ${NAME}_self_test();
    if (wrong > 0)
        printf("$NAME: %u of $COUNT samples differ; were the flags as README.md says?\n", wrong);
    else
        printf("$NAME: $COUNT samples as expected\n");
    return wrong > 0;
}
#endif
