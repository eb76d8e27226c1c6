/* Calls specific to FMI 2.0. */
#include "chance.h"

static Status set_up(Host *h) {
    return fmi2SetupExperiment(h->c, 1, number(), below(100) ? 0.0 : number(), !below(9), number());
}

static Status enter_initialisation(Host *h) {
    return fmi2EnterInitializationMode(h->c);
}

static int after_initialisation(const Host *h) {
    return h->type == EXCHANGE ? EVENT : STEPS;
}

static Status get_real(Host *h) {
    const Status status = fmi2GetReal(h->c, OR_NULL(vr), n, OR_NULL(real));
    if (status == fmi2OK) {
        look_at(h, real);
    }
    return status;
}

static Status set_real(Host *h) {
    return fmi2SetReal(h->c, OR_NULL(vr), n, OR_NULL(real));
}

static Status get_or_set_others(Host *h) {
    const size_t few = below(9) ? 0 : n;
    switch (below(7)) {
    case 0:
        return fmi2GetInteger(h->c, vr, few, integer);
    case 1:
        return fmi2GetBoolean(h->c, vr, few, integer);
    case 2:
        return fmi2GetString(h->c, vr, few, string);
    case 3:
        return fmi2SetInteger(h->c, vr, few, integer);
    case 4:
        return fmi2SetBoolean(h->c, vr, few, integer);
    case 5:
        return fmi2SetString(h->c, vr, few, string);
    default:
        return fmi2GetRealOutputDerivatives(h->c, vr, few, integer, real);
    }
}

static Status derive(Host *h) {
    static double slopes[MOST];
    Ref unknown[MOST];
    const size_t count = choose_unknowns(unknown);
    choose_inputs();
    return fmi2GetDirectionalDerivative(h->c, OR_NULL(unknown), count, OR_NULL(vr), n,
                                        OR_NULL(real), slopes + MOST - count);
}

static Status step(Host *h) {
    const double length = length_of_step();
    const Status status = fmi2DoStep(h->c, below(200) ? h->time : number(), length, fmi2True);
    h->time += status == fmi2OK ? length : 0.0;
    return status;
}

static Status set_slopes(Host *h) {
    choose_inputs();
    return fmi2SetRealInputDerivatives(h->c, OR_NULL(vr), n, OR_NULL(integer), OR_NULL(real));
}

static Status get_status(Host *h) {
    fmi2Status status;
    double time;
    int whole;
    Text text;
    switch (below(6)) {
    case 0:
        return fmi2GetStatus(h->c, fmi2DoStepStatus, &status);
    case 1:
        return fmi2GetRealStatus(h->c, fmi2LastSuccessfulTime, OR_NULL(&time));
    case 2:
        return fmi2GetIntegerStatus(h->c, fmi2DoStepStatus, &whole);
    case 3:
        return fmi2GetBooleanStatus(h->c, fmi2Terminated, OR_NULL(&whole));
    case 4:
        return fmi2GetStringStatus(h->c, fmi2PendingStatus, &text);
    default:
        return fmi2CancelStep(h->c) == fmi2Error ? fmi2OK : fmi2Fatal;
    }
}

static Status new_discrete_states(Host *h) {
    fmi2EventInfo info;
    return fmi2NewDiscreteStates(h->c, OR_NULL(&info));
}

#define OWN_ACTIONS                                                                                \
    {set_up, NULL, START, 2, SAME}, {set_slopes, NULL, START | STEPS, 4, SAME},                    \
        {get_status, NULL, STEPS | END, 2, SAME},
