/* Steps of a plant from random states, with the sources of its FMU.
 *
 *     plant_states STARTS STEPS STEP SEED [VARIABLE=VALUE]...
 *
 * Prints the number of failed steps and the highest speed [rad/s], then the first reason. */
#include "plant.c"

#include <stdio.h>
#include <stdlib.h>

static uint64_t seed;

static double uniform(double low, double high) {
    seed = seed * 6364136223846793005u + 1442695040888963407u;
    return low + (high - low) * ((double)(seed >> 11) * 0x1p-53);
}

/* Of either sign, its size anywhere between two powers of ten; one of five is 0. */
static double any_size(double least, double most) {
    const double size = pow(10.0, uniform(least, most)), kind = uniform(0.0, 1.0);
    return kind < 0.2 ? 0.0 : kind < 0.6 ? size : -size;
}

static int place(const char *name) {
    for (int i = 0; i < VARIABLES; i++) {
        if (strcmp(variables[i].name, name) == 0) {
            return i;
        }
    }
    fprintf(stderr, "no variable %s\n", name);
    exit(2);
}

int main(int argc, char **argv) {
    static Component component, initial;
    static Message why, first;
    const long starts = atol(argv[1]), steps = atol(argv[2]);
    const double step = atof(argv[3]);
    long failed = 0;
    double fastest = 0.0;
    seed = (uint64_t)atol(argv[4]);
    for (int i = 0; i < VARIABLES; i++) {
        initial.v[i] = numbers.of[i].start;
    }
    initial.v[SUBSTEP] = step;
    for (int a = 5; a < argc; a++) {
        char *value = strchr(argv[a], '=');
        *value = '\0';
        initial.v[place(argv[a])] = atof(value + 1);
    }
    for (long n = 0; n < starts; n++) {
        component = initial;
        component.v[START_MODE] = 1.0 + (double)(n % 2);
        for (int i = 0; i < JOINTS; i++) {
            component.v[Q_START + i] = uniform(-3.0, 3.0);
            component.v[DQ_START + i] = any_size(-6.0, 0.5);
            component.v[TAU + i] = any_size(-1.0, 1.5);
        }
        if (!component_initialise(&component, NULL, &why)) {
            printf("%s\n", why.text);
            return 1;
        }
        for (long k = 0; k < steps; k++) {
            for (int i = 0; i < JOINTS; i++) {
                component.v[TAU + i] = any_size(-1.0, 1.5);
            }
            if (!component_step(&component, NULL, step, &why)) {
                first = failed++ ? first : why;
                break;
            }
            for (int i = 0; i < JOINTS; i++) {
                fastest = fmax(fastest, fabs(component.v[DQ + i]));
            }
        }
    }
    printf("%ld %g %s\n", failed, fastest, first.text);
    return 0;
}
