/* Servo of a plant: its commands, which may act late, and the gravity that it compensates. */
#ifndef PLANT_SERVO_H
#define PLANT_SERVO_H

#include "plant_solver.h"

/* Memory of a servo: integrals of its commands, and earlier commands: time, speeds, positions. */
enum {
    INTEGRAL = LAW + PREPARED * LANES,
    COMMANDS = INTEGRAL + JOINTS,
    FIRST_COMMAND = COMMANDS + 1
};
enum { SPEEDS = 1, POSITIONS = SPEEDS + JOINTS, ROW = POSITIONS + (POSITION ? JOINTS : 0) };

/* Greatest number of commands within the latency. */
enum { MOST_COMMANDS = 64 };

/* Tolerance for a number of steps to count as whole, and for times [s] to be equal. */
#define ROUNDING 1e-9

/* Evaluate mass matrix and bias at a motion in the coordinates of the friction. */
INLINED bool evaluate_inlined(Solver *solver, const double *q, const double *dq) {
    const double *v = solver->component->v;
    dynamics(&solver->component->own[TABLE], &v[ROTORS], &v[SPRINGS], &v[GRAVITY], q, dq,
             solver->mass, solver->bias);
    for (int i = 0; i < JOINTS; i++) {
        solver->diagonal[i] = solver->mass[i][i];
    }
    return true;
}
IN_WIDTHS(evaluate, (Solver * solver, const double *q, const double *dq), (solver, q, dq))

/* Command of a kind that acts at `time` [s] after the start of the step; before the first one,
 * `otherwise`. */
static double acting(const Component *component, int i, double time, int kind, double otherwise) {
    const double *own = component->own, *row = &own[FIRST_COMMAND];
    const double at = time - component->v[LATENCY];
    if (at > -ROUNDING) {
        return mixed_at(component, false, kind == SPEEDS ? DQ_CMD : Q_CMD, i, 0.0);
    }
    for (int n = 0; n < (int)own[COMMANDS]; n++, row += ROW) {
        otherwise = row[0] <= component->time + at + ROUNDING ? row[kind + i] : otherwise;
    }
    return otherwise;
}

/* Speed command of an axis, with that of the controller of its position, `time` [s] after the start
 * of the step. */
static double commanded(const Solver *solver, int i, double time) {
    const Component *component = solver->component;
    const double speed = acting(component, i, time, SPEEDS, 0.0);
    if (!POSITION) {
        return speed;
    }
    const double start = mixed_at(component, false, Q_START, i, 0.0);
    const double q_cmd = acting(component, i, time, POSITIONS, start);
    return speed + component->v[KP + i] * (q_cmd - solver->q[i]);
}

/* Forget commands that no longer act `later` [s] after the start of the step; whether there is room
 * for another. */
static bool forget(Component *component, double later) {
    double *own = component->own, *row = &own[FIRST_COMMAND], *count = &own[COMMANDS];
    const double oldest = component->time + later - component->v[LATENCY];
    while (*count > 1.0 && row[ROW] <= oldest) {
        *count -= 1.0;
        memmove(row, &row[ROW], (size_t)*count * ROW * sizeof *row);
    }
    return *count < MOST_COMMANDS;
}

static void remember(Component *component, double step) {
    double *own = component->own, *count = &own[COMMANDS];
    double *row = &own[FIRST_COMMAND + (int)*count * ROW];
    row[0] = component->time;
    for (int i = 0; i < JOINTS; i++) {
        row[SPEEDS + i] = mixed_at(component, false, DQ_CMD, i, 0.0);
        if (POSITION) {
            row[POSITIONS + i] = mixed_at(component, false, Q_CMD, i, 0.0);
        }
    }
    *count += 1.0;
    forget(component, step);
}

/* Set the supported torque of every axis: its share of gravity and springs at a posture. */
static void weigh(Solver *solver, const double *q) {
    const double rest[JOINTS] = {0.0};
    evaluate(solver, q, rest);
    for (int i = 0; i < JOINTS; i++) {
        solver->support[i] = solver->component->v[GRAVITY_SHARE + i] * solver->bias[i];
    }
}

static double servo_at(const Solver *solver, int i, double speed) {
    const double torque = solver->servo[i] - solver->gain[i] * speed;
    return fabs(torque) >= solver->most[i] ? copysign(solver->most[i], torque) : torque;
}

/* Set an axis's servo to the command at `time`, and add what supports the axis. */
static void drive(Solver *solver, int i, double time) {
    const double *v = solver->component->v, h = solver->h;
    const double command = commanded(solver, i, time);
    const double behind = solver->command[i] + h * command - solver->q[i];
    solver->servo[i] = v[KV + i] * command + v[KI + i] * behind;
    solver->gain[i] = (v[KV + i] + h * v[KI + i]) * (POSITION ? 1.0 + h * v[KP + i] : 1.0);
    solver->most[i] = v[TORQUE_LIMIT + i];
    solver->applied[i] += solver->support[i];
    solver->support[i] += mixed_at(solver->component, true, TAU, i, time + 0.5 * h);
}

/* Set the integral of a servo so that its torque is `missing` less at speed 0; return the torque of
 * servo and support at the start. */
static double hold_start(Solver *solver, int i, double missing) {
    const double *v = solver->component->v, ki = v[KI + i], q = solver->q[i];
    solver->command[i] = ki > 0.0 ? q - missing / ki : q;
    solver->servo[i] = ki * (solver->command[i] - q);
    solver->gain[i] = v[KV + i];
    solver->most[i] = v[TORQUE_LIMIT + i];
    const double support = solver->support[i], servo = servo_at(solver, i, solver->v[i]);
    solver->stop[i] -= servo;
    solver->support[i] += mixed_at(solver->component, true, TAU, i, 0.0);
    return support + servo;
}

#endif
