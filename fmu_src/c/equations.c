/* Component: equations, shared by all joints or different for each.
 *
 *     the memory advances over a step with the inputs held; then it determines the outputs
 *
 * The generated equations.h defines the functions, the table `joints`, and the indices of
 * variables. Signs of inputs where an equation jumps are held between events. Equations with
 * previous values take a sample at each step, or at multiples of their sample time, and hold their
 * outputs in between. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "component_alone.h"
#include "coupling.h"
#include "equations.h"

enum {
    STARTED = 0,                         /* whether initialisation has ended */
    LAST_STEP = 1,                       /* length of the last step [s], 0 before the first */
    BEGIN = 2,                           /* start time [s] */
    TICKS = 3,                           /* samples since then; negative while outputs are held */
    INVARIANT_STEP = 4,                  /* step length of the invariants */
    USED = OWN_FIXED,                    /* inputs held over the last step */
    BEFORE = USED + JOINTS * MAX_INPUTS, /* states before the last step */
    PREVIOUS = BEFORE + JOINTS * MAX_STATES,       /* values at the sample before last */
    LATEST = PREVIOUS + JOINTS * MAX_REMEMBERED,   /* values at the last sample */
    INVARIANTS = LATEST + JOINTS * MAX_REMEMBERED, /* terms of parameters and step length only */
    HELD = INVARIANTS + JOINTS * MAX_INVARIANTS,
};

/* Tolerance for a sum of steps to hit a sample, as a fraction of the sample time. */
#define ROUNDING 1e-6

/* Maximum number of samples in a step. */
#define MAX_SAMPLES 1e7

/* Arguments of a joint's functions. */
typedef struct {
    const Joint *joint;
    const double *k; /* parameters */
    const double *s; /* signs */
    double u[MAX_INPUTS];
} Place;

/* Arguments of joint i's functions at the current inputs. */
static Place place_of(const Component *component, int i) {
    const Joint *joint = &joints[i];
    const double *v = component->v;
    Place at;
    at.joint = joint;
    at.k = parameters_of(component->v, &joints[i]);
    at.s = &component->own[HELD + joint->first_switch];
    for (int j = 0; j < joint->inputs; j++) {
        at.u[j] = input_of(v, i, j);
    }
    return at;
}

/* Functions that return where numbers of joint i start. */
#define PLACE_OF(name, place)                                                                      \
    static double *name(Component *component, int i) {                                             \
        return &component->place;                                                                  \
    }

PLACE_OF(states_of, v[joints[i].first_state])
PLACE_OF(signs_of, own[HELD + joints[i].first_switch])
PLACE_OF(inputs_before, own[USED + i * MAX_INPUTS])
PLACE_OF(previous_of, own[PREVIOUS + i * MAX_REMEMBERED])
PLACE_OF(latest_of, own[LATEST + i * MAX_REMEMBERED])
PLACE_OF(invariants_of, own[INVARIANTS + i * MAX_INVARIANTS])

/* Whether the states of a joint begin in the steady state of the first inputs. */
static bool begins_steady(const Component *component, const Joint *joint) {
    return joint->states > 0 && START_MODE >= 0 && component->v[START_MODE] == STEADY;
}

/* Before the first step, set states and previous values to their start values. */
static void start(Component *component, int i) {
    const Place at = place_of(component, i);
    const Joint *joint = at.joint;
    double y[MAX_OUTPUTS];
    double *x = states_of(component, i);
    memcpy(x, &component->v[joint->first_start], (size_t)joint->states * sizeof *x);
    if (begins_steady(component, joint)) {
        joint->begin(at.k, at.u, x);
    }
    if (joint->start) {
        joint->start(at.k, at.u, at.s, x, previous_of(component, i), y, latest_of(component, i));
    } else {
        joint->read(at.k, at.u, at.s, x, NULL, 0.0, x + joint->states, y, NULL);
    }
    put_outputs(component->v, i, y);
}

static bool component_output(Component *component, void *workspace, Message *why) {
    (void)workspace;
    (void)why; /* the glue checks for infinite outputs */
    const bool started = component->own[STARTED] > 0.0;
    if (started && (HOLDS || component->own[TICKS] < 0.0)) {
        return true;
    }
    clear_torques(component->v);
    for (int i = 0; i < JOINTS; i++) {
        if (!started) {
            start(component, i);
            continue;
        }
        const Place at = place_of(component, i);
        double y[MAX_OUTPUTS];
        double r[MAX_REMEMBERED + 1];
        double *x = states_of(component, i);
        at.joint->read(at.k, at.u, at.s, x, previous_of(component, i), component->own[LAST_STEP],
                       x + at.joint->states, y, r);
        put_outputs(component->v, i, y);
    }
    put_ends(component->v, component->v);
    return true;
}

static bool component_initialise(Component *component, void *workspace, Message *why) {
    for (int i = 0; i < JOINTS; i++) {
        const Place at = place_of(component, i);
        const char *needed;
        const int bad = at.joint->refused ? at.joint->refused(at.u, &needed) : -1;
        if (bad >= 0) {
            const int place = at.joint->input[bad];
            return deny(why, "%s is %g%s", variables[place].name, component->v[place], needed);
        }
    }
    component_output(component, workspace, why); /* of joints that have not started yet */
    component->own[STARTED] = 1.0;
    component->own[BEGIN] = component->time;
    return true;
}

/* Whether a step [s] of Euler's method is stable for the states of all joints. */
static bool can_relax(const Component *component, double step, Message *why) {
    for (int i = 0; i < JOINTS; i++) {
        const Place at = place_of(component, i);
        double rate[MAX_STATES];
        at.joint->rates(at.k, at.u, &component->v[at.joint->first_state], rate);
        if (!is_stable(at.joint, rate, step, at.joint->input[0], at.u[0], why)) {
            return false;
        }
    }
    return true;
}

/* Compute terms that depend only on parameters and the length of a step [s].
 *
 * Non-finite invariants are not stored, because they could not be saved. */
SELDOM static void update_invariants(Component *component, double step, double euler) {
    double *own = component->own;
    bool finite = true;
    for (int i = 0; i < JOINTS; i++) {
        if (joints[i].invariants) {
            joints[i].invariants(parameters_of(component->v, &joints[i]), step, euler,
                                 invariants_of(component, i));
        }
    }
    for (int i = INVARIANTS; i < HELD; i++) {
        finite = finite && isfinite(own[i]);
    }
    own[INVARIANT_STEP] = step;
    component->changed = finite ? 0.0 : 1.0;
}

/* Outputs of a joint after a step, when component_output does not compute its derivatives later. */
QUICK void put_sample(Component *component, int i, double step, double *y) {
    double r[MAX_REMEMBERED + 1];
    double *x = states_of(component, i);
    if (HOLDS != 0 || SAMPLED != 0) {
        joints[i].read(parameters_of(component->v, &joints[i]), inputs_before(component, i),
                       signs_of(component, i), x, previous_of(component, i), step,
                       x + joints[i].states, y, r);
    }
    put_outputs(component->v, i, y);
}

#ifdef TOGETHER
#define ADVANCE(i, step_of)                                                                        \
    for (int j = 0; j < joints[i].states; j++) {                                                   \
        x[j] = moved[j][i];                                                                        \
    }                                                                                              \
    for (int j = 0; j < joints[i].outputs; j++) {                                                  \
        y[j] = outputs[j][i];                                                                      \
    }
#else
#define ADVANCE(i, step_of)                                                                        \
    step_of(parameters_of(component->v, &joints[i]), u, signs_of(component, i),                    \
            previous_of(component, i), invariants_of(component, i), step, euler, x, y,             \
            latest_of(component, i));
#endif

/* Step of joint i, with its functions known to the compiler. */
#define STEP(i, step_of, switches_of, gather)                                                      \
    {                                                                                              \
        double *u = inputs_before(component, i);                                                   \
        double *x = states_of(component, i);                                                       \
        double y[MAX_OUTPUTS];                                                                     \
        gather;                                                                                    \
        memcpy(previous_of(component, i), latest_of(component, i),                                 \
               (size_t)joints[i].remembered * sizeof(double));                                     \
        memcpy(&own[BEFORE + i * MAX_STATES], x, (size_t)joints[i].states * sizeof(double));       \
        ADVANCE(i, step_of)                                                                        \
        put_sample(component, i, step, y);                                                         \
    }

/* Advance all joints by a step [s] and store their outputs. */
static void sample(Component *component, double step) {
    double *own = component->own;
    const double *v = component->v;
    const double euler = DISCRETISATION >= 0 && v[DISCRETISATION] == EULER;
    if (own[INVARIANT_STEP] != step || component->changed != 0.0) {
        update_invariants(component, step, euler);
    }
    own[LAST_STEP] = step;
    clear_torques(component->v);
#ifdef TOGETHER
    double moved[MAX_STATES][LANES];
    double outputs[MAX_OUTPUTS][LANES];
    TOGETHER(v, &own[INVARIANTS], step, euler, moved, outputs);
    KEEP_LANES(moved);
    KEEP_LANES(outputs);
#endif
    EACH_JOINT(STEP)
    put_ends(component->v, component->v);
    if (component->changed > 0.0) {
        memset(&own[INVARIANTS], 0, (HELD - INVARIANTS) * sizeof(double));
    }
}

/* Take the samples within a step [s]. */
static bool take_samples(Component *component, double step, Message *why) {
    double *own = component->own;
    const double time = component->v[SAMPLE_TIME_PLACE];
    const double at = (component->time + step - own[BEGIN]) / time;
    const double whole = floor(at + ROUNDING);
    const double done = floor(fabs(own[TICKS]));
    if (!(whole - done <= MAX_SAMPLES)) {
        return deny(why, "A step of %g s would be %g samples of %g s; at most %g are taken.", step,
                    whole - done, time, MAX_SAMPLES);
    }
    for (double n = done; n < whole; n++) {
        sample(component, time);
    }
    /* Half a sample more marks a time between two samples. */
    own[TICKS] = at - whole <= ROUNDING ? whole : -(whole + 0.5);
    return true;
}

static bool component_step(Component *component, void *workspace, double step, Message *why) {
    (void)workspace;
    if (SAMPLED) {
        return take_samples(component, step, why);
    }
    if (DISCRETISATION >= 0 && component->v[DISCRETISATION] == EULER &&
        !can_relax(component, step, why)) {
        return false;
    }
    sample(component, step);
    return true;
}

/* Direction in which no parameter changes. */
static const double no_change[MAX_PARAMETERS] = {0.0};

/* Derivative of a joint's first output with respect to its first input; states follow as in the
 * last step. */
static double slope_of_step(const Component *component, int i) {
    const Place at = place_of(component, i);
    const Joint *joint = at.joint;
    const double step = component->own[LAST_STEP];
    const double *x = &component->v[joint->first_state];
    const double euler = DISCRETISATION >= 0 && component->v[DISCRETISATION] == EULER;
    const double du[MAX_INPUTS] = {1.0};
    double tx[MAX_STATES] = {0.0};
    double tdx[MAX_STATES];
    double ty[MAX_OUTPUTS];
    double s[MAX_SWITCHES];
    if (step > 0.0) {
        /* With input slopes, a sign may have changed since. */
        const double *used = &component->own[USED + i * MAX_INPUTS];
        joint->switches(at.k, used, s);
        for (int j = 0; j < joint->switches_of_joint; j++) {
            s[j] = sgn(s[j]);
        }
        joint->follow(at.k, used, s, &component->own[BEFORE + i * MAX_STATES], step, euler, du, tx);
    }
    joint->tangent(at.k, at.u, at.s, x, NULL, step, no_change, du, tx, tdx, ty);
    return ty[0];
}

SELDOM static void component_demand(Component *component) {
    for (int i = 0; COUPLED && i < JOINTS; i++) {
        component->v[joints[i].slope] = 0.0;
    }
    for (int i = 0; i < JOINTS; i++) {
        if (joints[i].slope < 0) {
            continue;
        }
        const double slope = slope_of_step(component, i);
        for (int m = 0; COUPLED && m < JOINTS; m++) {
            component->v[joints[m].slope] += forward[i][m] * forward[i][m] * slope;
        }
        if (!COUPLED) {
            component->v[joints[i].slope] = slope;
        }
    }
}

/* Hold the signs of joint i; the description of a change is for logs only. */
QUICK bool hold(Component *component, int i, double rest, const double *z, Message *what) {
    const Joint *joint = &joints[i];
    double *held = signs_of(component, i);
    bool changed = false;
    for (int j = 0; j < joint->switches_of_joint; j++) {
        const double sign = fabs(z[j]) < rest ? 0.0 : sgn(z[j]);
        if (what && sign != held[j]) {
            deny(what, "The sign of %s of joint %d becomes %g.", joint->names[j], i + 1, sign);
        }
        changed = changed || sign != held[j];
        held[j] = sign;
    }
    return changed;
}

#define HOLD(i, step_of, switches_of, gather)                                                      \
    if (joints[i].switches_of_joint > 0) {                                                         \
        double u[MAX_INPUTS];                                                                      \
        double z[MAX_SWITCHES];                                                                    \
        gather;                                                                                    \
        switches_of(parameters_of(component->v, &joints[i]), u, z);                                \
        changed |= hold(component, i, rest, z, what);                                              \
    }

static bool component_event(Component *component, double rest, Message *what) {
    const double *v = component->v;
    bool changed = false;
    EACH_JOINT(HOLD)
    return changed;
}

/* Store the event indicators; return whether all held signs agree with the inputs. */
static bool component_indicators(const Component *component, double rest, double *indicator) {
    bool agree = true;
    for (int i = 0; i < JOINTS; i++) {
        double z[MAX_SWITCHES];
        const Place at = place_of(component, i);
        at.joint->switches(at.k, at.u, z);
        for (int j = 0; j < at.joint->switches_of_joint; j++) {
            const double value = at.s[j] != 0.0 ? at.s[j] * z[j] : rest - fabs(z[j]);
            agree = agree && value > 0.0;
            if (j < at.joint->held) {
                *indicator++ = value;
            }
        }
    }
    return agree;
}

SELDOM static void component_tangent(const Component *component, const double *seed,
                                     double *tangent) {
    clear_torques(tangent);
    for (int i = 0; i < JOINTS; i++) {
        const Place at = place_of(component, i);
        const Joint *joint = at.joint;
        const int state = joint->first_state;
        const double *dk = joint->constants ? no_change : &seed[joint->first_parameter];
        const bool started = component->own[STARTED] > 0.0;
        double du[MAX_INPUTS];
        double ty[MAX_OUTPUTS];
        double tx[MAX_STATES];
        for (int j = 0; j < joint->inputs; j++) {
            du[j] = input_of(seed, i, j);
        }
        memcpy(tx, &seed[started ? state : joint->first_start],
               (size_t)joint->states * sizeof tx[0]);
        if (!started && begins_steady(component, joint)) {
            joint->begin_tangent(at.k, at.u, &component->v[joint->first_start], dk, du, tx);
        }
        memcpy(&tangent[state], tx, (size_t)joint->states * sizeof tx[0]);
        joint->tangent(at.k, at.u, at.s, &component->v[state],
                       &component->own[PREVIOUS + i * MAX_REMEMBERED], component->own[LAST_STEP],
                       dk, du, tx, &tangent[state + joint->states], ty);
        put_outputs(tangent, i, ty);
    }
    put_ends(component->v, tangent);
}
