/* FMI 2.0: getting and setting variables. A call either takes all its values or none. */
#include "fmi2_instance.h"

/* In which states of the instance a variable of a role may be set. */
static int settable(Role role) {
    switch (role) {
    case INPUT:
    case TUNABLE:
        return INSTANTIATED | INITIALISING | STEPPING;
    case FIXED:
    case STATE:
        return INSTANTIATED | INITIALISING;
    default:
        return 0;
    }
}

/* Whether all value references stand for variables of a type; tells the host if not. */
static bool known(const Instance *instance, const char *function, Type type,
                  const fmi2ValueReference vr[], size_t n, const void *value) {
    if (n > 0 && (!vr || !value)) {
        complain(instance, "%s: an array of values is missing.", function);
        return false;
    }
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= VARIABLES || variables[vr[i]].type != type) {
            complain(instance, "%s: there is no variable of this type with value reference %u.",
                     function, vr[i]);
            return false;
        }
    }
    return true;
}

static bool all_settable(const Instance *instance, const char *function,
                         const fmi2ValueReference vr[], size_t n) {
    for (size_t i = 0; i < n; i++) {
        if (!(settable(variables[vr[i]].role) & instance->memory.mode)) {
            complain(instance, "%s: %s cannot be set in this state of the instance.", function,
                     variables[vr[i]].name);
            return false;
        }
    }
    return true;
}

static bool all_finite(const Instance *instance, const char *function,
                       const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    for (size_t i = 0; i < n; i++) {
        if (!isfinite(value[i])) {
            complain(instance, "%s: %s is %g; a finite number is needed.", function,
                     variables[vr[i]].name, value[i]);
            return false;
        }
    }
    return true;
}

/* Common part of the getters: NULL if the call is refused. */
static const double *readable(fmi2Component c, const char *function, Type type,
                              const fmi2ValueReference vr[], size_t n, const void *value) {
    Instance *instance = entered(c, MAY_GET, function);
    if (!instance) {
        return NULL;
    }
    /* After a failure or the end, what was computed last is what there is to read. */
    bool running = instance->memory.mode & (INITIALISING | STEPPING);
    if (!known(instance, function, type, vr, n, value) || (running && !refreshed(instance))) {
        failed(instance);
        return NULL;
    }
    return instance->memory.component.v;
}

FMI2_STATUS(fmi2GetReal)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    const double *v = readable(c, "fmi2GetReal", REAL, vr, n, value);
    for (size_t i = 0; v && i < n; i++) {
        value[i] = v[vr[i]];
    }
    return v ? fmi2OK : fmi2Error;
}

FMI2_STATUS(fmi2GetInteger)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[]) {
    const double *v = readable(c, "fmi2GetInteger", INTEGER, vr, n, value);
    for (size_t i = 0; v && i < n; i++) {
        value[i] = (fmi2Integer)v[vr[i]];
    }
    return v ? fmi2OK : fmi2Error;
}

FMI2_STATUS(fmi2SetReal)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    static const char function[] = "fmi2SetReal";
    Instance *instance = entered(c, MAY_SET, function);
    if (!instance) {
        return fmi2Error;
    }
    if (!known(instance, function, REAL, vr, n, value) ||
        !all_settable(instance, function, vr, n) || !all_finite(instance, function, vr, n, value)) {
        return failed(instance);
    }
    for (size_t i = 0; i < n; i++) {
        instance->memory.component.v[vr[i]] = value[i];
    }
    instance->memory.stale = true;
    return fmi2OK;
}

FMI2_STATUS(fmi2SetInteger)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[]) {
    static const char function[] = "fmi2SetInteger";
    Instance *instance = entered(c, MAY_SET, function);
    if (!instance) {
        return fmi2Error;
    }
    if (!known(instance, function, INTEGER, vr, n, value) ||
        !all_settable(instance, function, vr, n)) {
        return failed(instance);
    }
    for (size_t i = 0; i < n; i++) {
        const Variable *variable = &variables[vr[i]];
        if (value[i] < variable->low || value[i] > variable->high) {
            complain(instance, "%s: %s is %d; needed is %d to %d.", function, variable->name,
                     value[i], variable->low, variable->high);
            return failed(instance);
        }
    }
    for (size_t i = 0; i < n; i++) {
        instance->memory.component.v[vr[i]] = value[i];
    }
    instance->memory.stale = true;
    return fmi2OK;
}

/* No component has Boolean or String variables, so only an empty list of them is right. */
static fmi2Status none(fmi2Component c, int modes, const char *function, size_t n) {
    Instance *instance = entered(c, modes, function);
    if (!instance) {
        return fmi2Error;
    }
    if (n > 0) {
        complain(instance, "%s: there are no variables of this type.", function);
        return failed(instance);
    }
    return fmi2OK;
}

FMI2_STATUS(fmi2GetBoolean)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[]) {
    (void)vr, (void)value;
    return none(c, MAY_GET, "fmi2GetBoolean", n);
}

FMI2_STATUS(fmi2GetString)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
    (void)vr, (void)value;
    return none(c, MAY_GET, "fmi2GetString", n);
}

FMI2_STATUS(fmi2SetBoolean)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[]) {
    (void)vr, (void)value;
    return none(c, MAY_SET, "fmi2SetBoolean", n);
}

FMI2_STATUS(fmi2SetString)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
    (void)vr, (void)value;
    return none(c, MAY_SET, "fmi2SetString", n);
}

FMI2_STATUS(fmi2SetRealInputDerivatives)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
 const fmi2Real value[]) {
    static const char function[] = "fmi2SetRealInputDerivatives";
    Instance *instance = entered(c, MAY_SET, function);
    if (!instance) {
        return fmi2Error;
    }
    if (!known(instance, function, REAL, vr, n, value) ||
        !all_finite(instance, function, vr, n, value)) {
        return failed(instance);
    }
    for (size_t i = 0; i < n; i++) {
        if (variables[vr[i]].role != INPUT || !order || order[i] != 1) {
            complain(instance, "%s: only first derivatives of inputs can be set, not of %s.",
                     function, variables[vr[i]].name);
            return failed(instance);
        }
    }
    for (size_t i = 0; i < n; i++) {
        instance->memory.slope[vr[i]] = value[i];
    }
    instance->memory.sloped = true;
    return fmi2OK;
}

FMI2_STATUS(fmi2GetRealOutputDerivatives)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
 fmi2Real value[]) {
    (void)vr, (void)order, (void)value;
    return none(c, MAY_GET, "fmi2GetRealOutputDerivatives", n);
}

FMI2_STATUS(fmi2GetDirectionalDerivative)
(fmi2Component c, const fmi2ValueReference unknown[], size_t n_unknown,
 const fmi2ValueReference known_[], size_t n_known, const fmi2Real d_known[],
 fmi2Real d_unknown[]) {
    (void)unknown, (void)known_, (void)n_known, (void)d_known, (void)d_unknown;
    return none(c, MAY_GET, "fmi2GetDirectionalDerivative", n_unknown);
}
