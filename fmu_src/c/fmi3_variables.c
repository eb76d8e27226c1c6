/* FMI 3.0: getting and setting variables and arrays.
 *
 * The value reference of a variable is the index of its first element; EXTENTS holds the sizes. The
 * time follows all variables, then the event indicators. */
#include "fmi3_instance.h"

#include "extents.h"

enum { TIME = VARIABLES };

/* SIZE_MAX if a reference is unknown. */
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
    } else if (n > VARIABLES || n_values > VARIABLES || elements(vr, n) != n_values) {
        complain(instance, "%s: %lu values for variables that have others, or are unknown.",
                 function, (unsigned long)n_values);
    } else {
        return true;
    }
    return false;
}

static void spread(const fmi3ValueReference vr[], size_t n, fmi2ValueReference place[]) {
    for (size_t i = 0, k = 0; i < n; i++) {
        for (int j = 0; j < extents[vr[i]]; j++) {
            place[k++] = vr[i] + (fmi2ValueReference)j;
        }
    }
}

/* Find the places of all elements, if the values fit these variables. */
static bool find_places(fmi3Instance c, const char *function, const fmi3ValueReference vr[],
                        size_t n, const void *values, size_t n_values, fmi2ValueReference place[]) {
    if (!fits(c, function, vr, n, values, n_values)) {
        return false;
    }
    spread(vr, n, place);
    return true;
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
            if (own > VARIABLES || own > room) {
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
    if (!find_places(c, "fmi3SetFloat64", vr, n, value, n_values, place)) {
        return fmi3Error;
    }
    return STATUS(fmi2SetReal(INNER(c), place, n_values, value));
}

FMI3_STATUS(fmi3GetInt32)
(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Int32 value[], size_t n_values) {
    fmi2ValueReference place[VARIABLES];
    if (!find_places(c, "fmi3GetInt32", vr, n, value, n_values, place)) {
        return fmi3Error;
    }
    return STATUS(fmi2GetInteger(INNER(c), place, n_values, value));
}

FMI3_STATUS(fmi3SetInt32)
(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Int32 value[],
 size_t n_values) {
    fmi2ValueReference place[VARIABLES];
    if (!find_places(c, "fmi3SetInt32", vr, n, value, n_values, place)) {
        return fmi3Error;
    }
    return STATUS(fmi2SetInteger(INNER(c), place, n_values, value));
}

FMI3_STATUS(fmi3GetBoolean)
(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Boolean value[], size_t n_values) {
    fmi2ValueReference place[VARIABLES];
    fmi2Boolean whole[VARIABLES];
    if (BOOLEANS == 0) {
        return without(c, "fmi3GetBoolean", n);
    }
    if (!find_places(c, "fmi3GetBoolean", vr, n, value, n_values, place)) {
        return fmi3Error;
    }
    const fmi2Status status = fmi2GetBoolean(INNER(c), place, n_values, whole);
    for (size_t i = 0; status == fmi2OK && i < n_values; i++) {
        value[i] = whole[i] != 0;
    }
    return STATUS(status);
}

FMI3_STATUS(fmi3SetBoolean)
(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Boolean value[],
 size_t n_values) {
    static const char function[] = "fmi3SetBoolean";
    fmi2ValueReference place[VARIABLES];
    fmi2Boolean whole[VARIABLES];
    if (BOOLEANS == 0) {
        return without(c, function, n);
    }
    if (!find_places(c, function, vr, n, value, n_values, place)) {
        return fmi3Error;
    }
    for (size_t i = 0; i < n_values; i++) {
        whole[i] = value[i];
    }
    return STATUS(fmi2SetBoolean(INNER(c), place, n_values, whole));
}

FMI3_STATUS(fmi3GetDirectionalDerivative)
(fmi3Instance c, const fmi3ValueReference unknowns[], size_t n_unknowns,
 const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
 fmi3Float64 sensitivity[], size_t n_sensitivity) {
    static const char function[] = "fmi3GetDirectionalDerivative";
    fmi2ValueReference above[VARIABLES], below[VARIABLES];
    if (!find_places(c, function, unknowns, n_unknowns, sensitivity, n_sensitivity, above) ||
        !find_places(c, function, knowns, n_knowns, seed, n_seed, below)) {
        return fmi3Error;
    }
    return STATUS(fmi2GetDirectionalDerivative(INNER(c), above, n_sensitivity, below, n_seed, seed,
                                               sensitivity));
}
