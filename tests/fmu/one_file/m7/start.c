/* Start-up code of a Cortex-M7 without operating system. */
#include <stdint.h>
#include <stdlib.h>

extern uint32_t stack_top, data_begin, data_end, data_source, zero_begin, zero_end;
extern void initialise_monitor_handles(void);
int main(void);
void reset(void);

void reset(void) {
    *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20; /* the floating-point unit */
    __asm__ volatile("dsb\n isb");
    for (uint32_t *to = &data_begin, *from = &data_source; to < &data_end;) {
        *to++ = *from++;
    }
    for (uint32_t *to = &zero_begin; to < &zero_end;) {
        *to++ = 0;
    }
    initialise_monitor_handles(); /* printf goes to the emulator */
    exit(main());
}

static void stop(void) {
    exit(3);
}

__attribute__((section(".vectors"), used)) static void (*const vectors[])(void) = {
    (void (*)(void))(uintptr_t)&stack_top, reset, stop, stop, stop, stop, stop,
};

/* Required by the C library, but without effect. */
void _init(void) {
}
void _fini(void) {
}
