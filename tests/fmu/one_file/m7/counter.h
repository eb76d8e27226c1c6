/* Instructions of a Cortex-M7 in QEMU: with -icount shift=0 an instruction takes 1 ns of its time,
 * so a tick of SysTick, which counts down at 25 MHz, is 40 of them. */
#ifndef COUNTER_H
#define COUNTER_H

#include <stdint.h>

#define SYSTICK ((volatile uint32_t *)0xE000E010u) /* control, reload, value */
enum { ALL = 0xFFFFFF, INSTRUCTIONS_OF_TICK = 40 };

static uint32_t began;
static double ticks;

static void counter_start(void) {
    SYSTICK[1] = ALL;
    SYSTICK[0] = 5; /* on, at the processor's clock */
    began = SYSTICK[2];
}

static void counter_stop(void) {
    ticks += (double)((began - SYSTICK[2]) & ALL);
}

static void counter_print(int steps) {
    printf("%.0f instructions a step\n", ticks * INSTRUCTIONS_OF_TICK / steps);
}

#endif
