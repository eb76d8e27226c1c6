/* Functions with the same arguments in both versions of FMI. CALL(name) is the function with this
 * name in FMI 2.0. */
#ifndef FMI_H
#define FMI_H

#include <math.h>
#include <stddef.h>

#include "interface.h"

#ifndef FMI
#define FMI 2
#endif

/* Each host defines the handling of a message as LOGGER { .. }. */
#define IGNORED __attribute__((unused))

#define OK CALL(OK)
#define DISCARD CALL(Discard)
#define ERROR CALL(Error)
#define FATAL CALL(Fatal)
enum { EXCHANGE, COUPLED_STEPS, OTHER_TYPE }; /* as FMI 2.0 numbers its types */
enum { WITH_EVENTS = 1, MAY_END_EARLY = 2 };  /* requested by hosts of FMI 3.0 */

#if FMI == 3

#include "extents.h"
#include "fmi3_functions.h"

#define CALL(name) fmi3##name
typedef fmi3Instance Fmu;
typedef fmi3FMUState State;
typedef fmi3Status Status;
typedef fmi3ValueReference Ref;
typedef fmi3Boolean Bool;
typedef fmi3Byte Byte;
typedef fmi3String Text;

#define LOGGER                                                                                     \
    static void logger(IGNORED fmi3InstanceEnvironment environment, IGNORED fmi3Status status,     \
                       IGNORED fmi3String category, IGNORED fmi3String message)
LOGGER;

static inline Fmu made(Text name, int type, Text token, Text resources, int told, int logging,
                       int options) {
    const fmi3LogMessageCallback log = told ? logger : NULL;
    switch (type) {
    case EXCHANGE:
        return fmi3InstantiateModelExchange(name, token, resources, false, logging, NULL, log);
    case COUPLED_STEPS:
        return fmi3InstantiateCoSimulation(name, token, resources, false, logging,
                                           options & WITH_EVENTS, options & MAY_END_EARLY, NULL, 0,
                                           NULL, log, NULL);
    default:
        return fmi3InstantiateScheduledExecution(name, token, resources, false, logging, NULL, log,
                                                 NULL, NULL, NULL);
    }
}

/* Number of elements of a variable; 1 if unknown. */
static inline size_t size_at(Ref v) {
    if (v == VARIABLES + 1) {
        return INDICATORS;
    }
    return v < VARIABLES && extents[v] > 0 ? (size_t)extents[v] : 1;
}

static inline void begin(Fmu c) {
    fmi3EnterInitializationMode(c, false, 0.0, 0.0, false, 0.0);
    fmi3ExitInitializationMode(c);
}

static inline void set_at(Fmu c, Ref v, double value) {
    const fmi3Int32 choice = (fmi3Int32)value;
    double values[VARIABLES];
    for (int i = 0; i < extents[v]; i++) {
        values[i] = value;
    }
    if (extents[v] > 0 && variables[v].type == INTEGER) {
        fmi3SetInt32(c, &v, 1, &choice, 1);
    } else if (extents[v] > 0) {
        fmi3SetFloat64(c, &v, 1, values, size_at(v));
    }
}

static inline void get_at(Fmu c, Ref v) {
    double values[VARIABLES];
    if (extents[v] > 0) {
        fmi3GetFloat64(c, &v, 1, values, size_at(v));
    }
}

static inline Status advance(Fmu c, double time, double step) {
    bool event, terminate, early;
    double last;
    return fmi3DoStep(c, time, step, true, &event, &terminate, &early, &last);
}

#else

#include "fmi2.h"

#define CALL(name) fmi2##name
typedef fmi2Component Fmu;
typedef fmi2FMUstate State;
typedef fmi2Status Status;
typedef fmi2ValueReference Ref;
typedef fmi2Boolean Bool;
typedef fmi2Byte Byte;
typedef fmi2String Text;

#define LOGGER                                                                                     \
    static void logger(IGNORED fmi2ComponentEnvironment environment, IGNORED fmi2String instance,  \
                       IGNORED fmi2Status status, IGNORED fmi2String category,                     \
                       IGNORED fmi2String message, ...)
LOGGER;

static inline Fmu made(Text name, int type, Text token, Text resources, int told, int logging,
                       int options) {
    static const fmi2CallbackFunctions callbacks = {logger, NULL, NULL, NULL, NULL};
    (void)options;
    return fmi2Instantiate(name, (fmi2Type)type, token, resources, told ? &callbacks : NULL, 0,
                           logging);
}

static inline size_t size_at(Ref v) {
    (void)v;
    return 1;
}

static inline void begin(Fmu c) {
    fmi2SetupExperiment(c, 0, 0.0, 0.0, 0, 0.0);
    fmi2EnterInitializationMode(c);
    fmi2ExitInitializationMode(c);
}

static inline void set_at(Fmu c, Ref v, double value) {
    const fmi2Integer choice = (fmi2Integer)value;
    if (variables[v].type == INTEGER) {
        fmi2SetInteger(c, &v, 1, &choice);
    } else {
        fmi2SetReal(c, &v, 1, &value);
    }
}

static inline void get_at(Fmu c, Ref v) {
    double value;
    fmi2GetReal(c, &v, 1, &value);
}

static inline Status advance(Fmu c, double time, double step) {
    return fmi2DoStep(c, time, step, fmi2True);
}

#endif

#endif
