/* A host with two threads that repeatedly run their own instances; a thread sanitizer detects
 * shared data. */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>

#include "given.h"

enum { LIVES = 20, STEPS = 50, TWO = 2 };

static Text resources;

LOGGER {
}

static void *lead(void *steps) {
    for (int life = 0; life < LIVES; life++) {
        Fmu c = made("one", COUPLED_STEPS, MODEL_GUID, resources, 1, 1, 0);
        State state = NULL;
        start(c);
        begin(c);
        for (int k = 0; k < STEPS; k++) {
            for (Ref v = 0; v < VARIABLES; v++) {
                if (variables[v].role == INPUT && variables[v].type == REAL) {
                    set_at(c, v, 0.01 * (k % 7) - 0.02);
                } else if (variables[v].role == OUTPUT && variables[v].type == REAL) {
                    get_at(c, v);
                }
            }
            if (k % 10 == 3) {
                CALL(GetFMUstate)(c, &state);
                CALL(SetFMUstate)(c, state);
            }
            *(int *)steps += advance(c, 1e-3 * k, 1e-3) == OK;
        }
        CALL(FreeFMUstate)(c, &state);
        CALL(FreeInstance)(c);
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
