/* Instance of the FMU: its memory, and the calls it accepts in each state. */
#ifndef FMI2_INSTANCE_H
#define FMI2_INSTANCE_H

#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "component.h"
#include "fmi2.h"

/* States of the two state machines of the standard. */
enum {
    INSTANTIATED = 1,
    INITIALISING = 2,
    STEPPING = 4,    /* co-simulation */
    AT_EVENT = 8,    /* model exchange */
    CONTINUOUS = 16, /* model exchange */
    TERMINATED = 32,
    FAILED = 64,
    ANY = 127,
};

/* Functions of one interface type only, because both share some states. */
enum { ONLY_MODEL_EXCHANGE = 128, ONLY_CO_SIMULATION = 256 };

/* States where the standard allows groups of functions. */
enum {
    RUNNING = INITIALISING | STEPPING | AT_EVENT | CONTINUOUS,
    MAY_GET = RUNNING | TERMINATED | FAILED,
    MAY_SET = RUNNING | INSTANTIATED,
    MAY_SET_SLOPES = INSTANTIATED | INITIALISING | STEPPING | ONLY_CO_SIMULATION,
    MAY_GET_SLOPES = MAY_GET | ONLY_CO_SIMULATION,
    MAY_GET_STATUS = STEPPING | TERMINATED | FAILED | ONLY_CO_SIMULATION,
    MAY_CANCEL = ANY | ONLY_CO_SIMULATION,
    MAY_GET_CONTINUOUS = MAY_GET | ONLY_MODEL_EXCHANGE,
    MAY_GET_NOMINALS = MAY_GET_CONTINUOUS | INSTANTIATED,
    MAY_TERMINATE = STEPPING | AT_EVENT | CONTINUOUS,
};

/* Model exchange takes inputs within this fraction of their units for zero, more than the solver's
 * uncertainty about a crossing, so that none is found twice. */
static const double REST = 1e-9;

/* Some hosts retry a discarded step forever: return fmi2Error after this many identical retries. */
enum { MOST_REFUSALS = 10 };

/* Everything that GetFMUstate copies, free of pointers. */
typedef struct {
    Component component;
    double stop;    /* end of the experiment [s] */
    double refused; /* the last refused step [s] */
    int refusals;   /* consecutive refusals of that step */
    int type;       /* fmi2ModelExchange or fmi2CoSimulation */
    int mode;
    int sloped; /* whether any slope has been set */
    int stale;  /* whether the outputs are outdated */
    int paused; /* whether a co-simulation of FMI 3.0 is in event mode */
} Memory;

typedef struct {
    Memory memory;
    void *workspace;
    fmi2CallbackFunctions host;
    int telling_events;
    char *name; /* stored behind the instance */
} Instance;

/* Message categories. Reasons for a failed call are always reported. */
static const char ERRORS[] = "logStatusError";
static const char DISCARDS[] = "logStatusDiscard";
static const char EVENTS[] = "logEvents";
static const char ALL[] = "logAll";

static void tell(const Instance *instance, fmi2Status status, const char *category,
                 const char *format, va_list arguments) {
    char text[512];
    vsnprintf(text, sizeof text, format, arguments);
    /* The text is the format, because hosts without varargs show it unformatted. It never contains
     * a percent sign. */
    if (instance->host.logger) {
        instance->host.logger(instance->host.componentEnvironment, instance->name, status, category,
                              text);
    }
}

SELDOM static fmi2Status complain(const Instance *instance, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    tell(instance, fmi2Error, ERRORS, format, arguments);
    va_end(arguments);
    return fmi2Error;
}

/* Refuse a call that changed nothing; the simulation can continue. */
SELDOM static fmi2Status refuse(const Instance *instance, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    tell(instance, fmi2Discard, DISCARDS, format, arguments);
    va_end(arguments);
    return fmi2Discard;
}

SELDOM static void report(const Instance *instance, const char *format, ...) {
    va_list arguments;
    if (instance->telling_events) {
        va_start(arguments, format);
        tell(instance, fmi2OK, EVENTS, format, arguments);
        va_end(arguments);
    }
}

/* Return the instance if it accepts a call now, else NULL. */
static Instance *entered(fmi2Component c, int modes, const char *function) {
    Instance *instance = (Instance *)c;
    if (!instance) {
        return NULL;
    }
    const Memory *memory = &instance->memory;
    const int other = memory->type == fmi2ModelExchange ? ONLY_CO_SIMULATION : ONLY_MODEL_EXCHANGE;
    if (!(memory->mode & modes) || (modes & other)) {
        complain(instance, "%s is not allowed in this state of the instance.", function);
        return NULL;
    }
    return instance;
}

/* The same for a function that requires one of its arguments. */
static Instance *entered_with(fmi2Component c, int modes, const char *function,
                              const void *argument) {
    Instance *instance = entered(c, modes, function);
    if (instance && !argument) {
        complain(instance, "%s: an argument is NULL.", function);
        return NULL;
    }
    return instance;
}

/* Declare the instance of a call, or end the call if it is not accepted. */
#define ENTER(call)                                                                                \
    Instance *instance = call;                                                                     \
    if (!instance) {                                                                               \
        return fmi2Error;                                                                          \
    }

/* End the simulation: only reading, reset, restoring a state and freeing remain. */
static fmi2Status failed(Instance *instance) {
    instance->memory.mode = FAILED;
    return fmi2Error;
}

/* Report an error, then end the simulation. */
#define FAIL(...) (complain(__VA_ARGS__), failed(instance))

/* Whether sums of values are finite: false if one is not, or if they overflow. */
static bool sums_finite(const double *v, int count) {
    double a = 0.0, b = 0.0, c = 0.0, d = 0.0;
    int i = 0;
    for (; i + 4 <= count; i += 4) {
        a += v[watched[i]];
        b += v[watched[i + 1]];
        c += v[watched[i + 2]];
        d += v[watched[i + 3]];
    }
    for (; i < count; i++) {
        a += v[watched[i]];
    }
    return isfinite((a + b) + (c + d));
}

static bool all_finite(const Memory *memory, Message *why) {
    const int count = WATCHED + (memory->type == fmi2ModelExchange ? STATES : 0);
    for (int i = sums_finite(memory->component.v, count) ? count : 0; i < count; i++) {
        const double value = memory->component.v[watched[i]];
        if (!isfinite(value)) {
            return deny(why, "%s became %g at time %.9g.", variables[watched[i]].name, value,
                        memory->component.time);
        }
    }
    return true;
}

static double rest_of(const Memory *memory) {
    return memory->type == fmi2ModelExchange ? REST : 0.0;
}

/* Update the outputs if the results are finite; between events of model exchange without held
 * values. */
static bool refresh(Instance *instance, Message *why) {
    Memory *memory = &instance->memory;
    if (!memory->stale) {
        return true;
    }
    if (!(memory->mode & (AT_EVENT | CONTINUOUS))) {
        component_event(&memory->component, rest_of(memory), NULL);
    }
    memory->stale =
        !component_output(&memory->component, instance->workspace, why) || !all_finite(memory, why);
    return !memory->stale;
}

/* The same before reading: fmi2Discard if values are not finite. After a failure or termination the
 * last values are returned. */
static fmi2Status refreshed(Instance *instance) {
    Message why;
    if (!(instance->memory.mode & RUNNING) || refresh(instance, &why)) {
        return fmi2OK;
    }
    return refuse(instance, "%s", why.text);
}

SELDOM static void copy_guid(char guid[sizeof numbers.guid]) {
    for (size_t i = 0; i < sizeof numbers.guid; i++) {
        guid[i] = numbers.guid[i];
    }
}

static void set_start_values(Memory *memory, int type) {
    memset(memory, 0, sizeof *memory);
    for (int i = 0; i < VARIABLES; i++) {
        memory->component.v[i] = numbers.of[i].start;
    }
    memory->stop = INFINITY;
    memory->type = type;
    memory->component.continuous = type == fmi2ModelExchange;
    memory->mode = INSTANTIATED;
    memory->stale = true;
}

#endif
