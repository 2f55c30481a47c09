/* TITLE
 * The self-test: that of each channel, which lies in a file of its own. On a computer: prints what differs and
 * exits with 1. On a target without a console compile all with -DDBO_NO_MAIN and call NAME_self_test. */
#ifndef DBO_NO_MAIN
#include <stdio.h>
#endif

/*+ prototypes */
unsigned NAME_self_test(void);

unsigned NAME_self_test(void) {
    unsigned wrong = 0;
/*+ runs */
    return wrong;
}

#ifndef DBO_NO_MAIN
int main(void) {
    const unsigned wrong = NAME_self_test();
    if (wrong > 0)
        printf("NAME: %u of VECTORS samples of COUNT channels differ; were the flags as README.md says?\n", wrong);
    else
        printf("NAME: VECTORS samples of COUNT channels, every bit as expected\n");
    return wrong > 0;
}
#endif
