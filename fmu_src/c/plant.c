/* Component: a robot under friction; torque in, motion out.
 *
 *     M(q) q'' + b(q, q') + G = tau,  G_i = friction_i + stop_i
 *
 * with the generated M and b. An inner step of length h solves for speeds u that move positions
 * and enter friction and stops,
 *
 *     R(u) = M (u - v) / w + h [G(u) - r] = 0,  r = tau - b at the middle of the step
 *
 * and ends at v + (u - v) / w. A weight w_i is 1/2 (midpoint) where friction is smooth and 1
 * (implicit Euler) where it is stiff or holds. If motors turn several joints, all of this is in the
 * coordinates of the friction (coupling.h), except for the stops. With a SERVO, G includes minus
 * its torque kv (dq_cmd - u) + ki (integral of dq_cmd - q - h u), where a controller of the
 * POSITION adds kp (q_cmd - q - h u) to dq_cmd. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#define WITH_TANGENT
#include "component_alone.h"
#include "component_plain.h"
#include "coupling.h"
#include "equations.h"
#include "plant_flow.h"
#include "plant_servo.h"

/* Maximum number of inner steps in a step. */
#define MOST_PARTS 1e7

/* Longest motion of a joint in an inner step [rad or m], since M and b are those of its middle. */
#define LONGEST_MOTION 0.01

static void mixed(const double matrix[JOINTS][JOINTS], bool transposed, const double *from,
                  double *to) {
    memcpy(to, from, JOINTS * sizeof *to);
    for (int i = 0; COUPLED && i < JOINTS; i++) {
        to[i] = 0.0;
        for (int m = 0; m < JOINTS; m++) {
            to[i] += (transposed ? matrix[m][i] : matrix[i][m]) * from[m];
        }
    }
}

/* Whether coordinate i is joint i, so that the joint's stops apply to it. */
static bool alone(int i) {
    for (int m = 0; COUPLED && m < JOINTS; m++) {
        if ((m == i) != (forward[i][m] != 0.0) || (m != i && forward[m][i] != 0.0)) {
            return false;
        }
    }
    return true;
}

static void open_axis(const Component *component, int i, Axis *axis) {
    const Joint *joint = &joints[i];
    const double *v = component->v;
    const bool stops = alone(i);
    Step *step = &axis->step;
    step->joint = joint;
    step->k = joint->constants ? joint->constants : &v[joint->first_parameter];
    step->gear = 1.0;
    step->stiffness = stops ? v[STIFFNESS + i] : 0.0;
    step->damping = stops ? v[DAMPING + i] : 0.0;
    step->q_link = 0.5 * (v[Q_MIN + i] + v[Q_MAX + i]);
    step->clearance = 0.5 * (v[Q_MAX + i] - v[Q_MIN + i]);
    step->euler = v[DISCRETISATION] == EULER;
    step->servo = step->gain = step->most = 0.0;
    for (int j = LOAD + 1; j < joint->inputs; j++) {
        step->u[j] = v[joint->input[j]];
    }
    for (int j = 0; j < joint->states; j++) {
        axis->from.x[j] = v[joint->first_state + j];
    }
}

static void open_solver(const Component *component, double h, Solver *solver) {
    const double *own = component->own;
    double q[JOINTS], dq[JOINTS], ddq[JOINTS];
    mixed(forward, false, &component->v[Q], q);
    mixed(forward, false, &component->v[DQ], dq);
    mixed(forward, false, &component->v[DDQ], ddq);
    solver->h = h;
    for (int i = 0; i < JOINTS; i++) {
        Axis *axis = &solver->axis[i];
        open_axis(component, i, axis);
        axis->step.h = h;
        axis->from.q = q[i];
        axis->from.dq = dq[i];
        axis->from.ddq = ddq[i];
        axis->slope = own[SLOPE + i];
        axis->inertial = own[INERTIAL + i];
        axis->command = SERVO ? own[INTEGRAL + i] : 0.0;
    }
    copy_to_lanes(solver);
}

static void store(Component *component, const Solver *solver) {
    double q[JOINTS], dq[JOINTS], ddq[JOINTS], load[JOINTS], friction[JOINTS], stop[JOINTS];
    double *v = component->v, *own = component->own, motor[JOINTS], unused = 0.0;
    for (int i = 0; i < JOINTS; i++) {
        const Axis *axis = &solver->axis[i];
        const Motion *at = &axis->from;
        q[i] = at->q, dq[i] = at->dq, ddq[i] = at->ddq;
        load[i] = solver->bias[i] + axis->inertial;
        friction[i] = at->tau_f, stop[i] = at->tau_link;
        memcpy(&v[axis->step.joint->first_state], at->x,
               (size_t)axis->step.joint->states * sizeof *v);
        own[SLOPE + i] = axis->slope;
        own[INERTIAL + i] = axis->inertial;
        if (SERVO) {
            const double servo = servo_torque(&axis->step, axis->trial.v, &unused);
            own[INTEGRAL + i] = axis->command;
            stop[i] += servo;
            motor[i] = axis->support + servo;
        }
    }
    if (SERVO) {
        mixed(forward, true, motor, &v[TAU_MOTOR]);
    }
    store_tool(v, q);
    if (component->continuous == 0.0) { /* else they belong to the solver */
        mixed(backward, true, q, &v[Q]);
        mixed(backward, true, dq, &v[DQ]);
    }
    mixed(backward, true, ddq, &v[DDQ]);
    mixed(forward, true, load, &v[TAU_LOAD]);
    mixed(forward, true, friction, &v[TAU_FRICTION]);
    mixed(forward, true, stop, &v[TAU_STOP]);
}

/* Make an inner step of length h that ends at `time`. Two of half the length replace one without a
 * solution: the shorter the step, the more inertia dominates. */
static bool inner_step(const Component *component, Solver *solver, double time, double h,
                       int halvings, Message *why) {
    double q[JOINTS], dq[JOINTS];
    solver->h = h;
    for (int i = 0; i < JOINTS; i++) {
        const Motion *from = &solver->axis[i].from;
        q[i] = from->q + 0.5 * h * from->dq;
        dq[i] = from->dq + 0.5 * h * from->ddq;
    }
    if (SERVO) {
        weigh(component, solver, q);
    }
    evaluate(component, solver, q, dq);
    for (int i = 0; i < JOINTS; i++) {
        Axis *axis = &solver->axis[i];
        axis->step.h = h;
        axis->applied = mixed_at(component, true, TAU, i, time - 0.5 * h) - solver->bias[i];
        if (SERVO) {
            drive(component, i, time - h, axis);
        }
        axis->step.u[LOAD] = solver->bias[i] + axis->inertial;
    }
    if (advance(solver, why)) {
        for (int i = 0; SERVO && i < JOINTS; i++) {
            Axis *axis = &solver->axis[i]; /* at the end of the step */
            axis->command += h * commanded(component, i, time - h, axis);
        }
        return true;
    }
    return halvings > 0 &&
           inner_step(component, solver, time - 0.5 * h, 0.5 * h, halvings - 1, why) &&
           inner_step(component, solver, time, 0.5 * h, halvings - 1, why);
}

/* Check a parameter; NaN fails. */
static bool sound(int variable, double value, bool right, const char *needed, Message *why) {
    if (!right) {
        snprintf(why->text, sizeof why->text, "%s is %g; it must %s.", variables[variable].name,
                 value, needed);
    }
    return right;
}

/* Before the first step, outputs follow start values and inputs; then they are those of the last
 * step, or, in model exchange, those of the motion. */
static bool component_output(Component *component, void *workspace, Message *why) {
    Solver solver;
    (void)workspace;
    if (component->own[STARTED] != 0.0 && component->continuous == 0.0) {
        return true;
    }
    if (!flow(component, &solver, why)) {
        return false;
    }
    store(component, &solver);
    return true;
}

static bool component_initialise(Component *component, void *workspace, Message *why) {
    const double *v = component->v;
    if (!sound(SUBSTEP, v[SUBSTEP], v[SUBSTEP] > 0.0, "be positive", why)) {
        return false;
    }
    for (int i = 0; i < JOINTS; i++) {
        const int k = STIFFNESS + i, d = DAMPING + i, most = Q_MAX + i;
        if (!sound(k, v[k], v[k] >= 0.0, "not be negative", why) ||
            !sound(d, v[d], v[d] >= 0.0, "not be negative", why) ||
            !sound(most, v[most], v[most] >= v[Q_MIN + i], "not be below the lower limit", why)) {
            return false;
        }
        const int own[] = {KV + i, KI + i, TORQUE_LIMIT + i, LATENCY, KP + i};
        for (int n = 0; SERVO && n < 4 + POSITION; n++) {
            if (!sound(own[n], v[own[n]], v[own[n]] >= 0.0, "not be negative", why)) {
                return false;
            }
        }
    }
    if (!component_output(component, workspace, why)) {
        return false;
    }
    component->own[STARTED] = 1.0;
    return true;
}

static bool component_step(Component *component, void *workspace, double step, Message *why) {
    double fastest = 0.0;
    (void)workspace;
    for (int i = 0; i < JOINTS; i++) {
        fastest = fmax(fastest, fabs(component->v[DQ + i]));
    }
    const double longest = fmin(component->v[SUBSTEP], LONGEST_MOTION / fastest);
    const double parts = fmax(1.0, ceil(step / longest * (1.0 - ROUNDING)));
    if (!(parts <= MOST_PARTS)) {
        snprintf(why->text, sizeof why->text,
                 "A step of %g s would be %g inner ones; at most %g are made. Take a shorter step "
                 "or a longer substep than %g s, or look at the speeds.",
                 step, parts, MOST_PARTS, component->v[SUBSTEP]);
        return false;
    }
    if (SERVO && !forget(component, 0.0)) {
        snprintf(why->text, sizeof why->text,
                 "The latency of %g s is longer than %d steps; take longer steps.",
                 component->v[LATENCY], MOST_COMMANDS);
        return false;
    }
    if (component->changed != 0.0) {
        regroup(component);
    }
    Solver solver;
    open_solver(component, step / parts, &solver);
    for (double n = 1.0; n <= parts; n++) {
        if (!inner_step(component, &solver, step * (n / parts), step / parts, HALVINGS, why)) {
            return false;
        }
    }
    store(component, &solver);
    if (SERVO) {
        remember(component, step);
    }
    component->event = 0.0;
    component->done = step;
    return true;
}
