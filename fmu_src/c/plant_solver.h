/* One implicit step of a robot: speeds at which inertia, friction, stops and torques balance.
 *
 * Newton's method on all axes; sweeps of exact solutions for one axis after the other (root.h)
 * where it does not progress or a law jumps at rest. An axis that friction holds keeps its speed in
 * Newton's method; the sweep that follows releases it or sets its friction to the balance. */
#ifndef PLANT_SOLVER_H
#define PLANT_SOLVER_H

#include "dynamics.h"
#include "root.h"
#include "servo.h"

/* Own memory: whether initialisation has ended, slopes of G, mass matrix times acceleration, the
 * acceleration before, parameters of dynamics.h, and those of the law. A servo's follows. */
enum {
    STARTED = 0,
    SLOPE = 1,
    INERTIAL = SLOPE + JOINTS,
    LAST = INERTIAL + JOINTS,
    TABLE = LAST + JOINTS,
    LAW = TABLE + 10 * LINKS
};

enum {
    MAX_ITERATIONS = 200,
    PATIENCE = 6,     /* iterations of Newton's method before the first sweep */
    SWEEPING = 20,    /* iterations after which most are sweeps */
    SWEEPS_ONLY = 60, /* and all */
    HALVINGS = 12     /* of an inner step without a solution */
};

/* Residual that counts as balanced, as a share of the torques. */
#define BALANCED 1e-10

/* Share of the momentum that counts as torque in this, because of rounding. */
#define GRAIN 1e-5

/* Speed [rad/s or m/s] whose rounding counts as balanced. It is that of a robot's motions: where a
 * servo carries all torques and nothing moves, shares of torques and momentum would vanish. */
#define TYPICAL_SPEED 1.0

/* Share of the balance that the curvature of friction may use. */
#define STRAIGHT_SHARE 0.1

/* Slope of friction that holds, or is not known yet. */
#define NEVER_SMOOTH 1e100

/* Shortest change of speed [rad/s or m/s] to which another one is compared. */
#define CLOSE 1e-100

/* Penetration depth for the full damping of a stop [rad or m]. */
#define DEPTH 1e-3

typedef double Lanes[LANES];

/* All axes; spare lanes hold finite values. */
typedef struct {
    Lanes mass[JOINTS];
    Lanes diagonal; /* of the mass matrix */
    Lanes bias;
    Lanes q; /* motion at the start */
    Lanes v;
    Lanes a;
    Lanes last;      /* acceleration before */
    Lanes steep;     /* slope of the last step */
    Lanes middle;    /* of the range between the stops */
    Lanes clearance; /* half of this range */
    Lanes applied;   /* torque of the motor less the bias */
    Lanes x[MAX_STATES];
    Lanes input[MAX_INPUTS];
    Lanes u;                     /* speeds tried; the next five are at them */
    Lanes moved[MAX_STATES];     /* states */
    Lanes friction[MAX_OUTPUTS]; /* first the torque */
    Lanes slope[MAX_OUTPUTS];    /* of these over the speed */
    Lanes stop;                  /* torque of the stops */
    Lanes rise[MAX_STATES];      /* of the states over the speed */
    Lanes weight;                /* 1/2: midpoint; 1: implicit Euler */
    Lanes inertial;              /* mass matrix times acceleration */
    Lanes command;   /* integral of the servo's command, or of its error if it is DIRECT */
    Lanes followed;  /* command that a DIRECT servo follows, before the step */
    Lanes target;    /* and after it */
    Lanes reference; /* its mean over the step */
    Lanes support;   /* torque of the motor without the servo's */
    Lanes servo;     /* torque of a servo at speed 0 */
    Lanes gain;      /* minus its slope */
    Lanes most;      /* its limit */
    const Component *component;
    double h;          /* [s] */
    bool held[JOINTS]; /* whether friction holds the speed, where its law jumps */
    bool holding;      /* whether it holds any */
    bool smooth;       /* whether nothing but the law of all axes acts, and `rise` is known */
} Solver;

/* Torque [N.m] of a stop, a spring and damper beyond the clearance; it pushes but never pulls. The
 * inputs u are speed and position, du their derivatives; the slope along du is added. */
static double stop_torque(const Step *step, const double *u, const double *du, double *slope) {
    const double offset = u[1] - step->q_link;
    const double side = offset < 0.0 ? -1.0 : 1.0;
    const double depth = side * offset - step->clearance;
    if (depth <= 0.0) { /* NaN goes on, so that the solver sees it */
        return 0.0;
    }
    /* Damping grows with the depth: the torque is continuous at contact. */
    const double share = fmin(1.0, depth / DEPTH);
    const double closing_speed = side * u[0];
    const double torque = step->stiffness * depth + step->damping * share * closing_speed;
    if (torque < 0.0) {
        return 0.0;
    }
    const double growth = depth < DEPTH ? step->damping * closing_speed / DEPTH : 0.0;
    *slope += (step->stiffness + growth) * du[1] + step->damping * share * du[0];
    return side * torque;
}

/* Torque [N.m] of the servo at speed v [rad/s]; its slope is subtracted. */
static double servo_torque(const Step *step, double v, double *slope) {
    const double torque = step->servo - step->gain * v;
    if (fabs(torque) >= step->most) {
        return copysign(step->most, torque);
    }
    *slope += step->gain;
    return torque;
}

/* Torque [N.m] of stop and servo against the motion; see balance.h. */
static double link_torque(const Step *step, const double *u, const double *du, double *slope) {
    const double stop = stop_torque(step, u, du, slope);
    if (!SERVO) {
        return stop;
    }
    return stop - servo_torque(step, u[0], slope);
}

/* Whether the law of axis i jumps at rest, so that it may hold the axis. */
static bool can_hold(int i) {
    return joints[i].switches_of_joint > 0;
}

/* Whether coordinate i is joint i, so that the joint's stops apply to it. */
static bool is_joint(int i) {
    for (int m = 0; COUPLED && m < JOINTS; m++) {
        const bool row = forward[i][m] != 0.0;
        const bool column = forward[m][i] != 0.0;
        if ((m == i) != row || (m != i && column)) {
            return false;
        }
    }
    return true;
}

/* Describe axis i as that of balance.h, with its motion at the start of the step. */
static void open_axis(const Solver *solver, int i, Step *step, Motion *from) {
    const Joint *joint = &joints[i];
    const double *v = solver->component->v;
    const bool has_stops = is_joint(i);
    step->joint = joint;
    step->k = parameters_of(v, joint);
    step->gear = 1.0;
    step->stiffness = has_stops ? v[STIFFNESS + i] : 0.0;
    step->damping = has_stops ? v[DAMPING + i] : 0.0;
    step->q_link = solver->middle[i];
    step->clearance = solver->clearance[i];
    step->servo = solver->servo[i];
    step->gain = solver->gain[i];
    step->most = solver->most[i];
    step->h = solver->h;
    step->euler = v[DISCRETISATION] == EULER;
    from->q = solver->q[i];
    from->dq = solver->v[i];
    for (int j = LOAD; j < joint->inputs; j++) {
        step->u[j] = solver->input[j][i];
    }
    for (int j = 0; j < joint->states; j++) {
        from->x[j] = solver->x[j][i];
    }
}

/* Store a trial of axis i, and whether friction holds its speed. */
static void store_trial(Solver *solver, int i, const Trial *trial, bool held, double slope) {
    solver->u[i] = trial->v;
    solver->friction[0][i] = trial->tau_f;
    solver->stop[i] = trial->tau_link;
    solver->slope[0][i] = held ? NEVER_SMOOTH : slope;
    solver->held[i] = held;
    solver->holding |= held;
    solver->smooth = false;
    for (int j = 0; j < joints[i].states; j++) {
        solver->moved[j][i] = trial->x[j];
    }
}

/* Evaluate friction and stop of axis i at a speed. */
NOINLINE static void attempt_one(Solver *solver, int i, double speed, bool held) {
    Step step;
    Motion from;
    Trial trial;
    open_axis(solver, i, &step, &from);
    attempt(&step, &from, speed, &trial);
    store_trial(solver, i, &trial, held, trial.slope);
}

/* Evaluate friction and stop of every axis that is not held, at a speed. */
INLINED void attempt_all(Solver *solver, const double *speed) {
    const Lanes *c = (const Lanes *)&solver->component->own[LAW];
    const double h = solver->h;
    const double euler = solver->component->v[DISCRETISATION] == EULER;
    int near = SERVO; /* whether anything but friction acts on an axis */
    bool done = false;
    if (ALIKE && !solver->holding) {
        for (int l = 0; l < LANES; l++) {
            solver->u[l] = speed[l];
            solver->input[0][l] = speed[l];
            solver->input[1][l] = solver->q[l] + h * speed[l];
            solver->stop[l] = 0.0;
            near |= !(fabs(solver->input[1][l] - solver->middle[l]) <= solver->clearance[l]);
        }
        done =
            joints[0].attempts(c, (const Lanes *)solver->input, (const Lanes *)solver->x, h, euler,
                               solver->moved, solver->rise, solver->friction, solver->slope);
    }
    solver->smooth = done && !near;
    for (int i = 0; i < JOINTS && (near || !done); i++) {
        if (done) {
            const double u[] = {speed[i], solver->input[1][i]};
            const double du[] = {1.0, h};
            Step step;
            Motion from;
            open_axis(solver, i, &step, &from);
            solver->stop[i] = link_torque(&step, u, du, &solver->slope[0][i]);
        } else if (!solver->held[i]) {
            attempt_one(solver, i, speed[i], false);
        }
    }
}

/* Replace `right` by the solution of (M + diag(more)) x = right, by a factorisation L D L'; rows of
 * held axes give 0. */
INLINED bool solve_linear(const Solver *solver, const double *more, double *right) {
    double inverse[JOINTS];
    Lanes a[JOINTS];
    memcpy(a, solver->mass, sizeof a);
    UNROLLED
    for (int i = 0; i < JOINTS; i++) {
        a[i][i] += more[i];
    }
    for (int i = 0; i < JOINTS && solver->holding; i++) {
        for (int j = 0; j < JOINTS; j++) {
            a[j > i ? j : i][j > i ? i : j] *= !solver->held[i];
        }
        a[i][i] += solver->held[i];
        right[i] *= !solver->held[i];
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

/* Compute the changes of the speeds over the whole step. */
INLINED void compute_changes(const Solver *solver, double *change) {
    for (int l = 0; l < LANES; l++) {
        change[l] = (solver->u[l] - solver->v[l]) / solver->weight[l];
    }
}

/* Solve the balance of each axis in turn with the speeds of the others. */
NOINLINE static bool sweep(Solver *solver, Message *why) {
    Lanes change;
    compute_changes(solver, change);
    solver->holding = false;
    for (int i = 0; i < JOINTS; i++) {
        Step step;
        Motion from;
        Trial trial;
        double impulse = 0.0;
        open_axis(solver, i, &step, &from);
        for (int j = 0; j < JOINTS; j++) {
            impulse += j == i ? 0.0 : solver->mass[i][j] * change[j];
        }
        step.inertia = solver->mass[i][i] / solver->weight[i];
        step.tau_motor = solver->applied[i] - impulse / solver->h;
        if (!solve(&step, &from, &trial, variables[DQ + i].name, why)) {
            return false;
        }
        /* The solver states friction that differs from the law's only if it holds. */
        const bool held = can_hold(i) && trial.v == 0.0;
        store_trial(solver, i, &trial, held, trial.slope - step.inertia / solver->h);
        change[i] = (solver->u[i] - solver->v[i]) / solver->weight[i];
    }
    return true;
}

/* Move speeds, friction and states along their tangents if friction, as curved as since the last
 * step, stays far below the residual `least` that counts. */
INLINED bool slide(Solver *solver, const double *speed, double least) {
    double bend = 0.0;
    for (int i = 0; i < JOINTS; i++) {
        const double move = speed[i] - solver->u[i];
        const double way = fabs(solver->u[i] - solver->v[i]);
        bend += fabs(solver->slope[0][i] - solver->steep[i]) * (move * move) / fmax(way, CLOSE);
    }
    if (!(solver->h * bend < STRAIGHT_SHARE * least)) {
        return false;
    }
    for (int l = 0; l < LANES; l++) {
        const double move = speed[l] - solver->u[l];
        solver->u[l] = speed[l];
        solver->friction[0][l] += solver->slope[0][l] * move;
        for (int j = 0; j < MAX_STATES; j++) {
            solver->moved[j][l] += solver->rise[j][l] * move;
        }
    }
    return true;
}

/* Results of a Newton step: axes are newly held, speeds have changed, or they balance. */
enum { WAITING, MOVED, BALANCES };

/* One Newton step. If the speed of a law that jumps would pass zero, the axis is held there
 * instead, and the others wait. */
INLINED int newton(Solver *solver, const double *residual, double least) {
    Lanes change;
    Lanes more;
    Lanes speed;
    bool waits = false;
    for (int attempts = 0; attempts < 2; attempts++) {
        for (int l = 0; l < LANES; l++) {
            /* Falling friction may make the matrix indefinite: the second attempt leaves it out. */
            const bool is_left_out = attempts && solver->slope[0][l] < 0.0;
            const double slope = is_left_out ? 0.0 : solver->slope[0][l];
            more[l] = solver->h * solver->weight[l] * slope;
            change[l] = -residual[l];
        }
        if (solve_linear(solver, more, change)) {
            break;
        }
    }
    int passes = 0;
    for (int l = 0; l < LANES; l++) {
        speed[l] = solver->u[l] + solver->weight[l] * change[l];
        passes |= l < JOINTS && solver->u[l] * speed[l] <= 0.0;
    }
    for (int i = 0; i < JOINTS && passes; i++) {
        if (can_hold(i) && !solver->held[i] && solver->u[i] * speed[i] <= 0.0) {
            attempt_one(solver, i, 0.0, true);
            waits = true;
        }
    }
    if (waits) {
        return WAITING;
    }
    if (solver->smooth && slide(solver, speed, least)) {
        return BALANCES;
    }
    attempt_all(solver, speed);
    return MOVED;
}

/* Compute the residuals [N.m.s] of all axes, see plant.c. */
INLINED void balance_all(const Solver *solver, double *residual) {
    Lanes change;
    compute_changes(solver, change);
    for (int l = 0; l < LANES; l++) {
        const double torque = solver->friction[0][l] + solver->stop[l] - solver->applied[l];
        residual[l] = solver->h * torque;
    }
    for (int i = 0; i < JOINTS; i++) {
        for (int l = 0; l < LANES; l++) {
            residual[l] += solver->mass[i][l] * change[i];
        }
    }
}

/* Sum the residuals, those of held axes if `held`, and find the least that counts: a share of the
 * torques, and round-off. Where a servo carries all torques and nothing moves, the torques in the
 * residual vanish, but not the round-off of what cancels in them. */
INLINED double sum_residuals(const Solver *solver, bool held, const double *residual,
                             double *least) {
    Lanes sizes;
    Lanes positions;
    Lanes floors;
    double total = 0.0;
    double size = 0.0;
    double rounding = 0.0;
    for (int l = 0; l < LANES; l++) {
        const double torque = fabs(solver->friction[0][l] + solver->stop[l]);
        const double grain = GRAIN * (fabs(solver->u[l]) + fabs(solver->v[l]));
        sizes[l] = solver->h * (torque + fabs(solver->applied[l])) + solver->diagonal[l] * grain;
        positions[l] = fabs(solver->slope[0][l] * solver->q[l]);
        floors[l] = solver->h * fabs(solver->bias[l]) + solver->diagonal[l] * TYPICAL_SPEED;
    }
    for (int i = 0; i < JOINTS; i++) {
        const bool waits = solver->holding && solver->held[i];
        total += waits && !held ? 0.0 : fabs(residual[i]);
        size += sizes[i];
        rounding += floors[i] + (waits ? 0.0 : positions[i]);
    }
    *least = BALANCED * size + 4.0 * DBL_EPSILON * rounding;
    return total;
}

/* Iterate until the torques balance, first by Newton's method unless `sweeping`. */
INLINED bool settle(Solver *solver, bool sweeping, Message *why) {
    double least;
    double before = INFINITY; /* sum of residuals */
    Lanes residual;
    bool waiting = false; /* for the balance with axes that were just held */
    for (int n = 0; n < MAX_ITERATIONS; n++) {
        const bool swept = sweeping;
        if (swept && !sweep(solver, why)) {
            return false;
        }
        balance_all(solver, residual);
        const double total = sum_residuals(solver, swept, residual, &least);
        const bool done = total <= least;
        if (!isfinite(total)) {
            break;
        }
        if (done && (swept || !solver->holding)) {
            return true;
        }
        const bool slow = n > 1 && !swept && total > 0.5 * before;
        const bool impatient = n >= PATIENCE && !swept && !waiting;
        const bool mostly_sweeps = n >= SWEEPING && (n % 4 != 0 || n >= SWEEPS_ONLY);
        before = swept ? INFINITY : total;
        sweeping = slow || done || impatient || mostly_sweeps;
        const int end = sweeping ? WAITING : newton(solver, residual, least);
        if (end == BALANCES) {
            return true;
        }
        waiting = !sweeping && end == WAITING;
        before = waiting ? INFINITY : before;
    }
    return deny(why,
                "No speeds were found that balance the torques in a step of %g s; the motion keeps "
                "its last value. Take a smaller substep, or look at torques and coefficients.",
                solver->h);
}

/* Choose midpoint or implicit Euler. Start from the speeds of an acceleration that changes as in
 * the last step, or stays constant if a speed reverses. Return whether an axis may be held. */
INLINED bool predict(Solver *solver) {
    const double h = solver->h;
    bool at_rest = false;
    int turns = 0;
    Lanes first;
    for (int l = 0; l < LANES; l++) {
        const double v = solver->v[l];
        const double constant = h * solver->a[l]; /* change at a constant acceleration */
        const double next = v + constant;
        /* TINY: compilers may read 0 where only the other branch of `weight` is needed. */
        const double z = h * solver->steep[l] / (solver->diagonal[l] + TINY);
        const double weight = v * next > 0.0 ? 1.0 - 0.5 / (1.0 + z * z) : 1.0;
        const double linear = v + weight * (2.0 * constant - h * solver->last[l]);
        first[l] = v * linear > 0.0 ? linear : v + weight * constant;
        solver->weight[l] = weight;
        turns |= l < JOINTS && v * next <= 0.0;
    }
    memset(solver->held, 0, sizeof solver->held);
    solver->holding = false;
    for (int i = 0; i < JOINTS && turns; i++) {
        const double v = solver->v[i];
        const bool turns_here = can_hold(i) && v * (v + h * solver->a[i]) <= 0.0;
        first[i] = turns_here ? v : first[i];
        at_rest |= can_hold(i) && first[i] == 0.0;
    }
    attempt_all(solver, first);
    return at_rest;
}

/* Advance the axes' motions by a step, with mass matrix, applied torques and loads given. */
INLINED bool advance(Solver *solver, Message *why) {
    const double h = solver->h;
    int sweeping = predict(solver);
    int again = 1; /* whether a speed has reversed, so that its axis needs implicit Euler */
    Lanes change;
    while (again) {
        if (!settle(solver, sweeping, why)) {
            return false;
        }
        again = 0;
        compute_changes(solver, change);
        for (int l = 0; l < LANES; l++) {
            const double v = solver->v[l];
            const int reversed = solver->weight[l] < 1.0 && v * (v + change[l]) <= 0.0;
            solver->weight[l] = reversed ? 1.0 : solver->weight[l];
            again |= reversed;
        }
    }
    memcpy(solver->last, solver->a, sizeof solver->a);
    memcpy(solver->steep, solver->slope[0], sizeof solver->steep);
    for (int l = 0; l < LANES; l++) {
        solver->a[l] = change[l] * (1.0 / h);
        solver->v[l] += change[l];
        solver->q[l] += h * solver->u[l];
        solver->inertial[l] = solver->applied[l] - (solver->friction[0][l] + solver->stop[l]);
    }
    memcpy(solver->x, solver->moved, sizeof solver->x);
    return true;
}

#endif
