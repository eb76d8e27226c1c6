/* Servo of a plant: its commands, which may act late, and the gravity that it compensates. */
#ifndef PLANT_SERVO_H
#define PLANT_SERVO_H

#include "plant_solver.h"

/* Memory of a servo: integrals of its commands, or of its position errors if it is DIRECT, which
 * then has the commands that it follows as well; and number and rows of earlier commands. */
enum {
    INTEGRAL = LAW + PREPARED * LANES,
    FOLLOWED = INTEGRAL + JOINTS,
    COMMANDS = FOLLOWED + (DIRECT ? JOINTS : 0),
    FIRST_COMMAND = COMMANDS + 1
};

/* A row of earlier commands: time, speeds, positions. */
enum { SPEEDS = 1, POSITIONS = SPEEDS + JOINTS, ROW = POSITIONS + (POSITION ? JOINTS : 0) };

/* Greatest number of commands within the latency. */
enum { MAX_COMMANDS = 64 };

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

/* Command of a kind, SPEEDS or POSITIONS, that is an input now. */
static double current_command(const Component *component, int i, int kind) {
    const int input = kind == SPEEDS ? DQ_CMD : Q_CMD;
    return mixed_at(component, false, input, i, 0.0);
}

/* Command of a kind that acts at `time` [s] after the start of the step; before the first one,
 * `otherwise`. */
static double find_command(const Component *component, int i, double time, int kind,
                           double otherwise) {
    const double *own = component->own;
    const double *row = &own[FIRST_COMMAND];
    const double given = time - component->v[LATENCY]; /* after the start of the step [s] */
    if (given > -ROUNDING) {
        return current_command(component, i, kind);
    }
    double command = otherwise;
    for (int n = 0; n < (int)own[COMMANDS]; n++) {
        if (row[0] <= component->time + given + ROUNDING) {
            command = row[kind + i];
        }
        row += ROW;
    }
    return command;
}

/* Speed command [rad/s] of an axis, with that of the controller of its position, `time` [s] after
 * the start of the step. */
static double command_speed(const Solver *solver, int i, double time) {
    const Component *component = solver->component;
    const double speed = find_command(component, i, time, SPEEDS, 0.0);
    if (!POSITION) {
        return speed;
    }
    const double start = mixed_at(component, false, Q_START, i, 0.0);
    const double q_cmd = find_command(component, i, time, POSITIONS, start);
    return speed + component->v[KP + i] * (q_cmd - solver->q[i]);
}

/* Mean of the commands of a kind that act from `from` to `to` [s] after the start of the step; the
 * first one also acts before it. The mean is continuous in the latency, as a fit needs it. */
static double mean_command(const Component *component, int i, int kind, double from, double to) {
    const double *own = component->own;
    const double *row = &own[FIRST_COMMAND];
    const double latency = component->v[LATENCY];
    const double end = to - latency;
    const int count = (int)own[COMMANDS];
    double begin = from - latency;
    double sum = 0.0;
    for (int n = 0; n < count; n++) {
        /* A command lasts until the next one, the last of them until the start of the step. */
        const double until = n + 1 < count ? row[ROW] - component->time : 0.0;
        const double stop = fmin(until, end);
        if (stop > begin) {
            sum += (stop - begin) * row[kind + i];
            begin = stop;
        }
        row += ROW;
    }
    if (end > begin) {
        sum += (end - begin) * current_command(component, i, kind);
    }
    return sum / (to - from);
}

/* Set the command that a DIRECT servo follows, filtered and limited in speed: at the end of a step,
 * and its mean over the step. */
static void follow_command(Solver *solver, int i, double time) {
    const double *v = solver->component->v;
    const double h = solver->h;
    const double filter = v[COMMAND_FILTER + i]; /* time constant [s] */
    const double from = solver->followed[i];
    const double most = h * v[SPEED_LIMIT + i];
    const double mean = mean_command(solver->component, i, POSITIONS, time, time + h);
    const double share = filter > 0.0 ? -expm1(-h / filter) : 1.0;
    const double change = share * (mean - from);
    if (fabs(change) > most) {
        solver->target[i] = from + copysign(most, change);
        solver->reference[i] = from + 0.5 * copysign(most, change);
    } else {
        solver->target[i] = from + change;
        solver->reference[i] = filter > 0.0 ? mean - change * (filter / h) : mean;
    }
}

/* Forget commands that no longer act `later` [s] after the start of the step; whether there is room
 * for another. */
static bool forget(Component *component, double later) {
    double *own = component->own;
    double *row = &own[FIRST_COMMAND];
    double *count = &own[COMMANDS];
    const double oldest = component->time + later - component->v[LATENCY];
    while (*count > 1.0 && row[ROW] <= oldest) {
        *count -= 1.0;
        memmove(row, &row[ROW], (size_t)*count * ROW * sizeof *row);
    }
    return *count < MAX_COMMANDS;
}

/* Remember the commands of a step [s] that has ended. */
static void remember(Component *component, double step) {
    double *own = component->own;
    double *count = &own[COMMANDS];
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

/* Torque [N.m] of the servo of an axis at a speed [rad/s]. */
static double servo_at(const Solver *solver, int i, double speed) {
    const double torque = solver->servo[i] - solver->gain[i] * speed;
    if (fabs(torque) >= solver->most[i]) {
        return copysign(solver->most[i], torque);
    }
    return torque;
}

/* Set a DIRECT servo, kp e + ki (integral of e) + kd (dq_cmd - dq), e = followed command - q. All
 * are those of the middle of the step, so that the servo damps nothing by its discretisation. */
static void drive_directly(Solver *solver, int i, double time) {
    const double *v = solver->component->v;
    const double half = 0.5 * solver->h;
    const double kp = v[KP + i];
    const double ki = v[KI + i];
    const double kd = v[KV + i];
    follow_command(solver, i, time);
    const double error = solver->reference[i] - solver->q[i];
    const double speed = mean_command(solver->component, i, SPEEDS, time, time + solver->h);
    solver->servo[i] = kp * error + ki * (solver->command[i] + half * error) + kd * speed;
    solver->gain[i] = kd + half * (kp + half * ki);
}

/* Set an axis's servo to the command at `time`, and add what supports the axis. */
static void drive(Solver *solver, int i, double time) {
    const double *v = solver->component->v;
    const double h = solver->h;
    if (DIRECT) {
        drive_directly(solver, i, time);
    } else {
        const double command = command_speed(solver, i, time);
        const double behind = solver->command[i] + h * command - solver->q[i];
        const double position_factor = POSITION ? 1.0 + h * v[KP + i] : 1.0;
        solver->servo[i] = v[KV + i] * command + v[KI + i] * behind;
        solver->gain[i] = (v[KV + i] + h * v[KI + i]) * position_factor;
    }
    solver->most[i] = v[TORQUE_LIMIT + i];
    solver->applied[i] += solver->support[i];
    solver->support[i] += mixed_at(solver->component, true, TAU, i, time + 0.5 * h);
}

/* Advance the integral of a servo at the end of a step. That of a DIRECT one waits while its torque
 * is at the limit and would be pushed further. */
static void integrate(Solver *solver, int i, double time) {
    const double h = solver->h;
    if (!DIRECT) {
        solver->command[i] += h * command_speed(solver, i, time);
        return;
    }
    const double error = solver->reference[i] - solver->q[i] + 0.5 * h * solver->u[i];
    const double torque = servo_at(solver, i, solver->u[i]);
    if (!(fabs(torque) >= solver->most[i] && torque * error > 0.0)) {
        solver->command[i] += h * error;
    }
    solver->followed[i] = solver->target[i];
}

/* Set the integral of a servo so that its torque is `missing` less at speed 0; return the torque of
 * servo and support at the start. */
static double hold_start(Solver *solver, int i, double missing) {
    const double *v = solver->component->v;
    const double ki = v[KI + i];
    const double q = solver->q[i];
    if (DIRECT) {
        solver->followed[i] = mixed_at(solver->component, false, Q_CMD, i, 0.0);
        const double direct = v[KP + i] * (solver->followed[i] - q);
        solver->command[i] = ki > 0.0 ? -(missing + direct) / ki : 0.0;
        solver->servo[i] = direct + ki * solver->command[i];
    } else {
        solver->command[i] = ki > 0.0 ? q - missing / ki : q;
        solver->servo[i] = ki * (solver->command[i] - q);
    }
    solver->gain[i] = v[KV + i];
    solver->most[i] = v[TORQUE_LIMIT + i];
    const double support = solver->support[i];
    const double servo = servo_at(solver, i, solver->v[i]);
    solver->stop[i] -= servo;
    solver->support[i] += mixed_at(solver->component, true, TAU, i, 0.0);
    return support + servo;
}

#endif
