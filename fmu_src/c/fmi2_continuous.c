/* FMI 2.0: model exchange. */
#include "fmi2_instance.h"

FMI2_STATUS(fmi2EnterEventMode)(fmi2Component c) {
    ENTER(entered(c, AT_EVENT | CONTINUOUS, "fmi2EnterEventMode"));
    instance->memory.mode = AT_EVENT;
    return fmi2OK;
}

/* One iteration suffices: the held values depend only on inputs and parameters. */
FMI2_STATUS(fmi2NewDiscreteStates)(fmi2Component c, fmi2EventInfo *info) {
    Message what;
    ENTER(entered_with(c, AT_EVENT, "fmi2NewDiscreteStates", info));
    if (component_event(&instance->memory.component, REST, &what)) {
        instance->memory.stale = true;
        report(instance, "%s (%.9g s)", what.text, instance->memory.component.time);
    }
    memset(info, 0, sizeof *info);
    return fmi2OK;
}

FMI2_STATUS(fmi2EnterContinuousTimeMode)(fmi2Component c) {
    Message why;
    ENTER(entered(c, AT_EVENT, "fmi2EnterContinuousTimeMode"));
    /* On-demand variables are discrete: they keep their values until the next event. */
    if (component_output(&instance->memory.component, instance->workspace, &why)) {
        component_demand(&instance->memory.component);
    }
    instance->memory.mode = CONTINUOUS;
    return fmi2OK;
}

/* Ask a host that ignores event indicators between its steps for an event after them. */
FMI2_STATUS(fmi2CompletedIntegratorStep)
(fmi2Component c, fmi2Boolean no_set_state_before, fmi2Boolean *event, fmi2Boolean *terminate) {
    static const char function[] = "fmi2CompletedIntegratorStep";
    double indicator[INDICATORS > 0 ? INDICATORS : 1];
    (void)no_set_state_before;
    ENTER(entered_with(c, CONTINUOUS, function, event && terminate ? event : NULL));
    *event = !component_indicators(&instance->memory.component, REST, indicator);
    *terminate = fmi2False;
    return fmi2OK;
}

FMI2_STATUS(fmi2SetTime)(fmi2Component c, fmi2Real time) {
    ENTER(entered(c, AT_EVENT | CONTINUOUS, "fmi2SetTime"));
    if (!isfinite(time)) {
        return FAIL(instance, "fmi2SetTime: the time is %g.", time);
    }
    instance->memory.component.time = time;
    return fmi2OK;
}

/* Return the instance if it can exchange `n` numbers, the component's count `own`. Some hosts
 * pass one number for zero; it stays constant. */
static Instance *with_array(fmi2Component c, int modes, const char *function, const void *array,
                            size_t n, size_t own) {
    Instance *instance =
        n > 0 ? entered_with(c, modes, function, array) : entered(c, modes, function);
    if (instance && n != own && (own > 0 || n > 1)) {
        complain(instance, "%s: the array has %lu elements; expected %lu.", function,
                 (unsigned long)n, (unsigned long)own);
        failed(instance);
        return NULL;
    }
    return instance;
}

FMI2_STATUS(fmi2SetContinuousStates)(fmi2Component c, const fmi2Real x[], size_t n) {
    static const char function[] = "fmi2SetContinuousStates";
    ENTER(with_array(c, CONTINUOUS, function, x, n, STATES));
    for (int i = 0; i < STATES; i++) {
        if (!isfinite(x[i])) {
            return refuse(instance, "%s: %s is %g; a finite number is needed.", function,
                          variables[states[i]].name, x[i]);
        }
    }
    for (int i = 0; i < STATES; i++) {
        instance->memory.component.v[states[i]] = x[i];
    }
    instance->memory.stale = true;
    return fmi2OK;
}

FMI2_STATUS(fmi2GetDerivatives)(fmi2Component c, fmi2Real dx[], size_t n) {
    ENTER(with_array(c, MAY_GET_CONTINUOUS, "fmi2GetDerivatives", dx, n, STATES));
    const fmi2Status status = refreshed(instance);
    for (size_t i = 0; status == fmi2OK && i < n; i++) {
        dx[i] = (int)i < STATES ? instance->memory.component.v[derivatives[i]] : 0.0;
    }
    return status;
}

FMI2_STATUS(fmi2GetEventIndicators)(fmi2Component c, fmi2Real indicator[], size_t n) {
    ENTER(with_array(c, MAY_GET_CONTINUOUS, "fmi2GetEventIndicators", indicator, n, INDICATORS));
    if (n > INDICATORS) {
        indicator[0] = 1.0;
    }
    component_indicators(&instance->memory.component, REST, indicator);
    return fmi2OK;
}

FMI2_STATUS(fmi2GetContinuousStates)(fmi2Component c, fmi2Real x[], size_t n) {
    Instance *instance = with_array(c, MAY_GET_CONTINUOUS, "fmi2GetContinuousStates", x, n, STATES);
    for (size_t i = 0; instance && i < n; i++) {
        x[i] = (int)i < STATES ? instance->memory.component.v[states[i]] : 0.0;
    }
    return instance ? fmi2OK : fmi2Error;
}

FMI2_STATUS(fmi2GetNominalsOfContinuousStates)
(fmi2Component c, fmi2Real nominal[], size_t n) {
    Instance *instance =
        with_array(c, MAY_GET_NOMINALS, "fmi2GetNominalsOfContinuousStates", nominal, n, STATES);
    for (size_t i = 0; instance && i < n; i++) {
        nominal[i] = (int)i < STATES ? nominals[i] : 1.0;
    }
    return instance ? fmi2OK : fmi2Error;
}
