/* FMI 3.0: co-simulation steps and the optional event mode.
 *
 * Nothing is computed at an event: values held between events follow the inputs. */
#include "fmi3_instance.h"

/* Return the inner instance if it is in step or event mode; else NULL, with a message. */
static Instance *in_mode(fmi3Instance c, bool paused, const char *function) {
    Instance *instance = entered(INNER(c), STEPPING, function);
    if (instance && instance->memory.paused != paused) {
        complain(instance, "%s is not allowed in %s mode.", function, paused ? "step" : "event");
        return NULL;
    }
    return instance;
}

FMI3_STATUS(fmi3EnterEventMode)(fmi3Instance c) {
    static const char function[] = "fmi3EnterEventMode";
    if (c && memory_of(c)->type == fmi2ModelExchange) {
        return STATUS(fmi2EnterEventMode(INNER(c)));
    }
    Instance *instance = in_mode(c, false, function);
    if (!instance) {
        return fmi3Error;
    }
    if (!((Outer *)c)->events) {
        complain(instance, "%s: the instance was made without event mode.", function);
        return fmi3Error;
    }
    instance->memory.paused = true;
    return fmi3OK;
}

FMI3_STATUS(fmi3EnterStepMode)(fmi3Instance c) {
    Instance *instance = in_mode(c, true, "fmi3EnterStepMode");
    if (!instance) {
        return fmi3Error;
    }
    instance->memory.paused = false;
    return fmi3OK;
}

FMI3_STATUS(fmi3UpdateDiscreteStates)
(fmi3Instance c, fmi3Boolean *update, fmi3Boolean *terminate, fmi3Boolean *nominals,
 fmi3Boolean *values, fmi3Boolean *next_defined, fmi3Float64 *next) {
    fmi2Status status = fmi2OK;
    fmi2EventInfo info;
    if (c && memory_of(c)->type == fmi2ModelExchange) {
        status = fmi2NewDiscreteStates(INNER(c), &info);
    } else if (!in_mode(c, true, "fmi3UpdateDiscreteStates")) {
        return fmi3Error;
    }
    fmi3Boolean *const none[] = {update, terminate, nominals, values, next_defined};
    for (size_t i = 0; i < sizeof none / sizeof none[0]; i++) {
        if (none[i]) {
            *none[i] = false;
        }
    }
    (void)next;
    return STATUS(status);
}

/* If the host allows it, a step ends at the first event within it. */
FMI3_STATUS(fmi3DoStep)
(fmi3Instance c, fmi3Float64 time, fmi3Float64 step, fmi3Boolean no_set_state_before,
 fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last) {
    static const char function[] = "fmi3DoStep";
    Instance *instance = in_mode(c, false, function);
    if (!instance) {
        return fmi3Error;
    }
    if (!event || !terminate || !early || !last) {
        complain(instance, "%s: an argument is NULL.", function);
        return fmi3Error;
    }
    const Outer *outer = (const Outer *)c;
    Component *component = &instance->memory.component;
    component->may_end_early = outer->early;
    *event = *terminate = *early = false;
    const fmi2Status status = fmi2DoStep(INNER(c), time, step, no_set_state_before);
    *last = component->time;
    if (status == fmi2OK) {
        *early = component->done < step;
        *event = outer->events && component->event != 0.0;
    }
    if (component->event != 0.0 && status == fmi2OK) {
        report(instance, "Event at %.9g s.", *last);
    }
    return STATUS(status);
}
