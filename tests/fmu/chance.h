/* Parts of random lives: numbers, arguments of calls, failing allocations. */
#ifndef CHANCE_H
#define CHANCE_H

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi.h"

enum { MOST = 5, ROOM = MOST * (VARIABLES + INDICATORS + 1) };

/* State of an instance as seen by the host; PAUSED is event mode in co-simulation. */
enum {
    START = 1,
    INITIAL = 2,
    STEPS = 4,
    EVENT = 8,
    CONTINUOUS = 16,
    END = 32,
    FAILED = 64,
    PAUSED = 128,
    RUNNING = INITIAL | STEPS | EVENT | CONTINUOUS | PAUSED,
    ALWAYS = 255,
};

typedef struct {
    Fmu c;
    int type, options, mode, mode_of_state;
    State state;
    double time;
} Host;

/* Arguments of a call. They end with their arrays, so that reading past the end is detected. */
static Ref *vr;
static double *real;
static int *integer;
static Text *string;
static size_t n, n_values; /* of variables, and of their numbers */

static unsigned long calls, steps, derived, crossings, restored, by_status[6], messages;

static unsigned long fail_every, failed_allocations;

#ifdef WRAPPED
void *__real_malloc(size_t size);
void *__real_calloc(size_t n, size_t size);

static int to_fail(void) {
    static unsigned long allocations;
    const int fails = fail_every > 0 && ++allocations % fail_every == 0;
    failed_allocations += (unsigned long)fails;
    return fails;
}

void *__wrap_malloc(size_t size) {
    return to_fail() ? NULL : __real_malloc(size);
}

void *__wrap_calloc(size_t n_items, size_t size) {
    return to_fail() ? NULL : __real_calloc(n_items, size);
}
#endif

/* Fail on a forbidden result. */
static void wrong(const char *what, double found) {
    printf("%s: %g\n", what, found);
    exit(1);
}

static unsigned below(unsigned limit) {
    static uint64_t seed = 88172645463325252u;
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (unsigned)(seed % limit);
}

static double number(void) {
    static const double odd[] = {NAN, INFINITY, -INFINITY, 1e308, -1e308, 5e-324, 1e-10, 0.0};
    return below(300) ? (below(2001) - 1000.0) / 500.0 : odd[below(8)];
}

/* A pointer, sometimes NULL. */
#define OR_NULL(pointer) (below(300) ? (pointer) : NULL)

/* Whether variables are addressed one by one, rather than within an array. */
static int begins(Ref v) {
#if FMI == 3
    return extents[v] > 0;
#else
    (void)v;
    return 1;
#endif
}

static Ref reference(void) {
    Ref v = below(VARIABLES);
    while (below(100) &&
           !(begins(v) && (variables[v].role == INPUT || variables[v].role == OUTPUT))) {
        v = below(VARIABLES);
    }
    return below(200) ? v : VARIABLES + below(4);
}

static void choose_numbers(void) {
    static double all[ROOM];
    n_values = 0;
    for (size_t i = 0; i < n; i++) {
        n_values += size_at(vr[i]);
    }
    real = all + ROOM - n_values;
    for (size_t i = 0; i < n_values; i++) {
        real[i] = number();
    }
}

static void choose_arguments(void) {
    static const Text texts[] = {"logEvents", "logAll", "logStatusError", "", NULL, "x"};
    static Ref references_of[MOST];
    static int integers[MOST];
    static Text strings[MOST];
    n = below(MOST + 1);
    vr = references_of + MOST - n;
    integer = integers + MOST - n;
    string = strings + MOST - n;
    for (size_t i = 0; i < n; i++) {
        vr[i] = reference();
        integer[i] = below(50) ? 1 : (int)below(5) - 2;
        string[i] = texts[below(below(9) ? 3 : 6)];
    }
    choose_numbers();
}

/* Pass almost only inputs as arguments; none if there are no inputs. */
static void choose_inputs(void) {
    Ref any = 0;
    while (any < VARIABLES && variables[any].role != INPUT) {
        any++;
    }
    n = any < VARIABLES ? n : 0;
    for (size_t i = 0; i < n && below(200); i++) {
        while (vr[i] >= VARIABLES || variables[vr[i]].role != INPUT || !begins(vr[i])) {
            vr[i] = below(VARIABLES);
        }
    }
    choose_numbers();
}

/* Outputs whose derivatives are requested; returns their number. */
static size_t choose_unknowns(Ref unknown[MOST]) {
    const size_t count = below(MOST + 1);
    for (size_t i = 0; i < count; i++) {
        do {
            unknown[i] = below(VARIABLES);
        } while (below(200) && !(variables[unknown[i]].role == OUTPUT && begins(unknown[i])));
    }
    return count;
}

/* Values that were read; outputs of a running instance must be finite. */
static void look_at(const Host *h, const double value[]) {
    for (size_t i = 0, k = 0; i < n; k += size_at(vr[i++])) {
        for (size_t j = 0; j < size_at(vr[i]) && vr[i] < VARIABLES; j++) {
            if ((h->mode & RUNNING) && variables[vr[i] + j].role == OUTPUT &&
                !isfinite(value[k + j])) {
                wrong(variables[vr[i] + j].name, value[k + j]);
            }
        }
    }
}

static double length_of_step(void) {
    return below(200) ? 1e-4 * (below(2) ? 10 : 1 + below(30)) : number();
}

#endif
