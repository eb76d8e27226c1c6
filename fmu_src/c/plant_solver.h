/* One implicit step of a robot: speeds at which inertia, friction, stops and torques balance.
 *
 * Newton's method on all axes; sweeps of exact solutions for one axis after the other (root.h)
 * where it does not progress or a law jumps at rest. An axis that friction holds keeps its speed in
 * Newton's method; the sweep that follows releases it or sets its friction to the balance. */
#ifndef PLANT_SOLVER_H
#define PLANT_SOLVER_H

#include "coupling.h"
#include "root.h"
#include "servo.h"

enum { MOST_ITERATIONS = 200, PATIENCE = 6, SWEEPING = 20, SWEEPS_ONLY = 60, HALVINGS = 12 };

/* Residual that counts as balanced, as a share of the torques. */
#define BALANCED 1e-10

/* Share of the momentum that counts as torque in this, because of rounding. */
#define GRAIN 1e-5

/* A loop of few rounds. */
#ifdef __clang__
#define UNROLLED _Pragma("clang loop unroll(full)")
#else
#define UNROLLED
#endif

/* Slope of friction that holds, or is not known yet. */
#define NEVER_SMOOTH 1e100

/* Penetration depth for the full damping of a stop [rad or m]. */
#define DEPTH 1e-3

typedef struct {
    Step step;
    Motion from;
    Trial trial;     /* speed u, friction and stop at it, and the states moved by it */
    double slope;    /* of friction and stop over the speed */
    double weight;   /* 1/2: midpoint; 1: implicit Euler */
    double applied;  /* torque of the motor less the bias */
    double inertial; /* mass matrix times acceleration */
    bool held;       /* whether friction holds the speed, where its law jumps */
    double command;  /* integral of the servo's command */
    double support;  /* torque of the motor besides the servo's */
} Axis;

typedef struct {
    Axis axis[JOINTS];
    double mass[JOINTS][JOINTS], bias[JOINTS];
    double h;
    /* Arguments of the law of all axes, if `alike`. Spare lanes repeat the last axis. */
    bool alike;
    double k[MAX_PARAMETERS][LANES], u[MAX_INPUTS][LANES], x[MAX_STATES][LANES];
} Solver;

/* Torque of the one-sided springs beyond the clearance; they push but do not pull. */
static double stop_torque(const Step *step, const double *u, const double *du, double *slope) {
    const double away = u[1] - step->q_link, side = away < 0.0 ? -1.0 : 1.0;
    const double deep = side * away - step->clearance;
    if (!(deep > 0.0) && !isnan(deep)) {
        return 0.0;
    }
    const double share = fmin(1.0, deep / DEPTH), speed = side * u[0];
    const double push = step->stiffness * deep + step->damping * share * speed;
    if (push < 0.0) {
        return 0.0;
    }
    const double steeper = deep < DEPTH ? step->damping * speed / DEPTH : 0.0;
    *slope += (step->stiffness + steeper) * du[1] + step->damping * share * du[0];
    return side * push;
}

/* Torque of the servo at speed v; its slope is subtracted. */
static double servo_torque(const Step *step, double v, double *slope) {
    const double torque = step->servo - step->gain * v;
    if (fabs(torque) >= step->most) {
        return copysign(step->most, torque);
    }
    *slope += step->gain;
    return torque;
}

static double link_torque(const Step *step, const double *u, const double *du, double *slope) {
    const double stop = stop_torque(step, u, du, slope);
    return SERVO ? stop - servo_torque(step, u[0], slope) : stop;
}

/* Whether the law may hold the axis at rest. */
static bool jumps(const Axis *axis) {
    return axis->step.joint->switches_of_joint > 0;
}

static double torque_of(const Axis *axis) {
    return axis->trial.tau_f + axis->trial.tau_link;
}

static void copy_to_lanes(Solver *solver) {
    const Joint *first = solver->axis[0].step.joint;
    solver->alike = true;
    for (int l = 0; l < LANES; l++) {
        const Axis *axis = &solver->axis[l < JOINTS ? l : JOINTS - 1];
        solver->alike &= axis->step.joint->attempts == first->attempts;
        for (int j = 0; j < first->parameters && solver->alike; j++) {
            solver->k[j][l] = axis->step.k[j];
        }
    }
}

/* States and held inputs, which differ from step to step. */
static void update_lanes(Solver *solver) {
    const Joint *joint = solver->axis[0].step.joint;
    for (int l = 0; l < LANES && solver->alike; l++) {
        const Axis *axis = &solver->axis[l < JOINTS ? l : JOINTS - 1];
        for (int j = LOAD; j < joint->inputs; j++) {
            solver->u[j][l] = axis->step.u[j];
        }
        for (int j = 0; j < joint->states; j++) {
            solver->x[j][l] = axis->from.x[j];
        }
    }
}

/* Evaluate friction and stop of every axis that is not held, at a speed. */
static void attempt_all(Solver *solver, const double *speed) {
    const Joint *joint = solver->axis[0].step.joint;
    double moved[MAX_STATES][LANES], torque[MAX_OUTPUTS][LANES], slope[MAX_OUTPUTS][LANES];
    bool done = false;
    if (solver->alike) {
        for (int l = 0; l < LANES; l++) {
            const int i = l < JOINTS ? l : JOINTS - 1;
            solver->u[0][l] = speed[i];
            solver->u[1][l] = solver->axis[i].from.q + solver->h * speed[i];
        }
        done = joint->attempts(solver->k, solver->u, solver->x, solver->h,
                               solver->axis[0].step.euler, moved, torque, slope);
    }
    for (int i = 0; i < JOINTS; i++) {
        Axis *axis = &solver->axis[i];
        Trial *trial = &axis->trial;
        if (axis->held) {
            continue;
        }
        if (done) {
            const double u[] = {speed[i], solver->u[1][i]}, du[] = {1.0, solver->h};
            trial->v = speed[i];
            trial->tau_f = torque[0][i];
            trial->slope = slope[0][i];
            trial->tau_link = link_torque(&axis->step, u, du, &trial->slope);
            for (int j = 0; j < joint->states; j++) {
                trial->x[j] = moved[j][i];
            }
        } else {
            attempt(&axis->step, &axis->from, speed[i], trial);
        }
        axis->slope = trial->slope;
    }
}

/* Replace `right` by the solution of (M + diag(more)) x = right, by a factorisation L D L'; rows of
 * held axes give 0. */
static bool solved(const Solver *solver, const double *more, double *right) {
    double a[JOINTS][JOINTS], inverse[JOINTS];
    memcpy(a, solver->mass, sizeof a);
    for (int i = 0; i < JOINTS; i++) {
        a[i][i] += more[i];
        for (int j = 0; j < JOINTS && solver->axis[i].held; j++) {
            a[i][j] = a[j][i] = i == j ? 1.0 : 0.0;
        }
        right[i] = solver->axis[i].held ? 0.0 : right[i];
    }
    UNROLLED
    for (int j = 0; j < JOINTS; j++) {
        if (!(a[j][j] > 0.0)) {
            return false;
        }
        inverse[j] = 1.0 / a[j][j];
        UNROLLED
        for (int i = j + 1; i < JOINTS; i++) {
            const double factor = a[i][j] * inverse[j];
            UNROLLED
            for (int k = j + 1; k <= i; k++) {
                a[i][k] -= factor * a[k][j];
            }
            right[i] -= factor * right[j];
        }
    }
    UNROLLED
    for (int i = JOINTS - 1; i >= 0; i--) {
        UNROLLED
        for (int k = i + 1; k < JOINTS; k++) {
            right[i] -= a[k][i] * right[k];
        }
        right[i] *= inverse[i];
    }
    return true;
}

/* Change of an axis's speed over the whole step. */
static double change_of(const Axis *axis) {
    return (axis->trial.v - axis->from.dq) / axis->weight;
}

/* Impulse of axis i for these changes of the speeds. */
static double impulse(const Solver *solver, int i, const double *change) {
    double sum = 0.0;
    for (int j = 0; j < JOINTS; j++) {
        sum += solver->mass[i][j] * change[j];
    }
    return sum;
}

/* Solve the balance of each axis in turn with the speeds of the others. */
static bool sweep(Solver *solver, Message *why) {
    double change[JOINTS];
    for (int i = 0; i < JOINTS; i++) {
        change[i] = change_of(&solver->axis[i]);
    }
    for (int i = 0; i < JOINTS; i++) {
        Axis *axis = &solver->axis[i];
        change[i] = 0.0;
        axis->step.inertia = solver->mass[i][i] / axis->weight;
        axis->step.tau_motor = axis->applied - impulse(solver, i, change) / solver->h;
        if (!solve(&axis->step, &axis->from, &axis->trial, variables[DQ + i].name, why)) {
            return false;
        }
        const double rate = axis->step.inertia / solver->h;
        /* The solver states friction that differs from the law's only if it holds. */
        axis->held = jumps(axis) && axis->trial.v == 0.0;
        axis->slope = axis->held ? NEVER_SMOOTH : axis->trial.slope - rate;
        change[i] = change_of(axis);
    }
    return true;
}

/* One Newton step, after which the residual is updated. If the speed of a law that jumps would pass
 * zero, the axis is held there instead, the others wait, and the result is false. */
static bool newton(Solver *solver, double *residual) {
    double change[JOINTS], more[JOINTS], speed[JOINTS], before[JOINTS];
    for (int attempts = 0; attempts < 2; attempts++) {
        for (int i = 0; i < JOINTS; i++) {
            const Axis *axis = &solver->axis[i];
            const double slope = attempts ? fmax(axis->slope, 0.0) : axis->slope;
            more[i] = solver->h * axis->weight * slope;
            change[i] = -residual[i];
        }
        if (solved(solver, more, change)) {
            break;
        }
    }
    bool whole = true;
    for (int i = 0; i < JOINTS; i++) {
        Axis *axis = &solver->axis[i];
        speed[i] = axis->trial.v + axis->weight * change[i];
        before[i] = torque_of(axis);
        if (jumps(axis) && !axis->held && axis->trial.v * speed[i] <= 0.0) {
            attempt(&axis->step, &axis->from, 0.0, &axis->trial);
            axis->slope = NEVER_SMOOTH;
            axis->held = true;
            whole = false;
        }
    }
    if (!whole) {
        return false;
    }
    attempt_all(solver, speed);
    for (int i = 0; i < JOINTS; i++) {
        const Axis *axis = &solver->axis[i];
        residual[i] = solver->h * (torque_of(axis) - before[i]);
        residual[i] -= axis->held ? 0.0 : more[i] * change[i];
    }
    return true;
}

static void balance_all(const Solver *solver, double *residual) {
    double change[JOINTS];
    for (int i = 0; i < JOINTS; i++) {
        change[i] = change_of(&solver->axis[i]);
    }
    for (int i = 0; i < JOINTS; i++) {
        const Axis *axis = &solver->axis[i];
        residual[i] = impulse(solver, i, change) + solver->h * (torque_of(axis) - axis->applied);
    }
}

/* Whether the residuals are balanced, and their sum; those of held axes count if `held`. */
static bool balanced_all(const Solver *solver, bool held, const double *residual, double *total) {
    double size = *total = 0.0, rounding = 0.0; /* of positions, as torque */
    for (int i = 0; i < JOINTS; i++) {
        const Axis *axis = &solver->axis[i];
        const double grain = solver->mass[i][i] * (fabs(axis->trial.v) + fabs(axis->from.dq));
        *total += axis->held && !held ? 0.0 : fabs(residual[i]);
        size += solver->h * (fabs(torque_of(axis)) + fabs(axis->applied)) + GRAIN * grain;
        rounding += axis->held ? 0.0 : fabs(axis->slope * axis->from.q);
    }
    return *total <= BALANCED * size + 4.0 * DBL_EPSILON * rounding;
}

static bool any_held(const Solver *solver) {
    bool found = false;
    for (int i = 0; i < JOINTS; i++) {
        found |= solver->axis[i].held;
    }
    return found;
}

static bool settle(Solver *solver, bool sweeping, Message *why) {
    double residual[JOINTS], total, before = INFINITY;
    bool updated = false, waiting = false; /* for the balance with axes that were just held */
    for (int n = 0; n < MOST_ITERATIONS; n++) {
        const bool swept = sweeping;
        if (swept && !sweep(solver, why)) {
            return false;
        }
        if (!updated) {
            balance_all(solver, residual);
        }
        const bool done = balanced_all(solver, swept, residual, &total);
        if (!isfinite(total)) {
            break;
        }
        if (done && (swept || !any_held(solver))) {
            return true;
        }
        const bool slow = n > 1 && !swept && total > 0.5 * before;
        before = swept ? INFINITY : total;
        sweeping = slow || done || (n >= PATIENCE && !swept && !waiting) ||
                   (n >= SWEEPING && (n % 4 != 0 || n >= SWEEPS_ONLY));
        updated = !sweeping && newton(solver, residual);
        waiting = !sweeping && !updated;
        before = waiting ? INFINITY : before;
    }
    snprintf(why->text, sizeof why->text,
             "No speeds were found that balance the torques in a step of %g s; the motion keeps "
             "its last value. Take a smaller substep, or look at torques and coefficients.",
             solver->h);
    return false;
}

/* Choose midpoint or implicit Euler, and start from the speeds of constant acceleration. */
static bool predict(Solver *solver) {
    bool at_rest = false;
    double first[JOINTS];
    for (int i = 0; i < JOINTS; i++) {
        Axis *axis = &solver->axis[i];
        const double v = axis->from.dq, next = v + solver->h * axis->from.ddq;
        const double z = solver->h * axis->slope / solver->mass[i][i];
        axis->weight = v * next > 0.0 ? 1.0 - 0.5 / (1.0 + z * z) : 1.0;
        axis->held = false;
        const bool turns = jumps(axis) && v * next <= 0.0;
        first[i] = turns ? v : v + axis->weight * (next - v);
        at_rest |= jumps(axis) && first[i] == 0.0;
    }
    update_lanes(solver);
    attempt_all(solver, first);
    return at_rest;
}

/* Advance the axes' motions by a step, with mass matrix, applied torques and loads given. */
static bool advance(Solver *solver, Message *why) {
    bool again = true, sweeping = predict(solver);
    while (again) {
        if (!settle(solver, sweeping, why)) {
            return false;
        }
        again = false;
        for (int i = 0; i < JOINTS; i++) {
            Axis *axis = &solver->axis[i];
            const double v = axis->from.dq, end = v + (axis->trial.v - v) / axis->weight;
            if (axis->weight < 1.0 && v * end <= 0.0) {
                axis->weight = 1.0;
                again = true;
            }
        }
    }
    for (int i = 0; i < JOINTS; i++) {
        Axis *axis = &solver->axis[i];
        Motion *from = &axis->from;
        const Trial *trial = &axis->trial;
        from->ddq = (trial->v - from->dq) / axis->weight / solver->h;
        from->dq += solver->h * from->ddq;
        from->q += solver->h * trial->v;
        from->tau_f = trial->tau_f;
        from->tau_link = trial->tau_link;
        memcpy(from->x, trial->x, (size_t)axis->step.joint->states * sizeof from->x[0]);
        axis->inertial = axis->applied - torque_of(axis);
    }
    return true;
}

#endif
