/* FMI 2.0: life of an instance and its steps. */
#include "fmi2_instance.h"

FMI2_TEXT(fmi2GetTypesPlatform)(void) {
    return "default";
}

FMI2_TEXT(fmi2GetVersion)(void) {
    return "2.0";
}

FMI2_STATUS(fmi2SetDebugLogging)
(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String category[]) {
    Instance *instance = entered(c, ANY, "fmi2SetDebugLogging");
    (void)on; /* there is one category, and its messages are always sent */
    if (!instance || (n > 0 && !category)) {
        return fmi2Error;
    }
    for (size_t i = 0; i < n; i++) {
        if (!category[i] || strcmp(category[i], CATEGORY) != 0) {
            complain(instance, "fmi2SetDebugLogging: the only category is %s.", CATEGORY);
            return fmi2Error;
        }
    }
    return fmi2OK;
}

/* Tell the host of a failed instantiation, for which there is no instance yet. */
static fmi2Component not_instantiated(const fmi2CallbackFunctions *host, const char *name,
                                      const char *reason) {
    if (host && host->logger) {
        host->logger(host->componentEnvironment, name, fmi2Error, CATEGORY, reason);
    }
    return NULL;
}

FMI2_EXPORT fmi2Component FMI2_NAME(fmi2Instantiate)(fmi2String name, fmi2Type type,
                                                     fmi2String guid, fmi2String resources,
                                                     const fmi2CallbackFunctions *functions,
                                                     fmi2Boolean visible, fmi2Boolean logging) {
    (void)resources, (void)visible, (void)logging;
    if (!name || !*name) {
        return not_instantiated(functions, "", "fmi2Instantiate: the instance has no name.");
    }
    if (type != fmi2CoSimulation) {
        return not_instantiated(functions, name, "fmi2Instantiate: this FMU is for co-simulation.");
    }
    if (!guid || strcmp(guid, MODEL_GUID) != 0) {
        return not_instantiated(functions, name,
                                "fmi2Instantiate: the GUID is not that of this binary, " MODEL_GUID
                                ".");
    }
    Instance *instance = calloc(1, sizeof *instance + strlen(name) + 1);
    if (!instance) {
        return not_instantiated(functions, name, "fmi2Instantiate: out of memory.");
    }
    if (functions) {
        instance->host = *functions;
    }
    memcpy(instance->name, name, strlen(name) + 1);
    set_start_values(&instance->memory);
    return instance;
}

FMI2_EXPORT void FMI2_NAME(fmi2FreeInstance)(fmi2Component c) {
    free(c);
}

FMI2_STATUS(fmi2SetupExperiment)
(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
 fmi2Boolean stop_defined, fmi2Real stop) {
    Instance *instance = entered(c, MAY_SET_UP, "fmi2SetupExperiment");
    (void)tolerance_defined, (void)tolerance; /* nothing here is iterated to a tolerance */
    if (!instance) {
        return fmi2Error;
    }
    if (!isfinite(start) || (stop_defined && !(stop >= start))) {
        complain(instance, "fmi2SetupExperiment: the experiment goes from %g to %g.", start, stop);
        return failed(instance);
    }
    instance->memory.time = start;
    instance->memory.stop = stop_defined ? stop : INFINITY;
    return fmi2OK;
}

FMI2_STATUS(fmi2EnterInitializationMode)(fmi2Component c) {
    Instance *instance = entered(c, MAY_ENTER_INITIALISATION, "fmi2EnterInitializationMode");
    if (!instance) {
        return fmi2Error;
    }
    instance->memory.mode = INITIALISING;
    return fmi2OK;
}

FMI2_STATUS(fmi2ExitInitializationMode)(fmi2Component c) {
    Instance *instance = entered(c, MAY_EXIT_INITIALISATION, "fmi2ExitInitializationMode");
    Message why;
    if (!instance) {
        return fmi2Error;
    }
    if (!component_initialise(&instance->memory.component, &why)) {
        complain(instance, "%s", why.text);
        return failed(instance);
    }
    instance->memory.stale = true;
    if (!refreshed(instance)) {
        return failed(instance);
    }
    instance->memory.mode = STEPPING;
    return fmi2OK;
}

FMI2_STATUS(fmi2Terminate)(fmi2Component c) {
    Instance *instance = entered(c, MAY_TERMINATE, "fmi2Terminate");
    if (!instance) {
        return fmi2Error;
    }
    instance->memory.mode = TERMINATED;
    return fmi2OK;
}

FMI2_STATUS(fmi2Reset)(fmi2Component c) {
    Instance *instance = entered(c, MAY_RESET, "fmi2Reset");
    if (!instance) {
        return fmi2Error;
    }
    set_start_values(&instance->memory);
    return fmi2OK;
}

/* Move the inputs along their slopes by a time [s]. */
static void follow_slopes(Memory *memory, double time) {
    for (int i = 0; memory->sloped && i < VARIABLES; i++) {
        memory->component.v[i] += memory->slope[i] * time;
    }
}

FMI2_STATUS(fmi2DoStep)
(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_set_state_before) {
    Instance *instance = entered(c, MAY_STEP, "fmi2DoStep");
    Message why;
    (void)no_set_state_before;
    if (!instance) {
        return fmi2Error;
    }
    Memory *memory = &instance->memory;
    if (!isfinite(time) || !isfinite(step) || !(step > 0.0)) {
        complain(instance, "fmi2DoStep: the step is %g s from time %g s; it must be positive.",
                 step, time);
        return failed(instance);
    }
    /* A last step that passes the end by the rounding of summed steps is no error. */
    if (time + step > memory->stop + 1e-3 * step) {
        complain(instance, "fmi2DoStep: the step from %.17g s to %.17g s passes the end, %.17g s.",
                 time, time + step, memory->stop);
        return failed(instance);
    }
    /* States move with inputs held; where these have slopes, at their value in the middle. */
    follow_slopes(memory, 0.5 * step);
    if (!component_step(&memory->component, time, step, &why)) {
        complain(instance, "%s", why.text);
        return failed(instance);
    }
    follow_slopes(memory, 0.5 * step);
    if (memory->sloped) {
        memset(memory->slope, 0, sizeof memory->slope);
        memory->sloped = false;
    }
    memory->time = time + step;
    memory->stale = true;
    return refreshed(instance) ? fmi2OK : failed(instance);
}

/* A step is never pending, so there is nothing to cancel and little to ask for. */
static fmi2Status no_status(fmi2Component c, const char *function) {
    Instance *instance = entered(c, MAY_GET_STATUS, function);
    if (!instance) {
        return fmi2Error;
    }
    complain(instance, "%s: steps are never asynchronous, so this status does not exist.",
             function);
    return fmi2Discard;
}

FMI2_STATUS(fmi2CancelStep)(fmi2Component c) {
    Instance *instance = entered(c, ANY, "fmi2CancelStep");
    if (instance) {
        complain(instance, "fmi2CancelStep: no step is in progress.");
    }
    return fmi2Error;
}

FMI2_STATUS(fmi2GetStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    (void)kind, (void)value;
    return no_status(c, "fmi2GetStatus");
}

FMI2_STATUS(fmi2GetRealStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    Instance *instance = entered(c, MAY_GET_STATUS, "fmi2GetRealStatus");
    if (!instance) {
        return fmi2Error;
    }
    if (kind != fmi2LastSuccessfulTime || !value) {
        return no_status(c, "fmi2GetRealStatus");
    }
    *value = instance->memory.time;
    return fmi2OK;
}

FMI2_STATUS(fmi2GetIntegerStatus)
(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    (void)kind, (void)value;
    return no_status(c, "fmi2GetIntegerStatus");
}

FMI2_STATUS(fmi2GetBooleanStatus)
(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    Instance *instance = entered(c, MAY_GET_STATUS, "fmi2GetBooleanStatus");
    if (!instance) {
        return fmi2Error;
    }
    if (kind != fmi2Terminated || !value) {
        return no_status(c, "fmi2GetBooleanStatus");
    }
    *value = fmi2False;
    return fmi2OK;
}

FMI2_STATUS(fmi2GetStringStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    (void)kind, (void)value;
    return no_status(c, "fmi2GetStringStatus");
}
