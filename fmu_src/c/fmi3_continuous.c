/* FMI 3.0: model exchange. */
#include "fmi3_instance.h"

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
