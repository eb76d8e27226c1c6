/* A container that accepts any step, around a runtime that accepts multiples of its own.
 *
 * The runtime, in the same folder, is stepped to the last multiple before a communication point,
 * and its outputs are held. All other calls are forwarded. The generated hold.h defines
 * RUNTIME_FILE and RUNTIME_STEP. */
#ifndef _GNU_SOURCE
#define _GNU_SOURCE /* for dladdr */
#endif
#include <math.h>
#include <stdlib.h>

#include "beside.h"
#include "fmi2.h"
#include "hold.h"

/* Tolerance of times for round-off, as a fraction of the runtime's step. */
#define ROUNDING 1e-6

#define EACH_FUNCTION(F)                                                                           \
    F(fmi2SetDebugLogging)                                                                         \
    F(fmi2Instantiate)                                                                             \
    F(fmi2FreeInstance)                                                                            \
    F(fmi2SetupExperiment)                                                                         \
    F(fmi2EnterInitializationMode)                                                                 \
    F(fmi2ExitInitializationMode)                                                                  \
    F(fmi2Terminate)                                                                               \
    F(fmi2Reset)                                                                                   \
    F(fmi2GetReal)                                                                                 \
    F(fmi2GetInteger)                                                                              \
    F(fmi2GetBoolean)                                                                              \
    F(fmi2GetString)                                                                               \
    F(fmi2SetReal)                                                                                 \
    F(fmi2SetInteger)                                                                              \
    F(fmi2SetBoolean)                                                                              \
    F(fmi2SetString)                                                                               \
    F(fmi2GetFMUstate)                                                                             \
    F(fmi2SetFMUstate)                                                                             \
    F(fmi2FreeFMUstate)                                                                            \
    F(fmi2SerializedFMUstateSize)                                                                  \
    F(fmi2SerializeFMUstate)                                                                       \
    F(fmi2DeSerializeFMUstate)                                                                     \
    F(fmi2GetDirectionalDerivative)                                                                \
    F(fmi2SetRealInputDerivatives)                                                                 \
    F(fmi2GetRealOutputDerivatives)                                                                \
    F(fmi2DoStep)                                                                                  \
    F(fmi2CancelStep)                                                                              \
    F(fmi2GetStatus)                                                                               \
    F(fmi2GetRealStatus)                                                                           \
    F(fmi2GetIntegerStatus)                                                                        \
    F(fmi2GetBooleanStatus)                                                                        \
    F(fmi2GetStringStatus)

#define MEMBER(name) __typeof__(&name) name;
typedef struct {
    EACH_FUNCTION(MEMBER)
} Runtime;

typedef struct {
    Runtime runtime;
    fmi2Component inner;
    double start; /* start of the experiment [s] */
    double made;  /* steps of the runtime since then */
} Instance;

static bool load(Runtime *runtime) {
    void *library = beside(RUNTIME_FILE);
    bool all = library != NULL;
#define LOOK_UP(name) all = all && look_up(library, #name, &runtime->name);
    EACH_FUNCTION(LOOK_UP)
    return all;
}

FMI2_TEXT(fmi2GetTypesPlatform)(void) {
    return "default";
}

FMI2_TEXT(fmi2GetVersion)(void) {
    return "2.0";
}

FMI2_EXPORT fmi2Component FMI2_NAME(fmi2Instantiate)(fmi2String name, fmi2Type type,
                                                     fmi2String guid, fmi2String resources,
                                                     const fmi2CallbackFunctions *functions,
                                                     fmi2Boolean visible, fmi2Boolean logging) {
    Instance *own = calloc(1, sizeof *own);
    if (own && !load(&own->runtime) && functions && functions->logger) {
        functions->logger(functions->componentEnvironment, name ? name : "", fmi2Error,
                          "logStatusError",
                          RUNTIME_FILE " cannot be loaded from the folder of the FMU's binary.");
    } else if (own) {
        own->inner =
            own->runtime.fmi2Instantiate(name, type, guid, resources, functions, visible, logging);
    }
    if (own && !own->inner) {
        free(own);
        own = NULL;
    }
    return own;
}

FMI2_EXPORT void FMI2_NAME(fmi2FreeInstance)(fmi2Component c) {
    Instance *own = c;
    if (own) {
        own->runtime.fmi2FreeInstance(own->inner);
        free(own);
    }
}

FMI2_STATUS(fmi2SetupExperiment)
(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
 fmi2Boolean stop_defined, fmi2Real stop) {
    Instance *own = c;
    if (!own) {
        return fmi2Error;
    }
    own->start = start;
    return own->runtime.fmi2SetupExperiment(own->inner, tolerance_defined, tolerance, start,
                                            stop_defined, stop);
}

FMI2_STATUS(fmi2Reset)(fmi2Component c) {
    Instance *own = c;
    if (!own) {
        return fmi2Error;
    }
    own->start = own->made = 0.0;
    return own->runtime.fmi2Reset(own->inner);
}

FMI2_STATUS(fmi2DoStep)
(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_set_state_before) {
    Instance *own = c;
    if (!own) {
        return fmi2Error;
    }
    const double due = floor((time + step - own->start) / RUNTIME_STEP + ROUNDING) - own->made;
    if (step > 0.0 && due < 1.0) {
        return fmi2OK;
    }
    /* Let the runtime reject an invalid step. */
    const bool right = step > 0.0 && isfinite(due);
    const fmi2Status status =
        own->runtime.fmi2DoStep(own->inner, own->start + own->made * RUNTIME_STEP,
                                right ? due * RUNTIME_STEP : step, no_set_state_before);
    if (right && status <= fmi2Warning) {
        own->made += due;
    }
    return status;
}

/* --- forwarded calls --- */

#define PASS_ON(name, parameters, ...)                                                             \
    FMI2_STATUS(name) parameters {                                                                 \
        Instance *own = c;                                                                         \
        return own ? own->runtime.name(own->inner, __VA_ARGS__) : fmi2Error;                       \
    }
#define PASS_ON_ALONE(name)                                                                        \
    FMI2_STATUS(name)(fmi2Component c) {                                                           \
        Instance *own = c;                                                                         \
        return own ? own->runtime.name(own->inner) : fmi2Error;                                    \
    }
#define PASS_ON_VALUES(kind)                                                                       \
    PASS_ON(fmi2Get##kind,                                                                         \
            (fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2##kind value[]), vr, n, \
            value)                                                                                 \
    PASS_ON(fmi2Set##kind,                                                                         \
            (fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2##kind value[]),  \
            vr, n, value)
#define PASS_ON_STATUS(name, kind)                                                                 \
    PASS_ON(name, (fmi2Component c, const fmi2StatusKind asked, kind *value), asked, value)

PASS_ON_ALONE(fmi2EnterInitializationMode)
PASS_ON_ALONE(fmi2ExitInitializationMode)
PASS_ON_ALONE(fmi2Terminate)
PASS_ON_ALONE(fmi2CancelStep)
PASS_ON_VALUES(Real)
PASS_ON_VALUES(Integer)
PASS_ON_VALUES(Boolean)
PASS_ON_VALUES(String)
PASS_ON_STATUS(fmi2GetStatus, fmi2Status)
PASS_ON_STATUS(fmi2GetRealStatus, fmi2Real)
PASS_ON_STATUS(fmi2GetIntegerStatus, fmi2Integer)
PASS_ON_STATUS(fmi2GetBooleanStatus, fmi2Boolean)
PASS_ON_STATUS(fmi2GetStringStatus, fmi2String)
PASS_ON(fmi2SetDebugLogging,
        (fmi2Component c, fmi2Boolean on, size_t n, const fmi2String category[]), on, n, category)
PASS_ON(fmi2GetFMUstate, (fmi2Component c, fmi2FMUstate *state), state)
PASS_ON(fmi2SetFMUstate, (fmi2Component c, fmi2FMUstate state), state)
PASS_ON(fmi2FreeFMUstate, (fmi2Component c, fmi2FMUstate *state), state)
PASS_ON(fmi2SerializedFMUstateSize, (fmi2Component c, fmi2FMUstate state, size_t *size), state,
        size)
PASS_ON(fmi2SerializeFMUstate, (fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size),
        state, bytes, size)
PASS_ON(fmi2DeSerializeFMUstate,
        (fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state), bytes, size,
        state)
PASS_ON(fmi2GetDirectionalDerivative,
        (fmi2Component c, const fmi2ValueReference unknown[], size_t n_unknown,
         const fmi2ValueReference known[], size_t n_known, const fmi2Real d_known[],
         fmi2Real d_unknown[]),
        unknown, n_unknown, known, n_known, d_known, d_unknown)
PASS_ON(fmi2SetRealInputDerivatives,
        (fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
         const fmi2Real value[]),
        vr, n, order, value)
PASS_ON(fmi2GetRealOutputDerivatives,
        (fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
         fmi2Real value[]),
        vr, n, order, value)
