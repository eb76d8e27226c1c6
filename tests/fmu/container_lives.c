/* A host that goes through random lives of several instances of a container.
 *
 *     container_lives LIBRARY GUID RESOURCES LIVES REFERENCE..
 *
 * A non-finite output or a failed call ends it. */
#include <math.h>
#include <stdint.h>

#include "host.h"

enum { MOST = 64, CROWD = 3, LONGEST = 20 };

/* Libraries stay loaded: permanent allocations of MuJoCo would count as leaks. */
int dlclose(void *library) {
    return library == NULL;
}

static uint64_t seed = 88172645463325252u;

static unsigned below(unsigned limit) {
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (unsigned)(seed % limit);
}

int main(int count, char **argument) {
    static const double lengths[] = {1e-3, 5e-3, 0.0123, 3.3e-4, 2e-14, 0.1};
    static const fmi2CallbackFunctions host = {logger, NULL, NULL, NULL, NULL};
    if (count < 6 || count > 5 + MOST) {
        fail("usage: container_lives LIBRARY GUID RESOURCES LIVES REFERENCE..");
    }
    void *library = load(argument[1]);
    if (!library) {
        fail("the library cannot be loaded");
    }
    FUNCTIONS
    FUNCTION(fmi2Reset)
    FUNCTION(fmi2Terminate)
    (void)fmi2SetReal_;
    const size_t outputs = (size_t)count - 5;
    fmi2ValueReference from[MOST];
    fmi2Real y[MOST];
    for (size_t i = 0; i < outputs; i++) {
        from[i] = (fmi2ValueReference)atoi(argument[5 + i]);
    }
    fmi2Component alive[CROWD] = {NULL};
    unsigned long steps = 0, resets = 0;
    for (int life = 0; life < atoi(argument[4]); life++) {
        fmi2Component *c = alive + below(CROWD);
        const int again = *c && below(2);
        if (again) {
            DO(fmi2Reset_(*c))
            resets++;
        } else {
            fmi2FreeInstance_(*c);
            *c = fmi2Instantiate_("host", fmi2CoSimulation, argument[2], argument[3], &host,
                                  fmi2False, fmi2False);
            if (!*c) {
                fail("no instance");
            }
        }
        double time = 0.1 * below(3);
        DO(fmi2SetupExperiment_(*c, fmi2False, 0.0, time, fmi2False, 0.0))
        DO(fmi2EnterInitializationMode_(*c))
        DO(fmi2ExitInitializationMode_(*c))
        for (unsigned k = below(LONGEST); k > 0; k--) {
            const double length = lengths[below(6)];
            DO(fmi2DoStep_(*c, time, length, fmi2True))
            time += length;
            steps++;
            DO(fmi2GetReal_(*c, from, outputs, y))
            for (size_t i = 0; i < outputs; i++) {
                if (!isfinite(y[i])) {
                    fail("an output is not finite");
                }
            }
        }
        DO(fmi2Terminate_(*c))
    }
    for (int i = 0; i < CROWD; i++) {
        fmi2FreeInstance_(alive[i]);
    }
    printf("%lu %lu\n", steps, resets);
    return 0;
}
