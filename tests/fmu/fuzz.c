/* A host that goes through thousands of random lives of an FMU's instances. It calls what the
 * standard allows, mostly, with right arguments, mostly. A sanitizer makes a failure of every error
 * of memory; the host itself one of an output that is not finite.
 *
 *     fuzz [LIVES [FAIL_EVERY [RESOURCES [NAME=VALUE ..]]]]
 *
 * Every so many allocations of the FMU fail, where it is linked with --wrap=malloc,--wrap=calloc.
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2.h"
#include "interface.h"
#include "given.h"

enum { LONGEST = 120, CROWD = 1000, MOST = 5 };

/* Where an instance is, as far as the host can tell; FIRST is what follows the initialisation. */
enum { START = 1, INITIAL = 2, STEPS = 4, EVENT = 8, CONTINUOUS = 16, END = 32, FAILED = 64 };
enum { RUNNING = INITIAL | STEPS | EVENT | CONTINUOUS, ALWAYS = 127, FIRST = -1, SAME = 0 };

typedef struct {
    fmi2Component c;
    fmi2Type type;
    fmi2FMUstate state;
    int mode, mode_of_state;
    double time;
} Host;

/* Arguments of a call. */
static fmi2ValueReference vr[MOST];
static fmi2Real real[MOST];
static fmi2Integer integer[MOST];
static fmi2String string[MOST];
static size_t n;

static uint64_t seed = 88172645463325252u;
static unsigned long calls, steps, derived, crossings, restored, by_status[6], messages;
static fmi2Byte bytes[1 << 20];
static size_t size_of_state;

static fmi2String resources;
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

static unsigned below(unsigned limit) {
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (unsigned)(seed % limit);
}

static double number(void) {
    static const double odd[] = {NAN, INFINITY, -INFINITY, 1e308, -1e308, 5e-324, 1e-10, 0.0};
    return below(300) ? (below(2001) - 1000.0) / 500.0 : odd[below(8)];
}

static fmi2ValueReference reference(void) {
    fmi2ValueReference v = below(VARIABLES);
    while (below(100) && variables[v].role != INPUT && variables[v].role != OUTPUT) {
        v = below(VARIABLES);
    }
    return below(1000) ? v : v + VARIABLES;
}

static void choose_arguments(void) {
    static const fmi2String texts[] = {"logEvents", "logAll", "logStatusError", "", NULL, "x"};
    n = below(MOST + 1);
    for (int i = 0; i < MOST; i++) {
        vr[i] = reference();
        real[i] = number();
        integer[i] = below(50) ? 1 : (fmi2Integer)below(5) - 2;
        string[i] = texts[below(below(9) ? 3 : 6)];
    }
}

/* How many references of inputs there are among the arguments: none where nothing is an input. */
static size_t some(void) {
    fmi2ValueReference v = 0;
    while (v < VARIABLES && variables[v].role != INPUT) {
        v++;
    }
    return v < VARIABLES ? n : 0;
}

/* References of inputs alone, nearly always. */
static const fmi2ValueReference *inputs(void) {
    for (int i = 0; i < MOST && some() && below(200); i++) {
        while (vr[i] >= VARIABLES || variables[vr[i]].role != INPUT) {
            vr[i] = below(VARIABLES);
        }
    }
    return vr;
}

/* A pointer, or now and then none. */
#define OR_NULL(pointer) (below(300) ? (pointer) : NULL)

static void logger(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                   fmi2String category, fmi2String message, ...) {
    (void)environment, (void)instance, (void)status, (void)category;
    messages += message[0] != 0;
}

static const fmi2CallbackFunctions callbacks = {logger, NULL, NULL, NULL, NULL};

static fmi2Component instantiate(fmi2Type type) {
    const fmi2Component c = fmi2Instantiate(OR_NULL("host"), below(300) ? type : (fmi2Type)7,
                                            below(300) ? MODEL_GUID : "{}", resources,
                                            OR_NULL(&callbacks), 0, (fmi2Boolean)below(2));
    start(c);
    return c;
}

/* The calls. */

static fmi2Status set_up(Host *h) {
    return fmi2SetupExperiment(h->c, 1, real[0], below(100) ? 0.0 : real[1], !below(9), real[2]);
}

static fmi2Status reset(Host *h) {
    h->time = 0.0;
    const fmi2Status status = fmi2Reset(h->c);
    start(h->c);
    return status;
}

static fmi2Status set_logging(Host *h) {
    return fmi2SetDebugLogging(h->c, (fmi2Boolean)below(2), n, OR_NULL(string));
}

static fmi2Status get_real(Host *h) {
    const fmi2Status status = fmi2GetReal(h->c, OR_NULL(vr), n, OR_NULL(real));
    for (size_t i = 0; status == fmi2OK && (h->mode & RUNNING) && i < n; i++) {
        if (variables[vr[i]].role == OUTPUT && !isfinite(real[i])) {
            printf("%s is %g\n", variables[vr[i]].name, real[i]);
            exit(1);
        }
    }
    return status;
}

static fmi2Status set_inputs(Host *h) {
    return fmi2SetReal(h->c, OR_NULL(inputs()), some(), OR_NULL(real));
}

static fmi2Status set_real(Host *h) {
    return fmi2SetReal(h->c, vr, n, real);
}

static fmi2Status get_or_set_others(Host *h) {
    const size_t few = below(9) ? 0 : n;
    switch (below(7)) {
    case 0:
        return fmi2GetInteger(h->c, vr, few, integer);
    case 1:
        return fmi2GetBoolean(h->c, vr, few, integer);
    case 2:
        return fmi2GetString(h->c, vr, few, string);
    case 3:
        return fmi2SetInteger(h->c, vr, few, integer);
    case 4:
        return fmi2SetBoolean(h->c, vr, few, integer);
    case 5:
        return fmi2SetString(h->c, vr, few, string);
    default:
        return fmi2GetRealOutputDerivatives(h->c, vr, few, integer, real);
    }
}

static fmi2Status get_state(Host *h) {
    h->mode_of_state = h->mode;
    return fmi2GetFMUstate(h->c, OR_NULL(&h->state));
}

static fmi2Status set_state(Host *h) {
    if (!h->state && below(99)) {
        return get_state(h);
    }
    const fmi2Status status = fmi2SetFMUstate(h->c, h->state);
    if (status == fmi2OK) {
        h->mode = h->mode_of_state;
        restored++;
    }
    return status;
}

static fmi2Status free_state(Host *h) {
    return fmi2FreeFMUstate(h->c, OR_NULL(&h->state));
}

static fmi2Status serialise(Host *h) {
    if (!h->state && below(99)) {
        return get_state(h);
    }
    fmi2SerializedFMUstateSize(h->c, h->state, OR_NULL(&size_of_state));
    if (size_of_state > sizeof bytes) {
        exit(1);
    }
    return fmi2SerializeFMUstate(h->c, h->state, OR_NULL(bytes), size_of_state - !below(99));
}

/* Bytes of an earlier life, which may have been of the other type: used in few lives. */
static fmi2Status deserialise(Host *h) {
    if (below(20)) {
        return get_state(h);
    }
    h->mode_of_state = START;
    return fmi2DeSerializeFMUstate(h->c, OR_NULL(bytes), size_of_state - !below(9), &h->state);
}

static fmi2Status derive(Host *h) {
    fmi2ValueReference unknown[MOST];
    for (int i = 0; i < MOST; i++) {
        do {
            unknown[i] = below(VARIABLES);
        } while (below(200) && variables[unknown[i]].role != OUTPUT);
    }
    const fmi2Status status = fmi2GetDirectionalDerivative(
        h->c, OR_NULL(unknown), below(MOST + 1), OR_NULL(inputs()), some(), OR_NULL(real), real);
    derived += status == fmi2OK;
    return status;
}

static fmi2Status step(Host *h) {
    const double length = below(200) ? 1e-4 * (below(2) ? 10 : 1 + below(30)) : real[1];
    const fmi2Status status = fmi2DoStep(h->c, below(200) ? h->time : real[0], length, fmi2True);
    h->time += status == fmi2OK ? length : 0.0;
    steps += status == fmi2OK;
    return status;
}

static fmi2Status set_slopes(Host *h) {
    return fmi2SetRealInputDerivatives(h->c, OR_NULL(inputs()), some(), OR_NULL(integer),
                                       OR_NULL(real));
}

static fmi2Status get_status(Host *h) {
    fmi2Status status;
    switch (below(6)) {
    case 0:
        return fmi2GetStatus(h->c, fmi2DoStepStatus, &status);
    case 1:
        return fmi2GetRealStatus(h->c, fmi2LastSuccessfulTime, OR_NULL(real));
    case 2:
        return fmi2GetIntegerStatus(h->c, fmi2DoStepStatus, integer);
    case 3:
        return fmi2GetBooleanStatus(h->c, fmi2Terminated, OR_NULL(integer));
    case 4:
        return fmi2GetStringStatus(h->c, fmi2PendingStatus, string);
    default:
        return fmi2CancelStep(h->c) == fmi2Error ? fmi2OK : fmi2Fatal;
    }
}

static fmi2Status new_discrete_states(Host *h) {
    fmi2EventInfo info;
    return fmi2NewDiscreteStates(h->c, OR_NULL(&info));
}

static fmi2Status complete(Host *h) {
    fmi2Boolean event = fmi2False, end;
    const fmi2Status status =
        fmi2CompletedIntegratorStep(h->c, fmi2True, OR_NULL(&event), OR_NULL(&end));
    crossings += status == fmi2OK && event;
    return status;
}

static fmi2Status set_time(Host *h) {
    return fmi2SetTime(h->c, real[0]);
}

static fmi2Status exchange_states(Host *h) {
    fmi2Real array[STATES + INDICATORS + 2];
    const size_t states_of = below(100) ? STATES : below(STATES + 2);
    const size_t indicators_of = below(100) ? INDICATORS : below(INDICATORS + 2);
    for (int i = 0; i < STATES + INDICATORS + 2; i++) {
        array[i] = 0.1 * number();
    }
    switch (below(5)) {
    case 0:
        return fmi2GetContinuousStates(h->c, OR_NULL(array), states_of);
    case 1:
        return fmi2GetDerivatives(h->c, OR_NULL(array), states_of);
    case 2:
        return fmi2GetNominalsOfContinuousStates(h->c, OR_NULL(array), states_of);
    case 3:
        return fmi2GetEventIndicators(h->c, OR_NULL(array), indicators_of);
    default:
        return h->mode == CONTINUOUS ? fmi2SetContinuousStates(h->c, OR_NULL(array), states_of)
                                     : fmi2OK;
    }
}

/* Which call is right where, how often it is to be tried, and where it leads. */
static const struct {
    fmi2Status (*call)(Host *);
    fmi2Status (*plain)(fmi2Component);
    int modes, often, next;
} actions[] = {
    {set_up, NULL, START, 2, SAME},
    {NULL, fmi2EnterInitializationMode, START, 5, INITIAL},
    {NULL, fmi2ExitInitializationMode, INITIAL, 9, FIRST},
    {NULL, fmi2Terminate, STEPS | EVENT | CONTINUOUS, 1, END},
    {reset, NULL, STEPS | EVENT | CONTINUOUS, 1, START},
    {reset, NULL, END | FAILED, 9, START},
    {set_logging, NULL, ALWAYS, 2, SAME},
    {get_real, NULL, RUNNING | END | FAILED, 8, SAME},
    {set_inputs, NULL, START | RUNNING, 8, SAME},
    {set_real, NULL, START, 1, SAME},
    {get_or_set_others, NULL, INITIAL | STEPS | EVENT, 1, SAME},
    {get_state, NULL, ALWAYS & ~FAILED, 2, SAME},
    {set_state, NULL, ALWAYS, 2, SAME},
    {free_state, NULL, ALWAYS, 1, SAME},
    {serialise, NULL, ALWAYS, 2, SAME},
    {deserialise, NULL, ALWAYS, 2, SAME},
    {derive, NULL, RUNNING | END | FAILED, 4, SAME},
    {step, NULL, STEPS, 20, SAME},
    {set_slopes, NULL, START | STEPS, 4, SAME},
    {get_status, NULL, STEPS | END, 2, SAME},
    {NULL, fmi2EnterEventMode, CONTINUOUS, 6, EVENT},
    {new_discrete_states, NULL, EVENT, 6, SAME},
    {NULL, fmi2EnterContinuousTimeMode, EVENT, 6, CONTINUOUS},
    {complete, NULL, CONTINUOUS, 8, SAME},
    {set_time, NULL, EVENT | CONTINUOUS, 4, SAME},
    {exchange_states, NULL, EVENT | CONTINUOUS, 8, SAME},
};

static void act(Host *h) {
    size_t i;
    do {
        i = below(sizeof actions / sizeof *actions);
    } while (below(20) >= (unsigned)actions[i].often ||
             (!(actions[i].modes & h->mode) && below(1000)));
    choose_arguments();
    const fmi2Status status = actions[i].call ? actions[i].call(h) : actions[i].plain(h->c);
    calls++;
    by_status[status]++;
    if (status == fmi2Error) {
        h->mode = FAILED;
    } else if (status == fmi2OK && actions[i].next == FIRST) {
        h->mode = h->type == fmi2ModelExchange ? EVENT : STEPS;
    } else if (status == fmi2OK && actions[i].next != SAME) {
        h->mode = actions[i].next;
    }
}

static void live(void) {
    Host h = {.type = below(2) ? fmi2CoSimulation : fmi2ModelExchange, .mode = START};
    h.c = instantiate(h.type);
    for (unsigned left = below(LONGEST); left > 0; left--) {
        act(&h);
    }
    fmi2FreeFMUstate(h.c, &h.state);
    fmi2FreeInstance(h.c);
}

/* Many instances at the same time. */
static void live_together(int many) {
    fmi2Component crowd[CROWD];
    for (int i = 0; i < many; i++) {
        crowd[i] = fmi2Instantiate("one of many", fmi2CoSimulation, MODEL_GUID, resources,
                                   &callbacks, 0, 0);
        start(crowd[i]);
        fmi2SetupExperiment(crowd[i], 0, 0.0, 0.0, 0, 0.0);
        fmi2EnterInitializationMode(crowd[i]);
        fmi2ExitInitializationMode(crowd[i]);
    }
    for (int k = 0; k < 5; k++) {
        for (int i = 0; i < many; i++) {
            steps += fmi2DoStep(crowd[i], 1e-3 * k, 1e-3, fmi2True) == fmi2OK;
        }
    }
    for (int i = 0; i < many; i++) {
        fmi2FreeInstance(crowd[i]);
    }
}

int main(int count, char **arguments) {
    const long lives = count > 1 ? atol(arguments[1]) : 10000;
    fail_every = count > 2 ? strtoul(arguments[2], NULL, 10) : 0;
    resources = count > 3 ? arguments[3] : NULL;
    given = count > 4 ? arguments + 4 : NULL;
    live_together(lives < CROWD ? (int)lives : CROWD);
    for (long i = 0; i < lives; i++) {
        live();
    }
    /* For the test to see that much has happened. */
    printf("{\"calls\": %lu, \"steps\": %lu, \"derivatives\": %lu, \"events\": %lu, "
           "\"restored\": %lu, \"refusals\": %lu, \"errors\": %lu, \"messages\": %lu, "
           "\"failed_allocations\": %lu}\n",
           calls, steps, derived, crossings, restored, by_status[fmi2Discard], by_status[fmi2Error],
           messages, failed_allocations);
    return by_status[fmi2Fatal] > 0;
}
