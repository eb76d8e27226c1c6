/* A host in plain C that loads the binary of a drive FMU, on any platform, and steps it.
 *
 *     drive_host LIBRARY GUID JOINTS FIRST STEPS STEP TORQUE          print what every step gives
 *     drive_host LIBRARY GUID JOINTS FIRST STEPS STEP TORQUE time     print how long one takes [ns]
 *
 * Inputs tau_motor[i] have the value references 0, 1, ..; outputs dq[i] those from FIRST. The
 * torque swings between -TORQUE and TORQUE [N.m], made by additions and multiplications only, so it
 * is the same to the last digit everywhere. STEP is in s. */
#include "host.h"

enum { MOST = 16 };

int main(int count, char **argument) {
    if (count < 8) {
        fail("usage: drive_host LIBRARY GUID JOINTS FIRST STEPS STEP TORQUE [time]");
    }
    void *library = load(argument[1]);
    const int joints = atoi(argument[3]), steps = atoi(argument[5]);
    const double step = atof(argument[6]), torque = atof(argument[7]);
    if (!library || joints < 1 || joints > MOST) {
        fail("the library cannot be loaded");
    }
    FUNCTIONS
    BEGIN(argument[2], NULL)
    fmi2ValueReference in[MOST], out[MOST];
    fmi2Real u[MOST], y[MOST];
    double seconds = 0.0;
    const int timed = count > 8, shared = timed ? 100 : 1;
    for (int i = 0; i < joints; i++) {
        in[i] = (fmi2ValueReference)i;
        out[i] = (fmi2ValueReference)(atoi(argument[4]) + i);
    }
    /* When timed, a hundred steps share one input, so clock and setting hardly count. */
    for (int k = 0; k < steps; k++) {
        for (int i = 0; i < joints; i++) {
            u[i] = torque * bent_triangle(k, i);
        }
        DO(fmi2SetReal_(c, in, (size_t)joints, u))
        const clock_t start = timed ? clock() : 0;
        for (int n = 0; n < shared; n++) {
            DO(fmi2DoStep_(c, (shared * k + n) * step, step, fmi2True))
        }
        seconds += timed ? (double)(clock() - start) / CLOCKS_PER_SEC : 0.0;
        DO(fmi2GetReal_(c, out, (size_t)joints, y))
        for (int i = 0; !timed && i < joints; i++) {
            printf("%.17g%c", y[i], i + 1 < joints ? ' ' : '\n');
        }
    }
    if (timed) {
        printf("%.1f\n", seconds / steps / shared * 1e9);
    }
    fmi2FreeInstance_(c);
    return 0;
}
