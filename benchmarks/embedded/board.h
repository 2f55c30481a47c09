/* What a board of the emulator gives: a clock that counts instructions, and text for the host. */
#ifndef BOARD_H
#define BOARD_H
#include <stdint.h>

void board_begin(void);
uint32_t board_clock(void);                        /* ticks, modulo 2^24 or more */
uint32_t board_since(uint32_t begin);
void board_print(const char *text);
void board_end(void);
void thousand_nothings(void);                      /* 1000 nops: how many ticks an instruction is */
extern uint8_t stack_bottom[], stack_top[];

/* A compiler may call these two for any loop. */
#include <stddef.h>
void *memset(void *to, int value, size_t size);
void *memcpy(void *to, const void *from, size_t size);

#endif
