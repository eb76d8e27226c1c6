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
 * POSITION adds kp (q_cmd - q - h u) to dq_cmd. A DIRECT servo turns position errors into torques
 * (plant_servo.h). */
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
#define MAX_PARTS 1e7

/* Longest motion of a joint in an inner step [rad or m], since M and b are those of its middle. */
#define LONGEST_MOTION 0.01

static void mixed(const double matrix[JOINTS][JOINTS], bool transposed, const double *from,
                  double *to) {
    memcpy(to, from, JOINTS * sizeof *to);
    for (int i = 0; COUPLED && i < JOINTS; i++) {
        to[i] = 0.0;
        for (int m = 0; m < JOINTS; m++) {
            const double factor = transposed ? matrix[m][i] : matrix[i][m];
            to[i] += factor * from[m];
        }
    }
}

static void open_solver(const Component *component, double h, Solver *solver) {
    const double *v = component->v;
    const double *own = component->own;
    for (Lanes *row = solver->mass; row < &solver->weight; row++) {
        memset(&(*row)[JOINTS], 0, (LANES - JOINTS) * sizeof **row);
    }
    for (int l = JOINTS; l < LANES; l++) {
        solver->diagonal[l] = 1.0; /* a divisor */
    }
    solver->component = component;
    solver->h = h;
    solver->holding = false;
    mixed(forward, false, &v[Q], solver->q);
    mixed(forward, false, &v[DQ], solver->v);
    mixed(forward, false, &v[DDQ], solver->a);
    memcpy(solver->steep, &own[SLOPE], JOINTS * sizeof *v);
    memcpy(solver->inertial, &own[INERTIAL], JOINTS * sizeof *v);
    memcpy(solver->last, &own[LAST], JOINTS * sizeof *v);
    for (int i = 0; i < JOINTS; i++) {
        const Joint *joint = &joints[i];
        solver->middle[i] = 0.5 * (v[Q_MIN + i] + v[Q_MAX + i]);
        solver->clearance[i] = 0.5 * (v[Q_MAX + i] - v[Q_MIN + i]);
        solver->servo[i] = 0.0;
        solver->gain[i] = 0.0;
        solver->most[i] = 0.0;
        solver->command[i] = SERVO ? own[INTEGRAL + i] : 0.0;
        solver->followed[i] = DIRECT ? own[FOLLOWED + i] : 0.0;
        for (int j = LOAD + 1; j < joint->inputs; j++) {
            solver->input[j][i] = v[joint->input[j]];
        }
        for (int j = 0; j < joint->states; j++) {
            solver->x[j][i] = v[joint->first_state + j];
        }
    }
}

/* Store the solver's results in outputs and own memory. */
static void store(Component *component, const Solver *solver) {
    double *v = component->v;
    double *own = component->own;
    double motor[JOINTS];
    double load[JOINTS];
    double stop[JOINTS];
    memcpy(&own[SLOPE], solver->steep, JOINTS * sizeof *v);
    memcpy(&own[INERTIAL], solver->inertial, JOINTS * sizeof *v);
    memcpy(&own[LAST], solver->last, JOINTS * sizeof *v);
    for (int i = 0; i < JOINTS; i++) {
        load[i] = solver->bias[i] + solver->inertial[i];
        stop[i] = solver->stop[i];
        for (int j = 0; j < joints[i].states; j++) {
            v[joints[i].first_state + j] = solver->x[j][i];
        }
        if (SERVO) {
            const double servo = servo_at(solver, i, solver->u[i]);
            own[INTEGRAL + i] = solver->command[i];
            if (DIRECT) {
                own[FOLLOWED + i] = solver->followed[i];
            }
            stop[i] += servo;
            motor[i] = solver->support[i] + servo;
        }
    }
    if (SERVO) {
        mixed(forward, true, motor, &v[TAU_MOTOR]);
    }
    store_tool(v, solver->q);
    if (component->continuous == 0.0) { /* else they belong to the solver */
        mixed(backward, true, solver->q, &v[Q]);
        mixed(backward, true, solver->v, &v[DQ]);
    }
    mixed(backward, true, solver->a, &v[DDQ]);
    mixed(forward, true, load, &v[TAU_LOAD]);
    mixed(forward, true, solver->friction[0], &v[TAU_FRICTION]);
    mixed(forward, true, stop, &v[TAU_STOP]);
}

/* Make an inner step of length h [s] that ends at `time` [s] after the start of the step. */
INLINED bool try_step_inlined(Solver *solver, double time, double h, Message *why) {
    double q[JOINTS]; /* at the middle of the inner step */
    double dq[JOINTS];
    solver->h = h;
    for (int i = 0; i < JOINTS; i++) {
        q[i] = solver->q[i] + 0.5 * h * solver->v[i];
        dq[i] = solver->v[i] + 0.5 * h * solver->a[i];
    }
    if (SERVO) {
        weigh(solver, q);
    }
    evaluate(solver, q, dq);
    for (int i = 0; i < JOINTS; i++) {
        const double torque = mixed_at(solver->component, true, TAU, i, time - 0.5 * h);
        solver->applied[i] = torque - solver->bias[i];
        solver->input[LOAD][i] = solver->bias[i] + solver->inertial[i];
    }
    for (int i = 0; SERVO && i < JOINTS; i++) {
        drive(solver, i, time - h);
    }
    if (!advance(solver, why)) {
        return false;
    }
    for (int i = 0; SERVO && i < JOINTS; i++) {
        integrate(solver, i, time - h);
    }
    return true;
}
IN_WIDTHS(try_step, (Solver * solver, double time, double h, Message *why), (solver, time, h, why))

/* Do as `try_step`. Two inner steps of half the length replace one without a solution: the shorter
 * the step, the more inertia dominates. */
static bool inner_step(Solver *solver, double time, double h, int halvings, Message *why) {
    if (try_step(solver, time, h, why)) {
        return true;
    }
    if (halvings == 0) {
        return false;
    }
    return inner_step(solver, time - 0.5 * h, 0.5 * h, halvings - 1, why) &&
           inner_step(solver, time, 0.5 * h, halvings - 1, why);
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
    if (!sound(v, SUBSTEP, v[SUBSTEP] > 0.0, "be positive", why)) {
        return false;
    }
    for (int i = 0; i < JOINTS; i++) {
        const int stiffness = STIFFNESS + i;
        const int damping = DAMPING + i;
        const int upper = Q_MAX + i;
        if (!sound(v, stiffness, v[stiffness] >= 0.0, "not be negative", why) ||
            !sound(v, damping, v[damping] >= 0.0, "not be negative", why) ||
            !sound(v, upper, v[upper] >= v[Q_MIN + i], "not be below the lower limit", why)) {
            return false;
        }
        /* First those of every servo, then that of a position, then those of a DIRECT one. */
        const int gains[] = {
            KV + i, KI + i, TORQUE_LIMIT + i, LATENCY, KP + i, COMMAND_FILTER + i, SPEED_LIMIT + i};
        for (int n = 0; SERVO && n < 4 + POSITION + 2 * DIRECT; n++) {
            if (!sound(v, gains[n], v[gains[n]] >= 0.0, "not be negative", why)) {
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
        fastest = larger(fabs(component->v[DQ + i]), fastest);
    }
    const double longest = fmin(component->v[SUBSTEP], LONGEST_MOTION / fmax(fastest, TINY));
    const double parts = fmax(1.0, ceil(step / longest * (1.0 - ROUNDING)));
    if (!(parts <= MAX_PARTS)) {
        return deny(
            why,
            "A step of %g s would be %g inner ones; at most %g are made. Take a shorter step "
            "or a longer substep than %g s, or look at the speeds.",
            step, parts, MAX_PARTS, component->v[SUBSTEP]);
    }
    if (SERVO && !forget(component, 0.0)) {
        return deny(why, "The latency of %g s is longer than %d steps; take longer steps.",
                    component->v[LATENCY], MAX_COMMANDS);
    }
    adopt(component);
    Solver solver;
    open_solver(component, step / parts, &solver);
    for (double n = 1.0; n <= parts; n++) {
        if (!inner_step(&solver, step * (n / parts), step / parts, HALVINGS, why)) {
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
