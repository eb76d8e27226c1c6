/* A host with two threads, each of which leads an instance of its own through its life, again and
 * again; a sanitizer for threads sees whatever they share. */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi2.h"
#include "interface.h"
#include "given.h"

enum { LIVES = 20, STEPS = 50, TWO = 2 };

static fmi2String resources;

static void logger(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                   fmi2String category, fmi2String message, ...) {
    (void)environment, (void)instance, (void)status, (void)category, (void)message;
}

static const fmi2CallbackFunctions callbacks = {logger, NULL, NULL, NULL, NULL};

static void *lead(void *steps) {
    for (int life = 0; life < LIVES; life++) {
        fmi2Component c =
            fmi2Instantiate("one", fmi2CoSimulation, MODEL_GUID, resources, &callbacks, 0, 1);
        fmi2FMUstate state = NULL;
        start(c);
        fmi2SetupExperiment(c, 0, 0.0, 0.0, 0, 0.0);
        fmi2EnterInitializationMode(c);
        fmi2ExitInitializationMode(c);
        for (int k = 0; k < STEPS; k++) {
            for (fmi2ValueReference v = 0; v < VARIABLES; v++) {
                fmi2Real value = 0.01 * (k % 7) - 0.02;
                if (variables[v].role == INPUT && variables[v].type == REAL) {
                    fmi2SetReal(c, &v, 1, &value);
                } else if (variables[v].role == OUTPUT && variables[v].type == REAL) {
                    fmi2GetReal(c, &v, 1, &value);
                }
            }
            if (k % 10 == 3) {
                fmi2GetFMUstate(c, &state);
                fmi2SetFMUstate(c, state);
            }
            *(int *)steps += fmi2DoStep(c, 1e-3 * k, 1e-3, fmi2True) == fmi2OK;
        }
        fmi2FreeFMUstate(c, &state);
        fmi2FreeInstance(c);
    }
    return NULL;
}

int main(int count, char **arguments) {
    pthread_t threads[TWO];
    int steps[TWO] = {0};
    resources = count > 1 ? arguments[1] : NULL;
    given = count > 2 ? arguments + 2 : NULL;
    for (int i = 0; i < TWO; i++) {
        pthread_create(&threads[i], NULL, lead, &steps[i]);
    }
    for (int i = 0; i < TWO; i++) {
        pthread_join(threads[i], NULL);
    }
    printf("%d %d\n", steps[0], steps[1]);
    return 0;
}
