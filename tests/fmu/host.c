/* A host in plain C that loads the binary of a friction FMU, on any platform, and steps it.
 *
 *     host LIBRARY GUID JOINTS FIRST_TAU STEPS          print the torques of every step
 *     host LIBRARY GUID JOINTS FIRST_TAU STEPS time     print how long a doStep takes [ns]
 *
 * Inputs dq[i] have the value references 0, 1, ..; outputs tau[i] those from FIRST_TAU. The motion
 * is made by additions and multiplications only, so it is the same to the last digit everywhere. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmi2.h"

#ifdef _WIN32
#include <windows.h>
static void *load(const char *path) {
    return (void *)LoadLibraryA(path);
}
static void *find(void *library, const char *name) {
    FARPROC f = GetProcAddress((HMODULE)library, name);
    void *p = NULL;
    memcpy(&p, &f, sizeof p);
    return p;
}
#else
#include <dlfcn.h>
static void *load(const char *path) {
    return dlopen(path, RTLD_NOW | RTLD_LOCAL);
}
static void *find(void *library, const char *name) {
    return dlsym(library, name);
}
#endif

enum { MOST = 16 };
#define STEP 0.005

static void fail(const char *what) {
    fprintf(stderr, "%s\n", what);
    exit(1);
}

static void logger(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                   fmi2String category, fmi2String message, ...) {
    (void)environment, (void)instance, (void)status, (void)category;
    fprintf(stderr, "%s\n", message);
}

/* A function of the library, as one of its declared type. */
#define FUNCTION(name)                                                                             \
    __typeof__(&name) name##_ = NULL;                                                              \
    {                                                                                              \
        void *found = find(library, #name);                                                        \
        if (!found) {                                                                              \
            fail(#name " is missing");                                                             \
        }                                                                                          \
        memcpy(&name##_, &found, sizeof found);                                                    \
    }

#define DO(call)                                                                                   \
    if ((call) != fmi2OK) {                                                                        \
        fail(#call);                                                                               \
    }

/* A triangle of velocity with rests at its ends, from -1.2 to 1.2 rad/s. */
static double velocity(int k, int joint) {
    const int place = (k + 37 * joint) % 400;
    const double up = place < 200 ? place : 400 - place;
    const double shape = up / 100.0 - 1.0;
    return 1.2 * shape * (1.5 - 0.5 * shape * shape);
}

int main(int count, char **argument) {
    if (count < 6) {
        fail("usage: host LIBRARY GUID JOINTS FIRST_TAU STEPS [time]");
    }
    void *library = load(argument[1]);
    const int joints = atoi(argument[3]), steps = atoi(argument[5]);
    if (!library || joints < 1 || joints > MOST) {
        fail("the library cannot be loaded");
    }
    FUNCTION(fmi2Instantiate)
    FUNCTION(fmi2FreeInstance)
    FUNCTION(fmi2SetupExperiment)
    FUNCTION(fmi2EnterInitializationMode)
    FUNCTION(fmi2ExitInitializationMode)
    FUNCTION(fmi2SetReal)
    FUNCTION(fmi2GetReal)
    FUNCTION(fmi2DoStep)
    static const fmi2CallbackFunctions host = {logger, NULL, NULL, NULL, NULL};
    fmi2Component c =
        fmi2Instantiate_("host", fmi2CoSimulation, argument[2], NULL, &host, fmi2False, fmi2False);
    if (!c) {
        fail("no instance");
    }
    DO(fmi2SetupExperiment_(c, fmi2False, 0.0, 0.0, fmi2False, 0.0))
    DO(fmi2EnterInitializationMode_(c))
    DO(fmi2ExitInitializationMode_(c))
    fmi2ValueReference dq[MOST], tau[MOST];
    fmi2Real u[MOST], y[MOST];
    double seconds = 0.0;
    const int timed = count > 6;
    for (int i = 0; i < joints; i++) {
        dq[i] = (fmi2ValueReference)i;
        tau[i] = (fmi2ValueReference)(atoi(argument[4]) + i);
    }
    /* When timed, a hundred steps share one input: the clock and the setting do not count. */
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
