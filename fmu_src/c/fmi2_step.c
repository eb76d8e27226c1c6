/* FMI 2.0: co-simulation. */
#include "fmi2_instance.h"

/* Move the inputs along their slopes to `time` [s] after those of `from`. */
static void follow_slopes(Memory *memory, const Component *from, double time) {
    for (int i = 0; i < SLOPES; i++) {
        if (variables[i].role == INPUT) {
            memory->component.v[i] = from->v[i] + from->slope[i] * time;
        }
    }
}

static void forget_slopes(Memory *memory) {
    memset(memory->component.slope, 0, sizeof memory->component.slope);
    memory->sloped = false;
}

/* Advance the states. Inputs with slopes are held at mid-step values, unless the component follows
 * them by inner steps. */
SELDOM static bool follow(Memory *memory, void *workspace, double step, Message *why) {
    const Component before = memory->component;
    follow_slopes(memory, &before, INNER_STEPS ? 0.0 : 0.5 * step);
    component_event(&memory->component, 0.0, NULL);
    bool moved = component_step(&memory->component, workspace, step, why);
    if (moved) {
        follow_slopes(memory, &before, memory->component.done);
        component_event(&memory->component, 0.0, NULL);
        moved = component_output(&memory->component, workspace, why);
    }
    if (!moved) {
        memory->component = before;
        return false;
    }
    forget_slopes(memory);
    return true;
}

/* By default a step is completed as a whole and without an event. */
static void begin_step(Memory *memory, double step) {
    memory->component.done = step;
    memory->component.event = 0.0;
}

static bool move(Memory *memory, void *workspace, double step, Message *why) {
    begin_step(memory, step);
    if (memory->sloped) {
        return follow(memory, workspace, step, why);
    }
    component_event(&memory->component, 0.0, NULL);
    return component_step(&memory->component, workspace, step, why);
}

/* Skip round-off of accumulated times: the component divides by the step. */
static bool is_rounding(double step) {
    return step < 1e-9 * PREFERRED_STEP;
}

/* Whether a step passes the end of the experiment by more than round-off. */
static bool passes_end(const Memory *memory, double time, double step) {
    const double least = 1e-9 * PREFERRED_STEP, part = 1e-3 * step;
    const double rounding = (part > least ? part : least) + 1e-15 * fabs(memory->stop);
    return time + step > memory->stop + rounding;
}

static fmi2Status refuse_step(Instance *instance, double step, const Message *why) {
    Memory *memory = &instance->memory;
    memory->refusals = step == memory->refused ? memory->refusals + 1 : 1;
    memory->refused = step;
    if (memory->refusals <= MOST_REFUSALS) {
        return refuse(instance, "%s", why->text);
    }
    return FAIL(instance, "%s This step has been requested %d times.", why->text, memory->refusals);
}

FMI2_STATUS(fmi2DoStep)
(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_set_state_before) {
    Message why;
    (void)no_set_state_before;
    ENTER(entered(c, STEPPING, "fmi2DoStep"));
    Memory *memory = &instance->memory;
    if (!isfinite(time) || !isfinite(step) || !(step > 0.0)) {
        return FAIL(instance, "fmi2DoStep: the step is %g s from time %g s; it must be positive.",
                    step, time);
    }
    if (passes_end(memory, time, step)) {
        return FAIL(instance,
                    "fmi2DoStep: the step from %.17g s to %.17g s passes the end, %.17g s.", time,
                    time + step, memory->stop);
    }
    if (is_rounding(step)) {
        memory->refusals = 0;
        begin_step(memory, step);
        memory->component.time = time + step;
        forget_slopes(memory);
        return fmi2OK;
    }
    memory->component.time = time;
    if (!move(memory, instance->workspace, step, &why)) {
        memory->stale = true;
        return refuse_step(instance, step, &why);
    }
    memory->refusals = 0;
    memory->component.time = time + memory->component.done;
    memory->stale = false;
    if (!all_finite(memory, &why)) {
        return FAIL(instance, "%s", why.text);
    }
    return fmi2OK;
}

/* Steps are synchronous: there is nothing to cancel and no status to report. */
static fmi2Status no_status(fmi2Component c, const char *function) {
    ENTER(entered(c, MAY_GET_STATUS, function));
    return refuse(instance, "%s: steps are never asynchronous, so this status does not exist.",
                  function);
}

FMI2_STATUS(fmi2CancelStep)(fmi2Component c) {
    Instance *instance = entered(c, MAY_CANCEL, "fmi2CancelStep");
    if (instance) {
        complain(instance, "fmi2CancelStep: no step is in progress.");
    }
    return fmi2Error;
}

#define NO_STATUS(function, type)                                                                  \
    FMI2_STATUS(function)(fmi2Component c, const fmi2StatusKind kind, type *value) {               \
        (void)kind, (void)value;                                                                   \
        return no_status(c, #function);                                                            \
    }

NO_STATUS(fmi2GetStatus, fmi2Status)
NO_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_STATUS(fmi2GetStringStatus, fmi2String)

FMI2_STATUS(fmi2GetRealStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    static const char function[] = "fmi2GetRealStatus";
    if (kind != fmi2LastSuccessfulTime) {
        return no_status(c, function);
    }
    ENTER(entered_with(c, MAY_GET_STATUS, function, value));
    *value = instance->memory.component.time;
    return fmi2OK;
}

FMI2_STATUS(fmi2GetBooleanStatus)
(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    static const char function[] = "fmi2GetBooleanStatus";
    if (kind != fmi2Terminated) {
        return no_status(c, function);
    }
    ENTER(entered_with(c, MAY_GET_STATUS, function, value));
    *value = fmi2False;
    return fmi2OK;
}
