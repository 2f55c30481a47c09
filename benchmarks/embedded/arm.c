/* Cortex-M in QEMU: vectors, memory as the linker script lays it out, SysTick, semihosting. */
#include "board.h"

extern uint32_t data_begin[], data_end[], data_source[], bss_begin[], bss_end[];
int main(void);
void on_reset(void);
static void on_fault(void);

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    stack_top,        (const void *)on_reset, (const void *)on_fault, (const void *)on_fault,
    (const void *)on_fault, (const void *)on_fault, (const void *)on_fault};

static int host(int call, const void *argument) {
    register int r0 __asm__("r0") = call;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

void board_print(const char *text) { host(4, text); }
void board_end(void) {
    host(0x18, (const void *)0x20026);
    for (;;) {}
}

static void on_fault(void) {
    board_print("fault\n");
    board_end();
}

static volatile uint32_t *const systick = (volatile uint32_t *)0xE000E010u;

void board_begin(void) {
    systick[1] = 0xFFFFFF;
    systick[2] = 0;
    systick[0] = 5;
}
uint32_t board_clock(void) { return systick[2]; }
uint32_t board_since(uint32_t begin) { return (begin - systick[2]) & 0xFFFFFF; }

__attribute__((noinline)) void thousand_nothings(void) { __asm__ volatile(".rept 1000\n nop\n .endr"); }

void on_reset(void) {
    const uint32_t *from = data_source;
    for (uint32_t *to = data_begin; to < data_end;) *to++ = *from++;
    for (uint32_t *to = bss_begin; to < bss_end;) *to++ = 0;
#if defined(__ARM_FP)
    *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20; /* the floating-point unit is off at reset */
    __asm__ volatile("dsb\n isb");
#endif
    main();
    board_end();
}

void *memset(void *to, int value, size_t size) {
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
