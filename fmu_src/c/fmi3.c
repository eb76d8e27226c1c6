/* FMI 3.0 on top of FMI 2.0: the same instance, states and refusals with other signatures.
 *
 * The functions of FMI 2.0 are static here and not exported. */
#include "fmi3_instance.h"

static fmi3Instance instantiate(fmi2Type type, fmi3String name, fmi3String token, fmi3String path,
                                fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                fmi3LogMessageCallback log) {
    Outer *outer = (Outer *)calloc(1, sizeof *outer);
    if (!outer) {
        return NULL;
    }
    outer->environment = environment;
    outer->log = log;
    fmi2CallbackFunctions host;
    memset(&host, 0, sizeof host);
    host.logger = log ? pass_on : NULL;
    host.componentEnvironment = outer;
    outer->inner = (Instance *)fmi2Instantiate(name, type, token, path, &host, fmi2False, logging);
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
    (void)visible, (void)intermediate, (void)n_intermediate, (void)update;
    Outer *outer =
        (Outer *)instantiate(fmi2CoSimulation, name, token, path, logging, environment, log);
    if (outer) {
        outer->events = events;
        outer->early = early;
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

FMI3_FORWARD(fmi3SetDebugLogging, fmi2SetDebugLogging,
             (fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String category[]), on, n,
             category)

FMI3_STATUS(fmi3EnterInitializationMode)
(fmi3Instance c, fmi3Boolean tolerance_defined, fmi3Float64 tolerance, fmi3Float64 start,
 fmi3Boolean stop_defined, fmi3Float64 stop) {
    const fmi2Status status =
        fmi2SetupExperiment(INNER(c), tolerance_defined, tolerance, start, stop_defined, stop);
    return STATUS(status == fmi2OK ? fmi2EnterInitializationMode(INNER(c)) : status);
}

/* A co-simulation with event mode starts at an event. */
FMI3_STATUS(fmi3ExitInitializationMode)(fmi3Instance c) {
    const fmi2Status status = fmi2ExitInitializationMode(INNER(c));
    if (status == fmi2OK) {
        memory_of(c)->paused = ((Outer *)c)->events;
    }
    return STATUS(status);
}

FMI3_FORWARD_ALONE(fmi3Terminate, fmi2Terminate)
FMI3_FORWARD_ALONE(fmi3Reset, fmi2Reset)
FMI3_FORWARD(fmi3GetFMUState, fmi2GetFMUstate, (fmi3Instance c, fmi3FMUState *state), state)
FMI3_FORWARD(fmi3SetFMUState, fmi2SetFMUstate, (fmi3Instance c, fmi3FMUState state), state)
FMI3_FORWARD(fmi3FreeFMUState, fmi2FreeFMUstate, (fmi3Instance c, fmi3FMUState *state), state)
FMI3_FORWARD(fmi3SerializedFMUStateSize, fmi2SerializedFMUstateSize,
             (fmi3Instance c, fmi3FMUState state, size_t *size), state, size)
FMI3_FORWARD(fmi3SerializeFMUState, fmi2SerializeFMUstate,
             (fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size), state,
             (fmi2Byte *)bytes, size)
FMI3_FORWARD(fmi3DeserializeFMUState, fmi2DeSerializeFMUstate,
             (fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state),
             (const fmi2Byte *)bytes, size, state)
