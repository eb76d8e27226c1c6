/* FMI 3.0: model exchange. */
#include "fmi3_instance.h"

FMI3_FORWARD_ALONE(fmi3EnterContinuousTimeMode, fmi2EnterContinuousTimeMode)

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

FMI3_FORWARD(fmi3SetTime, fmi2SetTime, (fmi3Instance c, fmi3Float64 time), time)
FMI3_FORWARD(fmi3SetContinuousStates, fmi2SetContinuousStates,
             (fmi3Instance c, const fmi3Float64 x[], size_t n), x, n)
FMI3_FORWARD(fmi3GetContinuousStateDerivatives, fmi2GetDerivatives,
             (fmi3Instance c, fmi3Float64 dx[], size_t n), dx, n)
FMI3_FORWARD(fmi3GetEventIndicators, fmi2GetEventIndicators,
             (fmi3Instance c, fmi3Float64 indicator[], size_t n), indicator, n)
FMI3_FORWARD(fmi3GetContinuousStates, fmi2GetContinuousStates,
             (fmi3Instance c, fmi3Float64 x[], size_t n), x, n)
FMI3_FORWARD(fmi3GetNominalsOfContinuousStates, fmi2GetNominalsOfContinuousStates,
             (fmi3Instance c, fmi3Float64 nominal[], size_t n), nominal, n)

#define FMI3_COUNT(name, number)                                                                   \
    FMI3_STATUS(name)(fmi3Instance c, size_t *n) {                                                 \
        if (!c || !n) {                                                                            \
            return fmi3Error;                                                                      \
        }                                                                                          \
        *n = number;                                                                               \
        return fmi3OK;                                                                             \
    }
FMI3_COUNT(fmi3GetNumberOfEventIndicators, INDICATORS)
FMI3_COUNT(fmi3GetNumberOfContinuousStates, STATES)
