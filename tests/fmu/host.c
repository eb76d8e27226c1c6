/* A host in plain C that loads the binary of a friction FMU, on any platform, and steps it.
 *
 *     host LIBRARY GUID JOINTS FIRST_TAU STEPS          print the torques of every step
 *     host LIBRARY GUID JOINTS FIRST_TAU STEPS time     print how long a doStep takes [ns]
 *     host LIBRARY GUID JOINTS FIRST_TAU STEPS loop     print how long set, doStep and get take
 *
 * Inputs dq[i] have the value references 0, 1, ..; outputs tau[i] those from FIRST_TAU. The motion
 * is made by additions and multiplications only, so it is the same to the last digit everywhere. */
#include "host.h"

enum { MOST = 16, ROWS = 400 };

/* A triangle of velocity with rests at its ends, from -1.2 to 1.2 rad/s. */
static double velocity(int k, int joint) {
    return 1.2 * bent_triangle(k, joint);
}

int main(int count, char **argument) {
    if (count < 6) {
        fail("usage: host LIBRARY GUID JOINTS FIRST_TAU STEPS [time | loop]");
    }
    void *library = load(argument[1]);
    const int joints = atoi(argument[3]), steps = atoi(argument[5]);
    if (!library || joints < 1 || joints > MOST) {
        fail("the library cannot be loaded");
    }
    FUNCTIONS
    BEGIN(argument[2], NULL)
    fmi2ValueReference dq[MOST], tau[MOST];
    fmi2Real u[MOST], y[MOST];
    double seconds = 0.0;
    const int timed = count > 6;
    for (int i = 0; i < joints; i++) {
        dq[i] = (fmi2ValueReference)i;
        tau[i] = (fmi2ValueReference)(atoi(argument[4]) + i);
    }
    if (timed && strcmp(argument[6], "loop") == 0) {
        static fmi2Real all[ROWS][MOST];
        for (int k = 0; k < ROWS * MOST; k++) {
            all[k / MOST][k % MOST] = velocity(k / MOST, k % MOST);
        }
        const clock_t start = clock();
        for (int k = 0; k < steps; k++) {
            DO(fmi2SetReal_(c, dq, (size_t)joints, all[k % ROWS]))
            DO(fmi2DoStep_(c, k * STEP, STEP, fmi2True))
            DO(fmi2GetReal_(c, tau, (size_t)joints, y))
        }
        printf("%.1f\n", (double)(clock() - start) / CLOCKS_PER_SEC / steps * 1e9);
        return 0;
    }
    /* When timed, a hundred steps share one input, so clock and setting hardly count. */
    for (int k = 0; k < steps; k++) {
        for (int i = 0; i < joints; i++) {
            u[i] = velocity(k, i);
        }
        DO(fmi2SetReal_(c, dq, (size_t)joints, u))
        const clock_t start = timed ? clock() : 0;
        for (int n = 0; n < (timed ? 100 : 1); n++) {
            DO(fmi2DoStep_(c, (timed ? 100 * k + n : k) * STEP, STEP, fmi2True))
        }
        seconds += timed ? (double)(clock() - start) / CLOCKS_PER_SEC : 0.0;
        DO(fmi2GetReal_(c, tau, (size_t)joints, y))
        for (int i = 0; !timed && i < joints; i++) {
            printf("%.17g%c", y[i], i + 1 < joints ? ' ' : '\n');
        }
    }
    if (timed) {
        printf("%.1f\n", seconds / steps / 100 * 1e9);
    }
    fmi2FreeInstance_(c);
    return 0;
}
