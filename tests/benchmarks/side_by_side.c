/* Time that ROBOTS robots take side by side [ns for a robot and step]; the argument is the number
 * of steps. The header is law.h. */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "law.h"

enum { ROBOTS = 64, JOINTS = LAW_JOINTS, ROWS = 256 };

static double seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

int main(int count, char **arguments) {
    static double x[(LAW_STATES + 1) * ROBOTS], tau[JOINTS * ROBOTS];
    static double dq[ROWS][JOINTS * ROBOTS], q[ROWS][JOINTS * ROBOTS], load[ROWS][JOINTS * ROBOTS];
    const int steps = count > 1 ? atoi(arguments[1]) : ROWS;
    law_state start;
    law_init(&start);
    for (int i = 0; i < LAW_STATES * ROBOTS; i++) {
        x[i] = start.x[i / ROBOTS];
    }
    for (int k = 0; k < ROWS; k++) {
        for (int i = 0; i < JOINTS * ROBOTS; i++) {
            const double t = 0.005 * k * (1.0 + 0.01 * i);
            dq[k][i] = sin(t);
            q[k][i] = -cos(t);
            load[k][i] = 20.0 * sin(q[k][i]);
        }
    }
    const double begin = seconds();
    for (int k = 0; k < steps; k++) {
        const int row = k % ROWS;
        if (law_side_by_side(law_coefficients, ROBOTS, x, dq[row], q[row], load[row], 0.005, tau) !=
            ROBOTS) {
            return 1;
        }
    }
    printf("%.17g\n", 1e9 * (seconds() - begin) / steps / ROBOTS);
    return 0;
}
