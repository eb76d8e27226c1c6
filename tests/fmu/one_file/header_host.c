/* A program on any processor that runs a generated header, as tests/fmu/host.c runs an FMU.
 *
 * The header is law.h; STEPS is defined outside. */
#include <stdio.h>

#include "law.h"
#include "motion.h"

enum { JOINTS = LAW_JOINTS };

#ifdef COUNTER
#include "counter.h"
#else
static void counter_start(void) {
}
static void counter_stop(void) {
}
static void counter_print(int steps) {
    (void)steps;
}
#endif

/* A triangle of velocity with rests at its ends, from -1.2 to 1.2 rad/s. */
static double velocity(int k, int joint) {
    return 1.2 * bent_triangle(k, joint);
}

int main(void) {
    static law_state state;
    static double tau[JOINTS], dq[JOINTS];
    static const double zero[JOINTS];
    law_init(&state);
    for (int k = 0; k < STEPS; k++) {
        for (int i = 0; i < JOINTS; i++) {
            dq[i] = velocity(k, i);
        }
        counter_start();
        const bool moved = law_step(&state, dq, zero, zero, 0.005, tau);
        counter_stop();
        if (!moved) {
            return 1;
        }
        for (int i = 0; i < JOINTS; i++) {
            printf("%.17g%c", tau[i], i + 1 < JOINTS ? ' ' : '\n');
        }
    }
    counter_print(STEPS);
    return 0;
}
