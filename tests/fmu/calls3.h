/* Calls specific to FMI 3.0. */
#include "chance.h"

/* Number of values that the host declares, sometimes wrongly, and their buffer. */
static size_t told_count(void) {
    static const size_t lies[] = {0, 1, 2, VARIABLES, ROOM, SIZE_MAX};
    return below(30) ? n_values : lies[below(6)];
}

static double *room_for(size_t count) {
    static double all[ROOM];
    return all + ROOM - (count < ROOM ? count : ROOM);
}

static Status enter_initialisation(Host *h) {
    return fmi3EnterInitializationMode(h->c, below(2), number(), below(100) ? 0.0 : number(),
                                       !below(9), number());
}

static int after_initialisation(const Host *h) {
    return h->type == EXCHANGE ? EVENT : h->options & WITH_EVENTS ? PAUSED : STEPS;
}

static Status get_real(Host *h) {
    const size_t count = told_count();
    double *value = room_for(count);
    const Status status = fmi3GetFloat64(h->c, OR_NULL(vr), n, OR_NULL(value), count);
    if (status == fmi3OK && count != n_values) {
        wrong("numbers that were read", (double)count);
    }
    if (status == fmi3OK) {
        look_at(h, value);
    }
    return status;
}

static Status set_real(Host *h) {
    const size_t count = told_count();
    const Status status = fmi3SetFloat64(
        h->c, OR_NULL(vr), n, OR_NULL(count == n_values ? real : room_for(count)), count);
    if (status == fmi3OK && count != n_values) {
        wrong("numbers that were set", (double)count);
    }
    return status;
}

#define GET_AND_SET(name)                                                                          \
    case __COUNTER__ - BEFORE:                                                                     \
        return below(2) ? fmi3Get##name(h->c, vr, few, values, few)                                \
                        : fmi3Set##name(h->c, vr, few, values, few);
#define OF_CLOCKS(name)                                                                            \
    case __COUNTER__ - BEFORE:                                                                     \
        return fmi3##name(h->c, vr, few, values, values, values);

/* Types that the FMU lacks, and integers. */
static Status get_or_set_others(Host *h) {
    enum { BEFORE = __COUNTER__ + 1 };
    const size_t few = below(9) ? 0 : n;
    double values[MOST] = {0.0};
    size_t sizes[MOST] = {0};
    fmi3DependencyKind kinds[MOST];
    switch (below(30)) {
        TYPES(GET_AND_SET)
        CLOCKS(OF_CLOCKS)
    case 20:
        return fmi3GetBinary(h->c, vr, few, sizes, values, few);
    case 21:
        return fmi3SetBinary(h->c, vr, few, sizes, values, few);
    case 22:
        return fmi3GetOutputDerivatives(h->c, vr, few, integer, values, few);
    case 23:
        return fmi3SetInt32(h->c, vr, few, integer, few + !below(99));
    default:
        break;
    }
    if (below(20)) {
        return fmi3GetInt32(h->c, vr, few, integer, few);
    }
    switch (below(6)) {
    case 0:
        return fmi3EvaluateDiscreteStates(h->c);
    case 1:
        return below(2) ? fmi3EnterConfigurationMode(h->c) : fmi3ExitConfigurationMode(h->c);
    case 2:
        return fmi3GetNumberOfVariableDependencies(h->c, reference(), OR_NULL(sizes));
    case 3:
        return fmi3GetVariableDependencies(h->c, reference(), sizes, vr, sizes, kinds, n);
    case 4:
        return fmi3GetAdjointDerivative(h->c, vr, n, vr, n, real, n_values, real, n_values);
    default:
        return fmi3ActivateModelPartition(h->c, 0, number());
    }
}

static Status derive(Host *h) {
    Ref unknown[MOST];
    const size_t count = choose_unknowns(unknown);
    size_t slopes = 0;
    for (size_t i = 0; i < count; i++) {
        slopes += size_at(unknown[i]);
    }
    slopes = below(200) ? slopes : told_count();
    choose_inputs();
    return fmi3GetDirectionalDerivative(h->c, OR_NULL(unknown), count, OR_NULL(vr), n,
                                        OR_NULL(real), below(200) ? n_values : n_values / 2,
                                        OR_NULL(room_for(slopes)), slopes);
}

static Status step(Host *h) {
    const double from = below(200) ? h->time : number(), length = length_of_step();
    bool event = true, terminate = true, early = true;
    double last = NAN;
    const Status status = fmi3DoStep(h->c, from, length, true, OR_NULL(&event), OR_NULL(&terminate),
                                     OR_NULL(&early), OR_NULL(&last));
    if (status != fmi3OK) {
        return status;
    }
    if (!(last >= from && last <= from + length) || (!early && last != from + length)) {
        wrong("end of a step", last);
    }
    if (terminate || (early && !(h->options & MAY_END_EARLY)) ||
        (event && !(h->options & WITH_EVENTS))) {
        wrong("what a step tells and was not asked for", last);
    }
    h->time = last;
    return status;
}

static Status new_discrete_states(Host *h) {
    bool some[5];
    double next;
    return fmi3UpdateDiscreteStates(h->c, OR_NULL(some), OR_NULL(some + 1), OR_NULL(some + 2),
                                    OR_NULL(some + 3), OR_NULL(some + 4), OR_NULL(&next));
}

static Status count(Host *h) {
    size_t indicators = SIZE_MAX, continuous = SIZE_MAX;
    const Status status = fmi3GetNumberOfEventIndicators(h->c, &indicators);
    const Status other = fmi3GetNumberOfContinuousStates(h->c, &continuous);
    if (status == fmi3OK && (indicators != INDICATORS || continuous != STATES)) {
        wrong("number of states", (double)continuous);
    }
    return status == fmi3OK ? other : status;
}

#define OWN_ACTIONS {count, NULL, ALWAYS, 1, SAME}, {NULL, fmi3EnterStepMode, PAUSED, 9, STEPS},
