/* A host in plain C that measures the time of a step and the size of an instance of an adaptive
 * FMU.
 *
 *     adaptive_host LIBRARY GUID JOINTS TAU_MEAS TAU_RIGID TAU STEPS
 *
 * Of tau_meas[1], tau_rigid[1] and tau[1] the value references are given; dq[i] have 0, 1, ..
 * It prints the time of a doStep [ns], that with inputs set and torques read, and the size of all
 * that an instance knows [B]. The measured torque is 1.2 times the last friction, so the factors
 * change. */
#include "host.h"

enum { MOST = 16 };

static double velocity(int k, int joint) {
    return 1.2 * bent_triangle(k, joint);
}

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

int main(int count, char **argument) {
    if (count < 8) {
        fail("usage: adaptive_host LIBRARY GUID JOINTS TAU_MEAS TAU_RIGID TAU STEPS");
    }
    void *library = load(argument[1]);
    const int joints = atoi(argument[3]), steps = atoi(argument[7]);
    if (!library || joints < 1 || joints > MOST) {
        fail("the library cannot be loaded");
    }
    FUNCTIONS
    FUNCTION(fmi2GetFMUstate)
    FUNCTION(fmi2FreeFMUstate)
    FUNCTION(fmi2SerializedFMUstateSize)
    BEGIN(argument[2], NULL)
    fmi2FMUstate state = NULL;
    size_t memory = 0;
    DO(fmi2GetFMUstate_(c, &state))
    DO(fmi2SerializedFMUstateSize_(c, state, &memory))
    DO(fmi2FreeFMUstate_(c, &state))
    fmi2ValueReference in[2 * MOST], tau[MOST];
    fmi2Real u[2 * MOST], y[MOST] = {0.0};
    for (int i = 0; i < joints; i++) {
        in[i] = (fmi2ValueReference)i;
        in[joints + i] = (fmi2ValueReference)(atoi(argument[4]) + i);
        tau[i] = (fmi2ValueReference)(atoi(argument[6]) + i);
    }
    double seconds[2] = {0.0, 0.0};           /* without and with the step */
    for (int timed = 0; timed < 3; timed++) { /* to warm up, then each */
        const double start = now();
        for (int k = 0; k < steps; k++) {
            for (int i = 0; i < joints; i++) {
                u[i] = velocity(k, i);
                u[joints + i] = 1.2 * y[i];
            }
            DO(fmi2SetReal_(c, in, 2 * (size_t)joints, u))
            if (timed != 1) {
                const int done = timed / 2 * steps + k;
                DO(fmi2DoStep_(c, done * STEP, STEP, fmi2True))
            }
            DO(fmi2GetReal_(c, tau, (size_t)joints, y))
        }
        seconds[timed / 2] = now() - start; /* of 0 and 1 the last */
    }
    printf("%.1f %.1f %zu\n", (seconds[1] - seconds[0]) / steps * 1e9, seconds[1] / steps * 1e9,
           memory);
    fmi2FreeInstance_(c);
    return 0;
}
