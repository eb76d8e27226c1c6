/* FMI 3.0 by the glue of FMI 2.0: the same instance, states and refusals, other shapes of calls.
 *
 * The value reference of a variable is the place of its first element; EXTENTS says how many
 * follow. The time stands behind all variables, then the event indicators. The functions of FMI 2.0
 * are static here and not seen from outside. */
#include "fmi2_instance.h"
#include "fmi3.h"

#include "extents.h"

enum { TIME = VARIABLES };

typedef struct {
    fmi2Component inner;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    bool events; /* whether the host of a co-simulation asked for event mode */
} Outer;

static Memory *memory_of(fmi3Instance c) {
    return &((Instance *)((Outer *)c)->inner)->memory;
}

static void pass_on(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                    fmi2String category, fmi2String message, ...) {
    const Outer *outer = environment;
    (void)name;
    outer->log(outer->environment, (fmi3Status)status, category, message);
}

static fmi3Instance instantiate(fmi2Type type, fmi3String name, fmi3String token, fmi3String path,
                                fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                fmi3LogMessageCallback log) {
    Outer *outer = calloc(1, sizeof *outer);
    if (!outer) {
        return NULL;
    }
    outer->environment = environment;
    outer->log = log;
    const fmi2CallbackFunctions host = {.logger = log ? pass_on : NULL,
                                        .componentEnvironment = outer};
    outer->inner = fmi2Instantiate(name, type, token, path, &host, fmi2False, logging);
    if (!outer->inner) {
        free(outer);
        return NULL;
    }
    return outer;
}

FMI3_EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token,
                                                      fmi3String path, fmi3Boolean visible,
                                                      fmi3Boolean logging,
                                                      fmi3InstanceEnvironment environment,
                                                      fmi3LogMessageCallback log) {
    (void)visible;
    return instantiate(fmi2ModelExchange, name, token, path, logging, environment, log);
}

FMI3_EXPORT fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference intermediate[],
    size_t n_intermediate, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3Callback update) {
    (void)visible, (void)early, (void)intermediate, (void)n_intermediate, (void)update;
    Outer *outer = instantiate(fmi2CoSimulation, name, token, path, logging, environment, log);
    if (outer) {
        outer->events = events;
    }
    return outer;
}

FMI3_EXPORT fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3Callback update,
    fmi3Callback lock, fmi3Callback unlock) {
    (void)name, (void)token, (void)path, (void)visible, (void)logging, (void)update, (void)lock;
    (void)unlock;
    if (log) {
        log(environment, fmi3Error, ERRORS,
            "fmi3InstantiateScheduledExecution: this FMU has no scheduled execution.");
    }
    return NULL;
}

FMI3_EXPORT void fmi3FreeInstance(fmi3Instance c) {
    if (c) {
        fmi2FreeInstance(((Outer *)c)->inner);
        free(c);
    }
}

FMI3_EXPORT const char *fmi3GetVersion(void) {
    return "3.0";
}

#define INNER(c) ((c) ? ((Outer *)(c))->inner : NULL)
#define STATUS(call) ((fmi3Status)(call))

FMI3_STATUS(fmi3SetDebugLogging)
(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String category[]) {
    return STATUS(fmi2SetDebugLogging(INNER(c), on, n, category));
}

FMI3_STATUS(fmi3EnterInitializationMode)
(fmi3Instance c, fmi3Boolean tolerance_defined, fmi3Float64 tolerance, fmi3Float64 start,
 fmi3Boolean stop_defined, fmi3Float64 stop) {
    const fmi2Status status =
        fmi2SetupExperiment(INNER(c), tolerance_defined, tolerance, start, stop_defined, stop);
    return STATUS(status == fmi2OK ? fmi2EnterInitializationMode(INNER(c)) : status);
}

/* Nothing happens in a co-simulation's event mode, which only those hosts enter that want it. */
FMI3_STATUS(fmi3ExitInitializationMode)(fmi3Instance c) {
    return STATUS(fmi2ExitInitializationMode(INNER(c)));
}

static Instance *in_step_mode(fmi3Instance c, const char *function) {
    return entered(INNER(c), STEPPING, function);
}

FMI3_STATUS(fmi3EnterEventMode)(fmi3Instance c) {
    if (c && memory_of(c)->type == fmi2CoSimulation) {
        return in_step_mode(c, "fmi3EnterEventMode") ? fmi3OK : fmi3Error;
    }
    return STATUS(fmi2EnterEventMode(INNER(c)));
}

FMI3_STATUS(fmi3EnterStepMode)(fmi3Instance c) {
    return in_step_mode(c, "fmi3EnterStepMode") ? fmi3OK : fmi3Error;
}

FMI3_STATUS(fmi3Terminate)(fmi3Instance c) {
    return STATUS(fmi2Terminate(INNER(c)));
}

FMI3_STATUS(fmi3Reset)(fmi3Instance c) {
    return STATUS(fmi2Reset(INNER(c)));
}

FMI3_STATUS(fmi3UpdateDiscreteStates)
(fmi3Instance c, fmi3Boolean *update, fmi3Boolean *terminate, fmi3Boolean *nominals,
 fmi3Boolean *values, fmi3Boolean *next_defined, fmi3Float64 *next) {
    fmi2Status status = fmi2OK;
    fmi2EventInfo info;
    if (c && memory_of(c)->type == fmi2ModelExchange) {
        status = fmi2NewDiscreteStates(INNER(c), &info);
    } else if (!in_step_mode(c, "fmi3UpdateDiscreteStates")) {
        return fmi3Error;
    }
    fmi3Boolean *const none[] = {update, terminate, nominals, values, next_defined};
    for (size_t i = 0; i < sizeof none / sizeof none[0]; i++) {
        if (none[i]) {
            *none[i] = false;
        }
    }
    (void)next;
    return STATUS(status);
}

FMI3_STATUS(fmi3DoStep)
(fmi3Instance c, fmi3Float64 time, fmi3Float64 step, fmi3Boolean no_set_state_before,
 fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last) {
    if (!c || !event || !terminate || !early || !last) {
        return fmi3Error;
    }
    *event = *terminate = *early = false;
    const fmi2Status status = fmi2DoStep(INNER(c), time, step, no_set_state_before);
    *last = memory_of(c)->component.time;
    return STATUS(status);
}

/* How many elements variables have together; SIZE_MAX where one is unknown. */
static size_t elements(const fmi3ValueReference vr[], size_t n) {
    size_t sum = 0;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= VARIABLES || extents[vr[i]] == 0) {
            return SIZE_MAX;
        }
        sum += (size_t)extents[vr[i]];
    }
    return sum;
}

static bool fits(fmi3Instance c, const char *function, const fmi3ValueReference vr[], size_t n,
                 const void *values, size_t n_values) {
    if (!c) {
        return false;
    }
    const Instance *instance = INNER(c);
    if ((n > 0 && !vr) || (n_values > 0 && !values)) {
        complain(instance, "%s: an argument is NULL.", function);
    } else if (elements(vr, n) != n_values) {
        complain(instance, "%s: %lu values for variables that have others, or are unknown.",
                 function, (unsigned long)n_values);
    } else {
        return true;
    }
    return false;
}

/* References of all elements of some variables, one after the other. */
static void spread(const fmi3ValueReference vr[], size_t n, fmi2ValueReference place[]) {
    for (size_t i = 0, k = 0; i < n; i++) {
        for (int j = 0; j < extents[vr[i]]; j++) {
            place[k++] = vr[i] + (fmi2ValueReference)j;
        }
    }
}

FMI3_STATUS(fmi3GetFloat64)
(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[], size_t n_values) {
    static const char function[] = "fmi3GetFloat64";
    fmi2ValueReference place[VARIABLES];
    const size_t indicators = INDICATORS;
    fmi2Status status = fmi2OK;
    size_t at = 0;
    if (!c || (n > 0 && !vr) || (n_values > 0 && !value)) {
        return fmi3Error;
    }
    for (size_t i = 0; i < n && status == fmi2OK; i++) {
        const size_t room = n_values - at;
        if (vr[i] == TIME && room >= 1) {
            value[at++] = memory_of(c)->component.time;
        } else if (indicators > 0 && vr[i] == TIME + 1 && room >= indicators) {
            component_indicators(&memory_of(c)->component, REST, &value[at]);
            at += indicators;
        } else {
            const size_t own = elements(&vr[i], 1);
            if (own > room) {
                return fits(c, function, &vr[i], 1, value, room) ? fmi3OK : fmi3Error;
            }
            spread(&vr[i], 1, place);
            status = fmi2GetReal(INNER(c), place, own, &value[at]);
            at += own;
        }
    }
    if (status == fmi2OK && at != n_values) {
        complain(INNER(c), "%s: %lu values are asked for, but there are %lu.", function,
                 (unsigned long)n_values, (unsigned long)at);
        return fmi3Error;
    }
    return STATUS(status);
}

FMI3_STATUS(fmi3SetFloat64)
(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 value[],
 size_t n_values) {
    fmi2ValueReference place[VARIABLES];
    if (n > VARIABLES || !fits(c, "fmi3SetFloat64", vr, n, value, n_values) ||
        n_values > VARIABLES) {
        return fmi3Error;
    }
    spread(vr, n, place);
    return STATUS(fmi2SetReal(INNER(c), place, n_values, value));
}

FMI3_STATUS(fmi3GetInt32)
(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Int32 value[], size_t n_values) {
    return fits(c, "fmi3GetInt32", vr, n, value, n_values)
               ? STATUS(fmi2GetInteger(INNER(c), vr, n, value))
               : fmi3Error;
}

FMI3_STATUS(fmi3SetInt32)
(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Int32 value[],
 size_t n_values) {
    return fits(c, "fmi3SetInt32", vr, n, value, n_values)
               ? STATUS(fmi2SetInteger(INNER(c), vr, n, value))
               : fmi3Error;
}

FMI3_STATUS(fmi3GetDirectionalDerivative)
(fmi3Instance c, const fmi3ValueReference unknowns[], size_t n_unknowns,
 const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
 fmi3Float64 sensitivity[], size_t n_sensitivity) {
    static const char function[] = "fmi3GetDirectionalDerivative";
    fmi2ValueReference above[VARIABLES], below[VARIABLES];
    if (n_seed > VARIABLES || n_sensitivity > VARIABLES ||
        !fits(c, function, unknowns, n_unknowns, sensitivity, n_sensitivity) ||
        !fits(c, function, knowns, n_knowns, seed, n_seed)) {
        return fmi3Error;
    }
    spread(unknowns, n_unknowns, above);
    spread(knowns, n_knowns, below);
    return STATUS(fmi2GetDirectionalDerivative(INNER(c), above, n_sensitivity, below, n_seed, seed,
                                               sensitivity));
}

FMI3_STATUS(fmi3GetFMUState)(fmi3Instance c, fmi3FMUState *state) {
    return STATUS(fmi2GetFMUstate(INNER(c), state));
}

FMI3_STATUS(fmi3SetFMUState)(fmi3Instance c, fmi3FMUState state) {
    return STATUS(fmi2SetFMUstate(INNER(c), state));
}

FMI3_STATUS(fmi3FreeFMUState)(fmi3Instance c, fmi3FMUState *state) {
    return STATUS(fmi2FreeFMUstate(INNER(c), state));
}

FMI3_STATUS(fmi3SerializedFMUStateSize)(fmi3Instance c, fmi3FMUState state, size_t *size) {
    return STATUS(fmi2SerializedFMUstateSize(INNER(c), state, size));
}

FMI3_STATUS(fmi3SerializeFMUState)
(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
    return STATUS(fmi2SerializeFMUstate(INNER(c), state, (fmi2Byte *)bytes, size));
}

FMI3_STATUS(fmi3DeserializeFMUState)
(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
    return STATUS(fmi2DeSerializeFMUstate(INNER(c), (const fmi2Byte *)bytes, size, state));
}

/* --- model exchange ----------------------------------------------------------------------- */

FMI3_STATUS(fmi3EnterContinuousTimeMode)(fmi3Instance c) {
    return STATUS(fmi2EnterContinuousTimeMode(INNER(c)));
}

FMI3_STATUS(fmi3CompletedIntegratorStep)
(fmi3Instance c, fmi3Boolean no_set_state_before, fmi3Boolean *event, fmi3Boolean *terminate) {
    fmi2Boolean at_event = fmi2False, at_end = fmi2False;
    const fmi2Status status =
        fmi2CompletedIntegratorStep(INNER(c), no_set_state_before, &at_event, &at_end);
    if (event && terminate) {
        *event = at_event, *terminate = at_end;
    }
    return STATUS(status);
}

FMI3_STATUS(fmi3SetTime)(fmi3Instance c, fmi3Float64 time) {
    return STATUS(fmi2SetTime(INNER(c), time));
}

FMI3_STATUS(fmi3SetContinuousStates)(fmi3Instance c, const fmi3Float64 x[], size_t n) {
    return STATUS(fmi2SetContinuousStates(INNER(c), x, n));
}

FMI3_STATUS(fmi3GetContinuousStateDerivatives)(fmi3Instance c, fmi3Float64 dx[], size_t n) {
    return STATUS(fmi2GetDerivatives(INNER(c), dx, n));
}

FMI3_STATUS(fmi3GetEventIndicators)(fmi3Instance c, fmi3Float64 indicator[], size_t n) {
    return STATUS(fmi2GetEventIndicators(INNER(c), indicator, n));
}

FMI3_STATUS(fmi3GetContinuousStates)(fmi3Instance c, fmi3Float64 x[], size_t n) {
    return STATUS(fmi2GetContinuousStates(INNER(c), x, n));
}

FMI3_STATUS(fmi3GetNominalsOfContinuousStates)(fmi3Instance c, fmi3Float64 nominal[], size_t n) {
    return STATUS(fmi2GetNominalsOfContinuousStates(INNER(c), nominal, n));
}

FMI3_STATUS(fmi3GetNumberOfEventIndicators)(fmi3Instance c, size_t *n) {
    if (!c || !n) {
        return fmi3Error;
    }
    *n = INDICATORS;
    return fmi3OK;
}

FMI3_STATUS(fmi3GetNumberOfContinuousStates)(fmi3Instance c, size_t *n) {
    if (!c || !n) {
        return fmi3Error;
    }
    *n = STATES;
    return fmi3OK;
}

/* --- what no component has ------------------------------------------------------------------ */

/* Called with nothing it does nothing, else it is an error. */
static fmi3Status without(fmi3Instance c, const char *function, size_t n) {
    if (c && n > 0) {
        complain(INNER(c), "%s: this FMU has nothing of the kind.", function);
    }
    return c && n == 0 ? fmi3OK : fmi3Error;
}

#define NO_VARIABLES(name)                                                                         \
    FMI3_STATUS(fmi3Get##name)                                                                     \
    (fmi3Instance c, const fmi3ValueReference vr[], size_t n, void *value, size_t n_values) {      \
        (void)vr, (void)value, (void)n_values;                                                     \
        return without(c, "fmi3Get" #name, n);                                                     \
    }                                                                                              \
    FMI3_STATUS(fmi3Set##name)                                                                     \
    (fmi3Instance c, const fmi3ValueReference vr[], size_t n, const void *value,                   \
     size_t n_values) {                                                                            \
        (void)vr, (void)value, (void)n_values;                                                     \
        return without(c, "fmi3Set" #name, n);                                                     \
    }

NO_VARIABLES(Float32)
NO_VARIABLES(Int8)
NO_VARIABLES(UInt8)
NO_VARIABLES(Int16)
NO_VARIABLES(UInt16)
NO_VARIABLES(UInt32)
NO_VARIABLES(Int64)
NO_VARIABLES(UInt64)
NO_VARIABLES(Boolean)
NO_VARIABLES(String)

#define NO_BINARIES(name)                                                                          \
    FMI3_STATUS(name)                                                                              \
    (fmi3Instance c, const fmi3ValueReference vr[], size_t n, const size_t size[],                 \
     const void *value, size_t n_values) {                                                         \
        (void)vr, (void)size, (void)value, (void)n_values;                                         \
        return without(c, #name, n);                                                               \
    }

NO_BINARIES(fmi3GetBinary)
NO_BINARIES(fmi3SetBinary)

/* Of clocks: up to three arrays follow. */
#define NO_CLOCKS(name)                                                                            \
    FMI3_STATUS(name)                                                                              \
    (fmi3Instance c, const fmi3ValueReference vr[], size_t n, const void *a, const void *b,        \
     const void *d) {                                                                              \
        (void)vr, (void)a, (void)b, (void)d;                                                       \
        return without(c, #name, n);                                                               \
    }

NO_CLOCKS(fmi3GetClock)
NO_CLOCKS(fmi3SetClock)
NO_CLOCKS(fmi3GetIntervalDecimal)
NO_CLOCKS(fmi3GetIntervalFraction)
NO_CLOCKS(fmi3GetShiftDecimal)
NO_CLOCKS(fmi3GetShiftFraction)
NO_CLOCKS(fmi3SetIntervalDecimal)
NO_CLOCKS(fmi3SetIntervalFraction)
NO_CLOCKS(fmi3SetShiftDecimal)
NO_CLOCKS(fmi3SetShiftFraction)

FMI3_STATUS(fmi3EvaluateDiscreteStates)(fmi3Instance c) {
    return without(c, "fmi3EvaluateDiscreteStates", 1);
}

FMI3_STATUS(fmi3EnterConfigurationMode)(fmi3Instance c) {
    return without(c, "fmi3EnterConfigurationMode", 1);
}

FMI3_STATUS(fmi3ExitConfigurationMode)(fmi3Instance c) {
    return without(c, "fmi3ExitConfigurationMode", 1);
}

FMI3_STATUS(fmi3GetNumberOfVariableDependencies)
(fmi3Instance c, fmi3ValueReference vr, size_t *n) {
    (void)vr, (void)n;
    return without(c, "fmi3GetNumberOfVariableDependencies", 1);
}

FMI3_STATUS(fmi3GetVariableDependencies)
(fmi3Instance c, fmi3ValueReference vr, size_t element[], fmi3ValueReference other[],
 size_t element_of_other[], fmi3DependencyKind kind[], size_t n) {
    (void)vr, (void)element, (void)other, (void)element_of_other, (void)kind, (void)n;
    return without(c, "fmi3GetVariableDependencies", 1);
}

FMI3_STATUS(fmi3GetAdjointDerivative)
(fmi3Instance c, const fmi3ValueReference unknowns[], size_t n_unknowns,
 const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
 fmi3Float64 sensitivity[], size_t n_sensitivity) {
    (void)unknowns, (void)n_unknowns, (void)knowns, (void)n_knowns, (void)seed, (void)n_seed;
    (void)sensitivity, (void)n_sensitivity;
    return without(c, "fmi3GetAdjointDerivative", 1);
}

FMI3_STATUS(fmi3GetOutputDerivatives)
(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Int32 order[],
 fmi3Float64 value[], size_t n_values) {
    (void)vr, (void)order, (void)value, (void)n_values;
    return without(c, "fmi3GetOutputDerivatives", n);
}

FMI3_STATUS(fmi3ActivateModelPartition)
(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time) {
    (void)clock, (void)time;
    return without(c, "fmi3ActivateModelPartition", 1);
}
