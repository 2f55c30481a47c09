/* The self-test of an export, then instructions a step and the stack it takes. `moves.h` has the inputs, and
 * TEST names the export's test file; with PLAYS the play operators of plays.h are measured instead. */
#include "board.h"

#if defined(PLAYS)
#include "plays.h"
#else
#include TEST
#endif
#include "moves.h"

static char line[200];
static unsigned at;

static void word(const char *text) {
    while (*text) line[at++] = *text++;
}

static void number(uint32_t value) {
    char digits[12];
    unsigned count = 0;
    do digits[count++] = (char)('0' + value % 10u);
    while ((value /= 10u) > 0u);
    line[at++] = ' ';
    while (count > 0) line[at++] = digits[--count];
}

static x_state state;

__attribute__((noinline)) static number_type nothing(number_type x) {
    __asm__ volatile("" ::: "memory");
    return x;
}

/* Free stack is painted (volatile, or the compiler leaves it out); what is no longer is the depth of a call. */
__attribute__((noinline)) static volatile uint8_t *mark(void) {
    volatile uint8_t *end = (volatile uint8_t *)__builtin_frame_address(0) - 128;
    for (volatile uint8_t *p = end - 2048; p < end; p++) *p = 0xA5;
    return end;
}

__attribute__((noinline)) static uint32_t depth(const volatile uint8_t *end) {
    const volatile uint8_t *p = end - 2048;
    while (p < end && *p == 0xA5) p++;
    return (uint32_t)(end - p) + 128u;
}

int main(void) {
    volatile number_type sink;
    uint32_t wrong = 0, base, unit, begin, most = 0, full = 0, settled = 0, stack;
    uint64_t sum = 0;
    volatile uint8_t *end;
    board_begin();
    begin = board_clock();
    thousand_nothings();
    unit = board_since(begin);
#if !defined(PLAYS)
    wrong = x_self_test();
#endif
    x_init(&state);
    begin = board_clock();
    sink = nothing(moves[0]);
    base = board_since(begin);
    sink = x_step(&state, moves[0]);
    for (unsigned k = 1; k < MOVES; k++) {
        uint32_t ticks;
        begin = board_clock();
        sink = x_step(&state, moves[k]);
        ticks = board_since(begin) - base;
        sum += ticks;
        if (ticks > most) most = ticks;
    }
    for (unsigned k = 0; k < JUMPS; k++) { /* from the ends to everywhere and back, each in one step */
        uint32_t ticks;
        begin = board_clock();
        sink = x_step(&state, jumps[k]);
        ticks = board_since(begin) - base;
        if (ticks > full) full = ticks;
    }
#if !defined(PLAYS)
    for (unsigned k = 0; k < 2; k++) { /* from a decayed oscillation about the middle to either end */
        uint32_t ticks;
        x_reset(&state, resets[k]);
        begin = board_clock();
        sink = x_step(&state, jumps[64 * k]);
        ticks = board_since(begin) - base;
        if (ticks > settled) settled = ticks;
    }
#endif
    end = mark();
    sink = x_step(&state, moves[MOVES / 3]);
    sink = x_step(&state, jumps[JUMPS - 1]);
    stack = depth(end);
    (void)sink;
    word("result");
    number(wrong);
    number((uint32_t)(sum * 1000u / unit / (MOVES - 1u)));
    number((uint32_t)((uint64_t)most * 1000u / unit));
    number((uint32_t)((uint64_t)full * 1000u / unit));
    number((uint32_t)((uint64_t)settled * 1000u / unit));
    number(stack);
    word("\n");
    line[at] = 0;
    board_print(line);
    return 0;
}
