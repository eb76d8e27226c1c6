/* Component: motors of joints under friction laws; torque in, speed and angle out.
 *
 *     inertia dq' = tau_motor - tau_f / ratio - tau_link / ratio,  q' = dq
 *     tau_link    = stiffness (q / ratio - q_link) + damping (dq / ratio - dq_link)
 *
 * with tau_f of the law at dq / ratio. If motors turn with several joints, links and loads belong
 * to the joints; coupling.h refers them to the motor, and tau_link to the joints.
 *
 * An inner step of length h solves for the speed v at its end,
 *
 *     R(v) = inertia (v - dq) / h - tau_motor + (tau_f(v, x(v)) + tau_link(v)) / ratio = 0
 *
 * with the states x relaxed at that speed (implicit Euler). Of several roots, the solver takes the
 * first one from dq towards falling R.
 *
 * A start, stop or reversal of a motor within an inner step causes an event at its end. The
 * generated equations.h defines the functions of the laws and the indices of the variables. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "component_alone.h"
#include "component_plain.h"
#include "drive_step.h"
#include "equations.h"
#include "root.h"

enum { STARTED = 0 /* whether initialisation has ended */ };

/* Maximum number of inner steps in a step. */
#define MAX_PARTS 1e7

/* Tolerance for a number of steps to count as whole. */
#define ROUNDING 1e-9

/* Whether Euler steps are stable for the rates of the states at a speed. */
static bool can_relax(const Step *step, int i, const Motion *from, const Trial *at, Message *why) {
    double u[MAX_INPUTS];
    double rate[MAX_STATES];
    see(step, from->q + step->h * at->v, at->v, u);
    step->joint->rates(step->k, u, from->x, rate);
    return is_stable(step->joint, rate, step->h, DQ + i, at->v, why);
}

/* Advance the motion of motor i by an inner step. */
static bool advance(const Step *step, int i, Motion *motion, Message *why) {
    const Joint *joint = step->joint;
    Trial trial;
    if (!solve(step, motion, &trial, variables[DQ + i].name, why) ||
        (step->euler > 0.0 && !can_relax(step, i, motion, &trial, why))) {
        return false;
    }
    memcpy(motion->x, trial.x, (size_t)joint->states * sizeof motion->x[0]);
    motion->ddq = (trial.v - motion->dq) / step->h;
    motion->q += step->h * trial.v;
    motion->dq = trial.v;
    motion->tau_f = trial.tau_f;
    motion->tau_link = trial.tau_link;
    return true;
}

/* Motion of motor i, with the states of its law, from the variables. */
static Motion motion_of(const Component *component, int i) {
    const Joint *joint = &joints[i];
    const double *v = component->v;
    Motion motion;
    memset(&motion, 0, sizeof motion);
    motion.q = v[Q + i];
    motion.dq = v[DQ + i];
    memcpy(motion.x, &v[joint->first_state], (size_t)joint->states * sizeof motion.x[0]);
    return motion;
}

/* Called before the joints are stored, because the drive of one may turn several links. */
static void clear_links(Component *component) {
    memset(&component->v[TAU_LINK], 0, JOINTS * sizeof component->v[0]);
}

/* Store the motion of motor i and the states of its law in the variables. */
static void put(Component *component, int i, const Step *step, const Motion *motion) {
    const Joint *joint = step->joint;
    double *v = component->v;
    double *x = &v[joint->first_state];
    double u[MAX_INPUTS];
    v[Q + i] = motion->q;
    v[DQ + i] = motion->dq;
    v[DDQ + i] = motion->ddq;
    v[TAU_F + i] = motion->tau_f;
    add_torque(v, TAU_LINK, i, motion->tau_link);
    memcpy(x, motion->x, (size_t)joint->states * sizeof *x);
    see(step, motion->q, motion->dq, u);
    joint->solved_derivatives(step->k, u, x, x + joint->states);
}

/* Set the states of a law to their initial values. */
static void begin(const Component *component, const Step *step, Motion *motion) {
    const Joint *joint = step->joint;
    double u[MAX_INPUTS];
    memcpy(motion->x, &component->v[joint->first_start],
           (size_t)joint->states * sizeof motion->x[0]);
    if (joint->states > 0 && component->v[START_MODE] == STEADY) {
        see(step, motion->q, motion->dq, u);
        joint->begin(step->k, u, motion->x);
    }
}

static bool component_initialise(Component *component, void *workspace, Message *why) {
    const double *v = component->v;
    if (!sound(v, SUBSTEP, v[SUBSTEP] > 0.0, "be positive", why)) {
        return false;
    }
    for (int i = 0; i < JOINTS; i++) {
        const int inertia = INERTIA + i;
        const int stiffness = STIFFNESS + i;
        const int damping = DAMPING + i;
        const int ratio = RATIO + i;
        if (!sound(v, inertia, v[inertia] > 0.0, "be positive", why) ||
            !sound(v, stiffness, v[stiffness] >= 0.0, "not be negative", why) ||
            !sound(v, damping, v[damping] >= 0.0, "not be negative", why) ||
            !sound(v, ratio, v[ratio] != 0.0, "not be zero", why)) {
            return false;
        }
    }
    component_output(component, workspace, why);
    component->own[STARTED] = 1.0;
    return true;
}

/* Before the first step, outputs follow start values and inputs; then they are those of the last
 * step. */
static bool component_output(Component *component, void *workspace, Message *why) {
    (void)workspace;
    (void)why;
    if (component->own[STARTED] == 0.0) {
        clear_links(component);
    }
    for (int i = 0; i < JOINTS && component->own[STARTED] == 0.0; i++) {
        const Step step = step_of(component, i, 0.0, 0.0);
        Trial trial;
        component->v[Q + i] = component->v[Q_START + i];
        component->v[DQ + i] = component->v[DQ_START + i];
        Motion motion = motion_of(component, i);
        begin(component, &step, &motion);
        attempt(&step, &motion, motion.dq, &trial);
        motion.tau_f = trial.tau_f;
        motion.tau_link = trial.tau_link;
        put(component, i, &step, &motion);
    }
    return true;
}

static bool component_step(Component *component, void *workspace, double step, Message *why) {
    const double parts = fmax(1.0, ceil(step / component->v[SUBSTEP] * (1.0 - ROUNDING)));
    double n = 0.0;
    bool event = false;
    Motion motion[JOINTS];
    (void)workspace;
    if (!(parts <= MAX_PARTS)) {
        return deny(
            why,
            "A step of %g s would be %g inner ones; at most %g are made. Take a shorter step or "
            "a longer substep than %g s.",
            step, parts, MAX_PARTS, component->v[SUBSTEP]);
    }
    for (int i = 0; i < JOINTS; i++) {
        motion[i] = motion_of(component, i);
    }
    do {
        event = false;
        n++;
        for (int i = 0; i < JOINTS; i++) {
            const Step part = step_of(component, i, step / parts, step * (n / parts));
            const double before = sgn(motion[i].dq);
            if (!advance(&part, i, &motion[i], why)) {
                return false;
            }
            event |= sgn(motion[i].dq) != before;
        }
    } while (n < parts && !(event && component->may_end_early != 0.0));
    component->event = event;
    component->done = n < parts ? step * (n / parts) : step;
    clear_links(component);
    for (int i = 0; i < JOINTS; i++) {
        const Step last = step_of(component, i, step / parts, component->done);
        put(component, i, &last, &motion[i]);
    }
    return true;
}
