/* FMI 2.0: getting and setting variables; a call processes all of its values or none. */
#include "fmi2_instance.h"

static int settable(int role) {
    switch (role) {
    case INPUT:
        return MAY_SET;
    case TUNABLE:
        return INSTANTIATED | INITIALISING | STEPPING | AT_EVENT;
    case FIXED:
        return INSTANTIATED | INITIALISING;
    case STATE: /* also individually where fmi2SetContinuousStates sets all (section 3.1) */
        return AT_EVENT | CONTINUOUS;
    default:
        return 0;
    }
}

static const Variable *variable_of(fmi2ValueReference vr) {
    return &variables[vr];
}

/* First of consecutive variables that one check serves, or NULL. */
static const Variable *first_alike(const fmi2ValueReference vr[], size_t n, const void *value) {
    if (n == 0 || !vr || !value || vr[0] >= VARIABLES || n > (size_t)variable_of(vr[0])->alike) {
        return NULL;
    }
    for (size_t i = 1; i < n; i++) {
        if (vr[i] != vr[0] + i) {
            return NULL;
        }
    }
    return variable_of(vr[0]);
}

NOINLINE static bool known(const Instance *instance, const char *function, Type type,
                           const fmi2ValueReference vr[], size_t n, const void *value) {
    if (n > 0 && (!vr || !value)) {
        complain(instance, "%s: an argument is NULL.", function);
        return false;
    }
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= VARIABLES || variable_of(vr[i])->type != type) {
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
        if (!(settable(variable_of(vr[i])->role) & instance->memory.mode)) {
            complain(instance, "%s: %s cannot be set in this state of the instance.", function,
                     variable_of(vr[i])->name);
            return false;
        }
    }
    return true;
}

/* Index of the first non-finite number, which is refused, or `n`. */
static size_t first_odd(const fmi2Real value[], size_t n) {
    size_t i = 0;
    while (i < n && isfinite(value[i])) {
        i++;
    }
    return i;
}

static fmi2Status refuse_number(const Instance *instance, const char *function,
                                fmi2ValueReference vr, fmi2Real value) {
    return refuse(instance, "%s: %s is %g; a finite number is needed.", function,
                  variable_of(vr)->name, value);
}

/* On-demand variables must be finite; after a termination the last values are returned, after a
 * failure only finite ones. */
static fmi2Status readable(const Instance *instance, const fmi2ValueReference vr[], size_t n) {
    const Component *component = &instance->memory.component;
    const int failure = instance->memory.mode == FAILED;
    for (size_t i = 0; instance->memory.mode != TERMINATED && i < n; i++) {
        const Variable *variable = variable_of(vr[i]);
        const double value = component->v[vr[i]];
        if ((failure || variable->role == ON_DEMAND || variable->role == DERIVATIVE) &&
            !isfinite(value)) {
            const fmi2Status status = refuse(instance, "%s became %g at time %.9g.", variable->name,
                                             value, component->time);
            return failure ? fmi2Error : status;
        }
    }
    return fmi2OK;
}

/* Compute the state derivatives, which steps may omit, without changing any output. */
static void derive(Instance *instance) {
    Component *component = &instance->memory.component;
    Component other = *component;
    Message why;
    other.continuous = 1.0;
    component_output(&other, instance->workspace, &why);
    for (int i = 0; i < STATES; i++) {
        if (variables[derivatives[i]].role == DERIVATIVE) {
            component->v[derivatives[i]] = other.v[derivatives[i]];
        }
    }
}

static fmi2Status read(fmi2Component c, const char *function, Type type,
                       const fmi2ValueReference vr[], size_t n, const void *value) {
    bool demanded = false, derived = false;
    ENTER(entered(c, MAY_GET, function));
    if (!known(instance, function, type, vr, n, value)) {
        return failed(instance);
    }
    const fmi2Status status = refreshed(instance);
    const bool discrete = instance->memory.type == fmi2CoSimulation ||
                          (instance->memory.mode & (INITIALISING | AT_EVENT));
    for (size_t i = 0; discrete && i < n; i++) {
        demanded = demanded || variable_of(vr[i])->role == ON_DEMAND;
        derived = derived || variable_of(vr[i])->role == DERIVATIVE;
    }
    if (demanded && status == fmi2OK) {
        component_demand(&instance->memory.component);
    }
    if (derived && status == fmi2OK) {
        derive(instance);
    }
    return status == fmi2OK ? readable(instance, vr, n) : status;
}

FMI2_STATUS(fmi2GetReal)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    const Memory *memory = c ? &((const Instance *)c)->memory : NULL;
    if (memory && (memory->mode & RUNNING) && !memory->stale && first_alike(vr, n, value)) {
        memcpy(value, &memory->component.v[vr[0]], n * sizeof *value);
        return fmi2OK;
    }
    const fmi2Status status = read(c, "fmi2GetReal", REAL, vr, n, value);
    for (size_t i = 0; status == fmi2OK && i < n; i++) {
        value[i] = ((const Instance *)c)->memory.component.v[vr[i]];
    }
    return status;
}

FMI2_STATUS(fmi2GetInteger)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[]) {
    const fmi2Status status = read(c, "fmi2GetInteger", INTEGER, vr, n, value);
    for (size_t i = 0; status == fmi2OK && i < n; i++) {
        value[i] = (fmi2Integer)((const Instance *)c)->memory.component.v[vr[i]];
    }
    return status;
}

static void set_one(Memory *memory, fmi2ValueReference vr, double value) {
    const Variable *variable = variable_of(vr);
    memory->component.v[vr] = value;
    memory->component.changed += variable->role != INPUT;
    memory->stale |= variable->used;
}

static Instance *settable_in(fmi2Component c, const char *function, Type type,
                             const fmi2ValueReference vr[], size_t n, const void *value) {
    Instance *instance = entered(c, MAY_SET, function);
    if (instance && !(known(instance, function, type, vr, n, value) &&
                      all_settable(instance, function, vr, n))) {
        failed(instance);
        return NULL;
    }
    return instance;
}

FMI2_STATUS(fmi2SetReal)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    static const char function[] = "fmi2SetReal";
    const Variable *all = c ? first_alike(vr, n, value) : NULL;
    if (all && (settable(all->role) & ((Instance *)c)->memory.mode) && first_odd(value, n) == n) {
        Memory *memory = &((Instance *)c)->memory;
        memcpy(&memory->component.v[vr[0]], value, n * sizeof *value);
        memory->component.changed += all->role != INPUT;
        memory->stale |= all->used;
        return fmi2OK;
    }
    ENTER(settable_in(c, function, REAL, vr, n, value));
    const size_t odd = first_odd(value, n);
    if (odd < n) {
        return refuse_number(instance, function, vr[odd], value[odd]);
    }
    for (size_t i = 0; i < n; i++) {
        const double low = numbers.of[vr[i]].low, high = numbers.of[vr[i]].high;
        if (value[i] < low || value[i] > high) {
            return refuse(instance, "%s: %s is %g; expected %g to %g.", function,
                          variable_of(vr[i])->name, value[i], low, high);
        }
    }
    for (size_t i = 0; i < n; i++) {
        set_one(&instance->memory, vr[i], value[i]);
    }
    return fmi2OK;
}

FMI2_STATUS(fmi2SetInteger)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[]) {
    static const char function[] = "fmi2SetInteger";
    ENTER(settable_in(c, function, INTEGER, vr, n, value));
    for (size_t i = 0; i < n; i++) {
        const double low = numbers.of[vr[i]].low, high = numbers.of[vr[i]].high;
        if (value[i] < low || value[i] > high) {
            return FAIL(instance, "%s: %s is %d; expected %g to %g.", function,
                        variable_of(vr[i])->name, value[i], low, high);
        }
    }
    for (size_t i = 0; i < n; i++) {
        set_one(&instance->memory, vr[i], value[i]);
    }
    return fmi2OK;
}

/* A component without variables of a type accepts only an empty list. */
static fmi2Status none(fmi2Component c, int modes, const char *function, size_t n) {
    ENTER(entered(c, modes, function));
    if (n > 0) {
        return FAIL(instance, "%s: there are no variables of this type.", function);
    }
    return fmi2OK;
}

FMI2_STATUS(fmi2GetBoolean)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[]) {
    static const char function[] = "fmi2GetBoolean";
    if (BOOLEANS == 0) {
        return none(c, MAY_GET, function, n);
    }
    const fmi2Status status = read(c, function, LOGICAL, vr, n, value);
    for (size_t i = 0; status == fmi2OK && i < n; i++) {
        value[i] = ((const Instance *)c)->memory.component.v[vr[i]] != 0.0;
    }
    return status;
}

FMI2_STATUS(fmi2GetString)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
    (void)vr, (void)value;
    return none(c, MAY_GET, "fmi2GetString", n);
}

FMI2_STATUS(fmi2SetBoolean)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[]) {
    static const char function[] = "fmi2SetBoolean";
    if (BOOLEANS == 0) {
        return none(c, MAY_SET, function, n);
    }
    Instance *instance = settable_in(c, function, LOGICAL, vr, n, value);
    for (size_t i = 0; instance && i < n; i++) {
        set_one(&instance->memory, vr[i], value[i] != fmi2False);
    }
    return instance ? fmi2OK : fmi2Error;
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
    ENTER(entered(c, MAY_SET_SLOPES, function));
    if (!known(instance, function, REAL, vr, n, order ? value : NULL)) {
        return failed(instance);
    }
    for (size_t i = 0; i < n; i++) {
        if (variable_of(vr[i])->role != INPUT || order[i] != 1) {
            return FAIL(instance, "%s: only first derivatives of inputs can be set, not of %s.",
                        function, variable_of(vr[i])->name);
        }
    }
    const size_t odd = first_odd(value, n);
    if (odd < n) {
        return refuse_number(instance, function, vr[odd], value[odd]);
    }
    for (size_t i = 0; i < n; i++) {
        instance->memory.component.slope[vr[i]] = value[i];
    }
    instance->memory.sloped = true;
    return fmi2OK;
}

FMI2_STATUS(fmi2GetRealOutputDerivatives)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
 fmi2Real value[]) {
    (void)vr, (void)order, (void)value;
    return none(c, MAY_GET_SLOPES, "fmi2GetRealOutputDerivatives", n);
}

/* Also outputs may be states. */
static bool is_state(fmi2ValueReference vr) {
    bool found = false;
    for (int i = 0; i < STATES; i++) {
        found |= (fmi2ValueReference)states[i] == vr;
    }
    return found;
}

/* Whether these derivatives exist. Until initialisation ends, states follow from start values. */
static bool differentiable(const Instance *instance, const char *function,
                           const fmi2ValueReference unknowns[], size_t n_unknown,
                           const fmi2ValueReference knowns[], size_t n_known) {
    const bool initialising = instance->memory.mode == INITIALISING;
    for (size_t i = 0; i < n_unknown; i++) {
        const int role = variable_of(unknowns[i])->role;
        if (role != OUTPUT && role != LOCAL && role != DERIVATIVE &&
            !(role == STATE && initialising)) {
            complain(instance, "%s: %s is neither a continuous output nor a state derivative.",
                     function, variable_of(unknowns[i])->name);
            return false;
        }
    }
    for (size_t i = 0; i < n_known; i++) {
        const int role = variable_of(knowns[i])->role;
        if (role != INPUT && role != TUNABLE &&
            !(initialising ? role == FIXED : is_state(knowns[i]))) {
            complain(instance, "%s: derivatives with respect to %s are not available.", function,
                     variable_of(knowns[i])->name);
            return false;
        }
    }
    return true;
}

SELDOM FMI2_STATUS(fmi2GetDirectionalDerivative)(fmi2Component c,
                                                 const fmi2ValueReference unknowns[],
                                                 size_t n_unknown,
                                                 const fmi2ValueReference knowns[], size_t n_known,
                                                 const fmi2Real d_known[], fmi2Real d_unknown[]) {
    static const char function[] = "fmi2GetDirectionalDerivative";
    double seed[VARIABLES] = {0.0}, tangent[VARIABLES] = {0.0};
    ENTER(entered(c, MAY_GET, function));
    if (!DIRECTIONAL_DERIVATIVES) {
        return complain(instance, "%s: this FMU provides no directional derivatives.", function);
    }
    if (!known(instance, function, REAL, unknowns, n_unknown, d_unknown) ||
        !known(instance, function, REAL, knowns, n_known, d_known) ||
        !differentiable(instance, function, unknowns, n_unknown, knowns, n_known)) {
        return failed(instance);
    }
    const size_t odd = first_odd(d_known, n_known);
    if (odd < n_known) {
        return refuse_number(instance, function, knowns[odd], d_known[odd]);
    }
    const fmi2Status status = refreshed(instance);
    if (status != fmi2OK) {
        return status;
    }
    for (size_t i = 0; i < n_known; i++) {
        seed[knowns[i]] += d_known[i];
    }
    component_tangent(&instance->memory.component, seed, tangent);
    for (size_t i = 0; i < n_unknown; i++) {
        if (!isfinite(tangent[unknowns[i]])) {
            return refuse(instance, "%s: the derivative of %s is %g at time %.9g.", function,
                          variable_of(unknowns[i])->name, tangent[unknowns[i]],
                          instance->memory.component.time);
        }
    }
    for (size_t i = 0; i < n_unknown; i++) {
        d_unknown[i] = tangent[unknowns[i]];
    }
    return fmi2OK;
}
