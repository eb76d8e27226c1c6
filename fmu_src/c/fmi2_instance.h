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

/* The states of the standard's state machine that a slave with synchronous steps can be in. */
enum {
    INSTANTIATED = 1,
    INITIALISING = 2,
    STEPPING = 4,
    TERMINATED = 8,
    FAILED = 16,
    ANY = 31,
};

/* For each group of functions the states in which the standard allows it. */
enum {
    MAY_SET_UP = INSTANTIATED,
    MAY_ENTER_INITIALISATION = INSTANTIATED,
    MAY_EXIT_INITIALISATION = INITIALISING,
    MAY_GET = INITIALISING | STEPPING | TERMINATED | FAILED,
    MAY_SET = INSTANTIATED | INITIALISING | STEPPING,
    MAY_STEP = STEPPING,
    MAY_GET_STATUS = STEPPING | TERMINATED | FAILED,
    MAY_TERMINATE = STEPPING,
    MAY_RESET = ANY,
    MAY_COPY_STATE = ANY,
};

/* All that GetFMUstate copies: it holds no pointers. */
typedef struct {
    Component component;
    double slope[VARIABLES]; /* of inputs, for the next step only */
    double time, stop;
    int mode;
    int sloped; /* whether any slope is not zero */
    int stale;  /* whether the outputs are older than what they depend on */
} Memory;

typedef struct {
    Memory memory;
    fmi2CallbackFunctions host;
    char name[]; /* of the instance */
} Instance;

static const char CATEGORY[] = "logStatusError";

/* Tell the host; errors are told whether or not debug logging is on. */
static void complain(const Instance *instance, const char *format, ...) {
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    /* The text goes where a format is expected, because hosts without varargs show it as it is;
     * it consists of names and numbers of this file and so never contains a percent sign. */
    if (instance->host.logger) {
        instance->host.logger(instance->host.componentEnvironment, instance->name, fmi2Error,
                              CATEGORY, text);
    }
}

/* The instance if it accepts a call now, else NULL: a call out of sequence changes nothing. */
static Instance *entered(fmi2Component c, int modes, const char *function) {
    Instance *instance = c;
    if (instance && !(instance->memory.mode & modes)) {
        complain(instance, "%s is not allowed in this state of the instance.", function);
        return NULL;
    }
    return instance;
}

/* End the simulation of an instance: only reading, reset, restoring a state and freeing remain. */
static fmi2Status failed(Instance *instance) {
    instance->memory.mode = FAILED;
    return fmi2Error;
}

/* Compute the outputs if they are stale; false, with the host told, if there are none. */
static bool refreshed(Instance *instance) {
    Memory *memory = &instance->memory;
    Message why;
    if (!memory->stale) {
        return true;
    }
    if (!component_output(&memory->component, &why)) {
        complain(instance, "%s", why.text);
        return false;
    }
    for (int i = 0; i < VARIABLES; i++) {
        if (!isfinite(memory->component.v[i])) {
            complain(instance, "%s became %g at time %.9g.", variables[i].name,
                     memory->component.v[i], memory->time);
            return false;
        }
    }
    memory->stale = false;
    return true;
}

static void set_start_values(Memory *memory) {
    memset(memory, 0, sizeof *memory);
    for (int i = 0; i < VARIABLES; i++) {
        memory->component.v[i] = variables[i].start;
    }
    memory->stop = INFINITY;
    memory->mode = INSTANTIATED;
    memory->stale = true;
}

#endif
