/* FMI 3.0: features that no component has: other variable types, clocks, configuration. */
#include "fmi3_instance.h"

/* Accept an empty call; report an error otherwise. */
static fmi3Status without(fmi3Instance c, const char *function, size_t n) {
    if (c && n > 0) {
        complain(INNER(c), "%s: this FMU does not support it.", function);
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

/* Functions of clocks with up to three arrays. */
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

#define NO_CALL(name)                                                                              \
    FMI3_STATUS(name)(fmi3Instance c) {                                                            \
        return without(c, #name, 1);                                                               \
    }

NO_CALL(fmi3EvaluateDiscreteStates)
NO_CALL(fmi3EnterConfigurationMode)
NO_CALL(fmi3ExitConfigurationMode)

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
