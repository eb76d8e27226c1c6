/* FMI 2.0: life cycle of an instance. */
#include "fmi2_instance.h"

FMI2_TEXT(fmi2GetTypesPlatform)(void) {
    return "default";
}

FMI2_TEXT(fmi2GetVersion)(void) {
    return "2.0";
}

FMI2_STATUS(fmi2SetDebugLogging)
(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String category[]) {
    static const char function[] = "fmi2SetDebugLogging";
    bool events = n == 0;
    ENTER(n > 0 ? entered_with(c, ANY, function, category) : entered(c, ANY, function));
    for (size_t i = 0; i < n; i++) {
        const char *wanted = category[i] ? category[i] : "";
        if (strcmp(wanted, EVENTS) == 0 || strcmp(wanted, ALL) == 0) {
            events = true;
        } else if (strcmp(wanted, ERRORS) != 0 && strcmp(wanted, DISCARDS) != 0) {
            return complain(instance, "%s: a category is unknown; known are %s, %s, %s and %s.",
                            function, EVENTS, DISCARDS, ERRORS, ALL);
        }
    }
    if (events) {
        instance->telling_events = on;
    }
    return fmi2OK;
}

static fmi2Component not_instantiated(const fmi2CallbackFunctions *host, const char *name,
                                      const char *reason) {
    if (host && host->logger) {
        host->logger(host->componentEnvironment, name, fmi2Error, ERRORS, reason);
    }
    return NULL;
}

FMI2_EXPORT fmi2Component FMI2_NAME(fmi2Instantiate)(fmi2String name, fmi2Type type,
                                                     fmi2String guid, fmi2String resources,
                                                     const fmi2CallbackFunctions *functions,
                                                     fmi2Boolean visible, fmi2Boolean logging) {
    (void)visible;
    Message why;
    char own[sizeof numbers.guid];
    if (!name || !*name) {
        return not_instantiated(functions, "", "fmi2Instantiate: the instance has no name.");
    }
    if (type != fmi2CoSimulation && !(type == fmi2ModelExchange && MODEL_EXCHANGE)) {
        return not_instantiated(functions, name,
                                "fmi2Instantiate: this FMU is not of the wanted type.");
    }
    copy_guid(own);
    if (!guid || strcmp(guid, own) != 0) {
        deny(&why, "fmi2Instantiate: the GUID is not that of this binary, %s.", own);
        return not_instantiated(functions, name, why.text);
    }
    Instance *instance = (Instance *)calloc(1, sizeof *instance + strlen(name) + 1);
    if (!instance) {
        return not_instantiated(functions, name, "fmi2Instantiate: out of memory.");
    }
    instance->workspace = component_open(resources, &why);
    if (!instance->workspace) {
        free(instance);
        return not_instantiated(functions, name, why.text);
    }
    if (functions) {
        instance->host = *functions;
    }
    instance->telling_events = logging;
    instance->name = (char *)(instance + 1);
    memcpy(instance->name, name, strlen(name) + 1);
    set_start_values(&instance->memory, type);
    return instance;
}

FMI2_EXPORT void FMI2_NAME(fmi2FreeInstance)(fmi2Component c) {
    Instance *instance = (Instance *)c;
    if (instance) {
        component_close(instance->workspace);
        free(instance);
    }
}

FMI2_STATUS(fmi2SetupExperiment)
(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
 fmi2Boolean stop_defined, fmi2Real stop) {
    (void)tolerance_defined, (void)tolerance; /* nothing here iterates to a tolerance */
    ENTER(entered(c, INSTANTIATED, "fmi2SetupExperiment"));
    if (!isfinite(start) || (stop_defined && !(stop >= start))) {
        return FAIL(instance, "fmi2SetupExperiment: the experiment goes from %g to %g.", start,
                    stop);
    }
    instance->memory.component.time = start;
    instance->memory.stop = stop_defined ? stop : INFINITY;
    return fmi2OK;
}

FMI2_STATUS(fmi2EnterInitializationMode)(fmi2Component c) {
    ENTER(entered(c, INSTANTIATED, "fmi2EnterInitializationMode"));
    instance->memory.mode = INITIALISING;
    return fmi2OK;
}

FMI2_STATUS(fmi2ExitInitializationMode)(fmi2Component c) {
    Message why;
    ENTER(entered(c, INITIALISING, "fmi2ExitInitializationMode"));
    Memory *memory = &instance->memory;
    component_event(&memory->component, rest_of(memory), NULL);
    memory->stale = true;
    if (!component_initialise(&memory->component, instance->workspace, &why) ||
        !refresh(instance, &why)) {
        return FAIL(instance, "%s", why.text);
    }
    memory->mode = memory->type == fmi2ModelExchange ? AT_EVENT : STEPPING;
    report(instance, "Initialised at %.9g s.", memory->component.time);
    return fmi2OK;
}

FMI2_STATUS(fmi2Terminate)(fmi2Component c) {
    ENTER(entered(c, MAY_TERMINATE, "fmi2Terminate"));
    instance->memory.mode = TERMINATED;
    report(instance, "Terminated at %.9g s.", instance->memory.component.time);
    return fmi2OK;
}

FMI2_STATUS(fmi2Reset)(fmi2Component c) {
    Instance *instance = (Instance *)c; /* in any state */
    if (!instance) {
        return fmi2Error;
    }
    set_start_values(&instance->memory, instance->memory.type);
    report(instance, "Reset to the start values.");
    return fmi2OK;
}
