/* On a Cortex-M in QEMU: the self-test of an export, then instructions a step. `moves.h` has the inputs, and `number`,
 * the type of what goes in and comes out. QEMU counts: with -icount the clock of SysTick goes by instructions. */
#include <stddef.h>

#include "x_test.c"
#include "moves.h"

extern uint32_t data_begin[], data_end[], data_source[], bss_begin[], bss_end[], stack_top[];
int main(void);
void on_reset(void);

/* ---- the board ---- */

static int host(int call, const void *argument) { /* semihosting */
    register int r0 __asm__("r0") = call;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static void end(void) {
    host(0x18, (const void *)0x20026);
    for (;;) {}
}

static void on_fault(void) {
    host(4, "fault\n");
    end();
}

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    stack_top, (const void *)on_reset, (const void *)on_fault, (const void *)on_fault,
    (const void *)on_fault, (const void *)on_fault, (const void *)on_fault};

void on_reset(void) {
    const uint32_t *from = data_source;
    for (uint32_t *to = data_begin; to < data_end;) *to++ = *from++;
    for (uint32_t *to = bss_begin; to < bss_end;) *to++ = 0;
#if defined(__ARM_FP)
    *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20; /* the floating-point unit is off at reset */
    __asm__ volatile("dsb\n isb");
#endif
    main();
    end();
}

void *memset(void *to, int value, size_t size) { /* a compiler may call these two for any loop */
    volatile uint8_t *p = (uint8_t *)to;
    while (size-- > 0) *p++ = (uint8_t)value;
    return to;
}

void *memcpy(void *to, const void *from, size_t size) {
    volatile uint8_t *p = (uint8_t *)to;
    const uint8_t *q = (const uint8_t *)from;
    while (size-- > 0) *p++ = *q++;
    return to;
}

static volatile uint32_t *const systick = (volatile uint32_t *)0xE000E010u;
static uint32_t since(uint32_t begin) { return (begin - systick[2]) & 0xFFFFFFu; }
__attribute__((noinline)) static void thousand_nothings(void) { __asm__ volatile(".rept 1000\n nop\n .endr"); }

/* ---- the figures ---- */

static char line[80];
static unsigned at;

static void print_number(uint32_t value) {
    char digits[12];
    unsigned count = 0;
    do digits[count++] = (char)('0' + value % 10u);
    while ((value /= 10u) > 0u);
    line[at++] = ' ';
    while (count > 0) line[at++] = digits[--count];
}

static x_state state;

/* Play inputs; returns the instructions of all steps, and puts those of the costliest into `most`. */
static uint32_t timed(const number *inputs, unsigned count, uint32_t thousand, uint32_t *most) {
    uint64_t sum = 0;
    uint32_t worst = 0;
    for (unsigned k = 0; k < count; k++) {
        volatile number output;
        const uint32_t begin = systick[2];
        output = x_step(&state, inputs[k]);
        const uint32_t ticks = since(begin);
        (void)output;
        sum += ticks;
        if (ticks > worst) worst = ticks;
    }
    *most = (uint32_t)((uint64_t)worst * 1000u / thousand);
    return (uint32_t)(sum * 1000u / thousand);
}

int main(void) {
    uint32_t begin, thousand, sum, worst, jump;
    systick[1] = 0xFFFFFF;
    systick[2] = 0;
    systick[0] = 5;
    begin = systick[2];
    thousand_nothings();
    thousand = since(begin);
    print_number(x_self_test());
    x_init(&state);
    sum = timed(moves, MOVES, thousand, &worst);
    timed(jumps, JUMPS, thousand, &jump);
    print_number(sum / MOVES);
    print_number(worst);
    print_number(jump);
    print_number((uint32_t)sizeof(x_state));
    line[at++] = '\n';
    line[at] = 0;
    host(4, line);
    return 0;
}
