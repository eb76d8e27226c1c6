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

/* Calls that read and write variables of a type. */
#define EACH_ACCESS(F, kind)                                                                       \
    F(fmi2Get##kind,                                                                               \
      (fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2##kind value[]), own->inner,  \
      vr, n, value)                                                                                \
    F(fmi2Set##kind,                                                                               \
      (fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2##kind value[]),        \
      own->inner, vr, n, value)

/* Calls that are forwarded: name, parameters, and arguments for the runtime. */
#define EACH_FORWARDED(F)                                                                          \
    F(fmi2EnterInitializationMode, (fmi2Component c), own->inner)                                  \
    F(fmi2ExitInitializationMode, (fmi2Component c), own->inner)                                   \
    F(fmi2Terminate, (fmi2Component c), own->inner)                                                \
    F(fmi2CancelStep, (fmi2Component c), own->inner)                                               \
    EACH_ACCESS(F, Real)                                                                           \
    EACH_ACCESS(F, Integer)                                                                        \
    EACH_ACCESS(F, Boolean)                                                                        \
    EACH_ACCESS(F, String)                                                                         \
    F(fmi2SetDebugLogging,                                                                         \
      (fmi2Component c, fmi2Boolean on, size_t n, const fmi2String category[]), own->inner, on, n, \
      category)                                                                                    \
    F(fmi2GetFMUstate, (fmi2Component c, fmi2FMUstate * state), own->inner, state)                 \
    F(fmi2SetFMUstate, (fmi2Component c, fmi2FMUstate state), own->inner, state)                   \
    F(fmi2FreeFMUstate, (fmi2Component c, fmi2FMUstate * state), own->inner, state)                \
    F(fmi2SerializedFMUstateSize, (fmi2Component c, fmi2FMUstate state, size_t *size), own->inner, \
      state, size)                                                                                 \
    F(fmi2SerializeFMUstate, (fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size), \
      own->inner, state, bytes, size)                                                              \
    F(fmi2DeSerializeFMUstate,                                                                     \
      (fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state), own->inner,     \
      bytes, size, state)                                                                          \
    F(fmi2GetDirectionalDerivative,                                                                \
      (fmi2Component c, const fmi2ValueReference unknown[], size_t n_unknown,                      \
       const fmi2ValueReference known[], size_t n_known, const fmi2Real d_known[],                 \
       fmi2Real d_unknown[]),                                                                      \
      own->inner, unknown, n_unknown, known, n_known, d_known, d_unknown)                          \
    F(fmi2SetRealInputDerivatives,                                                                 \
      (fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],        \
       const fmi2Real value[]),                                                                    \
      own->inner, vr, n, order, value)                                                             \
    F(fmi2GetRealOutputDerivatives,                                                                \
      (fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],        \
       fmi2Real value[]),                                                                          \
      own->inner, vr, n, order, value)                                                             \
    F(fmi2GetStatus, (fmi2Component c, const fmi2StatusKind asked, fmi2Status *value), own->inner, \
      asked, value)                                                                                \
    F(fmi2GetRealStatus, (fmi2Component c, const fmi2StatusKind asked, fmi2Real *value),           \
      own->inner, asked, value)                                                                    \
    F(fmi2GetIntegerStatus, (fmi2Component c, const fmi2StatusKind asked, fmi2Integer *value),     \
      own->inner, asked, value)                                                                    \
    F(fmi2GetBooleanStatus, (fmi2Component c, const fmi2StatusKind asked, fmi2Boolean *value),     \
      own->inner, asked, value)                                                                    \
    F(fmi2GetStringStatus, (fmi2Component c, const fmi2StatusKind asked, fmi2String *value),       \
      own->inner, asked, value)

#define EACH_FUNCTION(F)                                                                           \
    F(fmi2Instantiate, own)                                                                        \
    F(fmi2FreeInstance, own)                                                                       \
    F(fmi2SetupExperiment, own)                                                                    \
    F(fmi2Reset, own)                                                                              \
    F(fmi2DoStep, own)                                                                             \
    EACH_FORWARDED(F)

#define MEMBER(name, ...) __typeof__(&name) name;
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
#define LOOK_UP(name, ...) all = all && look_up(library, #name, &runtime->name);
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

#define PASS_ON(name, parameters, ...)                                                             \
    FMI2_STATUS(name) parameters {                                                                 \
        Instance *own = c;                                                                         \
        return own ? own->runtime.name(__VA_ARGS__) : fmi2Error;                                   \
    }
EACH_FORWARDED(PASS_ON)
