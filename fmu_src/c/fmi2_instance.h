/* An instance of the FMU: what it remembers, and which calls it accepts when. */
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

/* The states of the standard's two state machines; slaves have synchronous steps only. */
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

/* Functions of one type alone, since both types share some states. */
enum { ONLY_MODEL_EXCHANGE = 128, ONLY_CO_SIMULATION = 256 };

/* For each group of functions the states in which the standard allows it. */
enum {
    RUNNING = INITIALISING | STEPPING | AT_EVENT | CONTINUOUS,
    MAY_SET_UP = INSTANTIATED,
    MAY_ENTER_INITIALISATION = INSTANTIATED,
    MAY_EXIT_INITIALISATION = INITIALISING,
    MAY_GET = RUNNING | TERMINATED | FAILED,
    MAY_SET = RUNNING | INSTANTIATED,
    MAY_STEP = STEPPING,
    MAY_SET_SLOPES = INSTANTIATED | INITIALISING | STEPPING | ONLY_CO_SIMULATION,
    MAY_GET_SLOPES = MAY_GET | ONLY_CO_SIMULATION,
    MAY_GET_STATUS = STEPPING | TERMINATED | FAILED | ONLY_CO_SIMULATION,
    MAY_CANCEL = ANY | ONLY_CO_SIMULATION,
    MAY_GET_CONTINUOUS = MAY_GET | ONLY_MODEL_EXCHANGE,
    MAY_GET_NOMINALS = MAY_GET_CONTINUOUS | INSTANTIATED,
    MAY_SET_TIME = AT_EVENT | CONTINUOUS,
    MAY_ENTER_EVENT = AT_EVENT | CONTINUOUS,
    MAY_TERMINATE = STEPPING | AT_EVENT | CONTINUOUS,
    MAY_DEBUG = ANY,
    MAY_COPY_STATE = ANY,
};

/* In model exchange an input nearer to zero than this many of its units counts as zero. That is
 * wider than a solver is uncertain of where a zero lies, so no crossing is found twice. */
static const double REST = 1e-9;

/* Some hosts repeat a step that is refused, without another one in between, until somebody ends
 * them. So often it is fmi2Discard, then an error. */
enum { MOST_REFUSALS = 10 };

/* All that GetFMUstate copies: it holds no pointers. */
typedef struct {
    Component component;
    double stop;    /* end of the experiment [s] */
    double refused; /* the step that was refused last [s] */
    int refusals;   /* how many times, without another step in between */
    int type;       /* fmi2ModelExchange or fmi2CoSimulation */
    int mode;
    int sloped; /* whether any slope has been set */
    int stale;  /* whether the outputs are older than what they depend on */
    int paused; /* whether a co-simulation of FMI 3.0 is at an event */
} Memory;

typedef struct {
    Memory memory;
    void *workspace; /* of the component */
    fmi2CallbackFunctions host;
    int telling_events;
    char name[]; /* of the instance */
} Instance;

/* Categories of messages. Why a call did not do what it should is always told. */
static const char ERRORS[] = "logStatusError";
static const char DISCARDS[] = "logStatusDiscard";
static const char EVENTS[] = "logEvents";
static const char ALL[] = "logAll";

static void tell(const Instance *instance, fmi2Status status, const char *category,
                 const char *format, va_list arguments) {
    char text[512];
    vsnprintf(text, sizeof text, format, arguments);
    /* The text goes where a format is expected, because hosts without varargs show it as it is;
     * it consists of names and numbers of these files and so never contains a percent sign. */
    if (instance->host.logger) {
        instance->host.logger(instance->host.componentEnvironment, instance->name, status, category,
                              text);
    }
}

/* Say why a call has failed. */
SELDOM static void complain(const Instance *instance, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    tell(instance, fmi2Error, ERRORS, format, arguments);
    va_end(arguments);
}

/* Refuse a call that has changed nothing, after which the simulation can go on. */
SELDOM static fmi2Status refuse(const Instance *instance, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    tell(instance, fmi2Discard, DISCARDS, format, arguments);
    va_end(arguments);
    return fmi2Discard;
}

/* Say what happened, if the host wants to know. */
SELDOM static void report(const Instance *instance, const char *format, ...) {
    va_list arguments;
    if (instance->telling_events) {
        va_start(arguments, format);
        tell(instance, fmi2OK, EVENTS, format, arguments);
        va_end(arguments);
    }
}

/* The instance if it accepts a call now, else NULL: a call out of sequence changes nothing. */
static Instance *entered(fmi2Component c, int modes, const char *function) {
    Instance *instance = c;
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

/* The same for a function that has nothing to work on without one of its arguments. */
static Instance *entered_with(fmi2Component c, int modes, const char *function,
                              const void *argument) {
    Instance *instance = entered(c, modes, function);
    if (instance && !argument) {
        complain(instance, "%s: an argument is NULL.", function);
        return NULL;
    }
    return instance;
}

/* End the simulation of an instance: only reading, reset, restoring a state and freeing remain. */
static fmi2Status failed(Instance *instance) {
    instance->memory.mode = FAILED;
    return fmi2Error;
}

/* Whether all that is computed is finite. */
static bool all_finite(const Memory *memory, Message *why) {
    const bool derived = memory->type == fmi2ModelExchange;
    for (int i = 0; i < WATCHED + (derived ? STATES : 0); i++) {
        const double value = memory->component.v[watched[i]];
        if (!isfinite(value)) {
            snprintf(why->text, sizeof why->text, "%s became %g at time %.9g.",
                     variables[watched[i]].name, value, memory->component.time);
            return false;
        }
    }
    return true;
}

/* What is nearer to zero than this counts as zero. */
static double rest_of(const Memory *memory) {
    return memory->type == fmi2ModelExchange ? REST : 0.0;
}

/* Bring the outputs up to date with the inputs, if these give finite ones. Between events of model
 * exchange, what is held stays as it is. */
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

/* The same before something is read: fmi2Discard, with the host told, if there is nothing to read.
 * After a failure or the end, what was computed last is what there is. */
static fmi2Status refreshed(Instance *instance) {
    Message why;
    if (!(instance->memory.mode & RUNNING) || refresh(instance, &why)) {
        return fmi2OK;
    }
    return refuse(instance, "%s", why.text);
}

static void set_start_values(Memory *memory, int type) {
    memset(memory, 0, sizeof *memory);
    for (int i = 0; i < VARIABLES; i++) {
        memory->component.v[i] = variables[i].start;
    }
    memory->stop = INFINITY;
    memory->type = type;
    memory->mode = INSTANTIATED;
    memory->stale = true;
}

#endif
