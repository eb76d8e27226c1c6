/* Continuous form of a plant: acceleration at a motion, without events, and derivatives. */
#ifndef PLANT_FLOW_H
#define PLANT_FLOW_H

#include "plant_servo.h"
#include "regroup.h"
#include "tool.h"

#include "change.h"

/* Sums over `matrix` or its transpose, or a copy without a coupling. */
static void mixed(const double matrix[JOINTS][JOINTS], bool transposed, const double *from,
                  double *to);

/* Gather motion, laws and limits of the axes for a step of length h. */
static void open_solver(const Component *component, double h, Solver *solver);

/* Residual of a load that counts as zero, as a share of the torques, and largest number of
 * iterations. */
#define LOAD_TOLERANCE 1e-14
enum { MAX_LOADS = 50 };

static const double no_change[MAX_PARAMETERS + MAX_INPUTS + MAX_STATES] = {0.0};

/* Set friction, stop and the derivatives dx of an axis under a load [N.m], or, in model exchange,
 * under what friction and stop leave of the torque. */
static bool set_friction(Solver *solver, int i, double load, double *dx, Message *why) {
    const double torque = mixed_at(solver->component, true, TAU, i, 0.0);
    const Joint *joint = &joints[i];
    double u[MAX_INPUTS];
    double y[MAX_OUTPUTS];
    double tdx[MAX_STATES];
    double ty[MAX_OUTPUTS];
    double along_load[MAX_INPUTS] = {0.0};
    double unused = 0.0;
    Step step;
    Motion at;
    open_axis(solver, i, &step, &at);
    see(&step, at.q, at.dq, u);
    u[LOAD] = load;
    along_load[LOAD] = 1.0;
    const double stop = stop_torque(&step, u, u, &unused);
    solver->stop[i] = stop;
    /* Friction depends on the load, and the load on friction: Newton's method. */
    for (int n = 0; n < MAX_LOADS; n++) {
        joint->flow(step.k, u, at.x, dx, y);
        solver->input[LOAD][i] = u[LOAD];
        solver->friction[0][i] = y[0];
        const double missing = torque - y[0] - stop - u[LOAD];
        const double size = fabs(torque) + fabs(y[0]) + fabs(stop) + fabs(load);
        const bool is_balanced = !(fabs(missing) > LOAD_TOLERANCE * size);
        if (SERVO || solver->component->continuous == 0.0 || is_balanced) {
            return true;
        }
        joint->flow_tangent(step.k, u, at.x, no_change, along_load, no_change, tdx, ty);
        u[LOAD] += missing / (1.0 + ty[0]);
    }
    return deny(
        why, "%s: no load was found that balances friction and torque; look at the coefficients.",
        variables[TAU_FRICTION + i].name);
}

/* Follow parameters that have changed. */
static void adopt(Component *component) {
    double *v = component->v;
    double *own = component->own;
    double u[MAX_INPUTS];
    double c[PREPARED];
    if (own[STARTED] != 0.0 && component->changed == 0.0) {
        return;
    }
    for (int l = 0; l < LANES && ALIKE; l++) {
        const Joint *joint = &joints[l < JOINTS ? l : JOINTS - 1];
        for (int j = 0; j < joint->inputs; j++) {
            u[j] = v[joint->input[j]];
        }
        joint->prepare(parameters_of(v, joint), u, c);
        for (int j = 0; j < PREPARED; j++) {
            own[LAW + j * LANES + l] = c[j];
        }
    }
    regroup(component);
}

/* Set acceleration, torques and derivatives of the friction's states at the motion in `v`, which is
 * that of the start values until initialisation ends. */
static bool flow(Component *component, Solver *solver, Message *why) {
    const bool starting = component->own[STARTED] == 0.0;
    double *v = component->v;
    double rest[JOINTS]; /* torque that accelerates */
    double zero[JOINTS] = {0.0};
    if (starting) {
        memcpy(&v[Q], &v[Q_START], JOINTS * sizeof *v);
        memcpy(&v[DQ], &v[DQ_START], JOINTS * sizeof *v);
    }
    adopt(component);
    open_solver(component, 0.0, solver);
    if (SERVO) {
        weigh(solver, solver->q);
    }
    evaluate(solver, solver->q, solver->v);
    for (int i = 0; i < JOINTS; i++) {
        const Joint *joint = &joints[i];
        double *dx = &v[joint->first_state + joint->states];
        double u[MAX_INPUTS];
        const double load = solver->bias[i];
        Step step;
        Motion from;
        if (starting && joint->states > 0) {
            open_axis(solver, i, &step, &from);
            see(&step, from.q, from.dq, u);
            u[LOAD] = load;
            memcpy(from.x, &v[joint->first_start], (size_t)joint->states * sizeof *v);
            if (v[START_MODE] == STEADY) {
                joint->begin(step.k, u, from.x);
            }
            for (int j = 0; j < joint->states; j++) {
                solver->x[j][i] = from.x[j];
            }
        }
        if (!set_friction(solver, i, load, dx, why)) {
            return false;
        }
        solver->steep[i] = NEVER_SMOOTH;
        solver->u[i] = solver->v[i];
        rest[i] = mixed_at(component, true, TAU, i, 0.0) - solver->bias[i];
        rest[i] -= solver->friction[0][i] + solver->stop[i];
        if (SERVO) {
            rest[i] += hold_start(solver, i, rest[i] + solver->support[i]);
        }
        solver->inertial[i] = rest[i];
    }
    if (!solve_linear(solver, zero, rest)) {
        return deny(
            why, "The mass matrix is not positive definite at this posture; check masses, inertias "
                 "and the payload.");
    }
    memcpy(solver->a, rest, sizeof rest);
    memcpy(solver->last, rest, sizeof rest);
    return true;
}

/* Change of the parameters of dynamics.h along `seed`. */
static void change_table(const double *v, const double *seed, double *tp) {
    const double *c = &v[PAYLOAD_COM];
    const double *tc = &seed[PAYLOAD_COM];
    const double m = v[PAYLOAD_M];
    const double tm = seed[PAYLOAD_M];
    /* Of the first moments. */
    const double th[] = {tm * c[0] + m * tc[0], tm * c[1] + m * tc[1], tm * c[2] + m * tc[2]};
    double payload[10] = {tm, th[0], th[1], th[2]};
    double trace = 0.0;
    for (int i = 0; i < 3; i++) {
        trace += c[i] * (th[i] + m * tc[i]);
    }
    for (int k = 0; k < 6; k++) {
        const int i = pair[k][0];
        const int j = pair[k][1];
        payload[4 + k] = seed[PAYLOAD_INERTIA + k] + (i == j ? trace : 0.0);
        payload[4 + k] -= th[i] * c[j] + m * c[i] * tc[j];
    }
    gather(seed, payload, tp);
}

/* Change of the torque of stop i along `seed` and the change du of the inputs u. */
static double change_stop(const Step *step, int i, const double *seed, const double *u,
                          const double *du) {
    const double side = u[1] < step->q_link ? -1.0 : 1.0;
    const int limit = side > 0.0 ? Q_MAX + i : Q_MIN + i;
    const double to_limit[] = {du[0], du[1] - seed[limit]};
    const double depth = side * (u[1] - step->q_link) - step->clearance;
    double slope = 0.0;
    const bool pushes = stop_torque(step, u, to_limit, &slope) != 0.0;
    if (!pushes) {
        return 0.0;
    }
    return slope + side * seed[STIFFNESS + i] * depth +
           seed[DAMPING + i] * fmin(1.0, depth / DEPTH) * u[0];
}

/* Set the change of all variables along `seed`.
 *
 * Until initialisation ends, motion and states follow from start values, and outside of model
 * exchange the law's load is the bias. */
SELDOM static void component_tangent(const Component *component, const double *seed,
                                     double *tangent) {
    const bool started = component->own[STARTED] != 0.0;
    double tq[JOINTS];
    double tdq[JOINTS];
    double tp[10 * LINKS];
    double tbias[JOINTS]; /* of the torque at zero acceleration, and at that of the motion */
    double tneeded[JOINTS];
    double torque[JOINTS]; /* from here on, changes of torques */
    double friction[JOINTS];
    double stop[JOINTS];
    double load[JOINTS];
    double rest[JOINTS];
    double slope[MAX_OUTPUTS];
    double y[MAX_OUTPUTS];
    double zero[JOINTS] = {0.0};
    double along_load[MAX_INPUTS] = {0.0};
    Component at = *component;
    Solver solver;
    Message why;
    at.continuous = started ? 1.0 : component->continuous;
    along_load[LOAD] = 1.0;
    if (!flow(&at, &solver, &why)) {
        for (int i = 0; i < VARIABLES; i++) {
            tangent[i] = NAN;
        }
        return;
    }
    mixed(forward, false, &seed[started ? Q : Q_START], tq);
    mixed(forward, false, &seed[started ? DQ : DQ_START], tdq);
    mixed(backward, false, &seed[TAU], torque);
    change_table(at.v, seed, tp);
    torque_change(&at, seed, tp, solver.q, solver.v, zero, tq, tdq, tbias);
    torque_change(&at, seed, tp, solver.q, solver.v, solver.a, tq, tdq, tneeded);
    for (int i = 0; i < JOINTS; i++) {
        Step step;
        Motion from;
        open_axis(&solver, i, &step, &from);
        const Joint *joint = step.joint;
        const double *k = step.k;
        const double *x = from.x;
        const double *dk = joint->constants ? no_change : &seed[joint->first_parameter];
        double *tx = &tangent[joint->first_state];
        double *tdx = tx + joint->states;
        double u[MAX_INPUTS];
        double du[MAX_INPUTS] = {tdq[i], tq[i], tbias[i]};
        for (int j = LOAD + 1; j < joint->inputs; j++) {
            du[j] = seed[joint->input[j]];
        }
        see(&step, from.q, from.dq, u);
        stop[i] = change_stop(&step, i, seed, u, du);
        memcpy(tx, &seed[started ? joint->first_state : joint->first_start],
               (size_t)joint->states * sizeof *tx);
        if (!started && joint->states > 0 && at.v[START_MODE] == STEADY) {
            u[LOAD] = solver.bias[i];
            joint->begin_tangent(k, u, &at.v[joint->first_start], dk, du, tx);
            u[LOAD] = step.u[LOAD];
        }
        if (at.continuous != 0.0) {
            du[LOAD] = 0.0;
            joint->flow_tangent(k, u, x, no_change, along_load, no_change, tdx, slope);
            joint->flow_tangent(k, u, x, dk, du, tx, tdx, y);
            du[LOAD] = (torque[i] - y[0] - stop[i]) / (1.0 + slope[0]);
        }
        joint->flow_tangent(k, u, x, dk, du, tx, tdx, y);
        friction[i] = y[0];
        load[i] = torque[i] - friction[i] - stop[i];
        rest[i] = load[i] - tneeded[i];
    }
    solve_linear(&solver, zero, rest);
    change_tool(tangent, solver.q, tq);
    mixed(backward, true, tq, &tangent[Q]);
    mixed(backward, true, tdq, &tangent[DQ]);
    mixed(backward, true, rest, &tangent[DDQ]);
    mixed(forward, true, load, &tangent[TAU_LOAD]);
    mixed(forward, true, friction, &tangent[TAU_FRICTION]);
    mixed(forward, true, stop, &tangent[TAU_STOP]);
    if (at.continuous == 0.0) { /* derivatives of states are those of the continuous form */
        double continuous[VARIABLES] = {0.0};
        at.continuous = 1.0;
        component_tangent(&at, seed, continuous);
        for (int i = 0; i < JOINTS; i++) {
            const Joint *joint = &joints[i];
            const int first = joint->first_state + joint->states;
            memcpy(&tangent[first], &continuous[first], (size_t)joint->states * sizeof *tangent);
        }
    }
}

#endif
