/* A host in plain C, without Python, that steps the FMU of an MJCF.
 *
 *     mjcf_host LIBRARY GUID RESOURCES INPUTS OUTPUTS STEPS         print the outputs of every step
 *     mjcf_host LIBRARY GUID RESOURCES INPUTS OUTPUTS STEPS time    print the time of a step [us]
 *
 * Inputs have the value references 0, 1, ..; outputs those that follow. A step is 5 ms. */
#include "host.h"

enum { MOST = 64 };

/* A triangle of velocity from -0.6 to 0.6, by additions and multiplications only. */
static double input(int k, int i) {
    const int place = (k + 37 * i) % 400;
    return 0.6 * ((place < 200 ? place : 400 - place) / 100.0 - 1.0);
}

int main(int count, char **argument) {
    if (count < 7) {
        fail("usage: mjcf_host LIBRARY GUID RESOURCES INPUTS OUTPUTS STEPS [time]");
    }
    void *library = load(argument[1]);
    const int inputs = atoi(argument[4]), outputs = atoi(argument[5]), steps = atoi(argument[6]);
    if (!library || inputs > MOST || outputs > MOST) {
        fail(library ? "too many variables" : "the library cannot be loaded");
    }
    FUNCTIONS
    BEGIN(argument[2], argument[3])
    fmi2ValueReference to[MOST], from[MOST];
    fmi2Real u[MOST], y[MOST];
    for (int i = 0; i < MOST; i++) {
        to[i] = (fmi2ValueReference)i;
        from[i] = (fmi2ValueReference)(inputs + i);
    }
    const clock_t start = clock();
    for (int k = 0; k < steps; k++) {
        for (int i = 0; i < inputs; i++) {
            u[i] = input(k, i);
        }
        DO(fmi2SetReal_(c, to, (size_t)inputs, u))
        DO(fmi2DoStep_(c, k * STEP, STEP, fmi2True))
        DO(fmi2GetReal_(c, from, (size_t)outputs, y))
        for (int i = 0; count == 7 && i < outputs; i++) {
            printf("%.17g%c", y[i], i + 1 < outputs ? ' ' : '\n');
        }
    }
    if (count > 7) {
        printf("%.2f\n", (double)(clock() - start) / CLOCKS_PER_SEC / steps * 1e6);
    }
    fmi2FreeInstance_(c);
    return 0;
}
