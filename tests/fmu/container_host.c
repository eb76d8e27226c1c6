/* A host in plain C that steps an FMU without inputs.
 *
 *     container_host LIBRARY GUID RESOURCES STEPS REFERENCE..    print outputs of every step
 *
 * A step is 5 ms. */
#include "host.h"

enum { MOST = 64 };

int main(int count, char **argument) {
    if (count < 6 || count > 5 + MOST) {
        fail("usage: container_host LIBRARY GUID RESOURCES STEPS REFERENCE..");
    }
    void *library = load(argument[1]);
    const int steps = atoi(argument[4]), outputs = count - 5;
    if (!library) {
        fail("the library cannot be loaded");
    }
    FUNCTIONS
    BEGIN(argument[2], argument[3])
    fmi2ValueReference from[MOST];
    fmi2Real y[MOST];
    for (int i = 0; i < outputs; i++) {
        from[i] = (fmi2ValueReference)atoi(argument[5 + i]);
    }
    (void)fmi2SetReal_;
    for (int k = 0; k < steps; k++) {
        DO(fmi2DoStep_(c, k * STEP, STEP, fmi2True))
        DO(fmi2GetReal_(c, from, (size_t)outputs, y))
        for (int i = 0; i < outputs; i++) {
            printf("%.17g%c", y[i], i + 1 < outputs ? ' ' : '\n');
        }
    }
    fmi2FreeInstance_(c);
    return 0;
}
