/* Torques on a joint's motor as functions of its speed at the end of a step. */
#ifndef BALANCE_H
#define BALANCE_H

#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "component.h"
#include "coupling.h"
#include "equations.h"

/* Motion of a motor [rad, rad/s, rad/s2], torques [N.m] and states of its law. */
typedef struct {
    double q;
    double dq;
    double ddq;
    double tau_f;
    double tau_link;
    double x[MAX_STATES];
} Motion;

/* What acts on a motor over an inner step. */
typedef struct {
    const Joint *joint;
    const double *k;      /* coefficients */
    double u[MAX_INPUTS]; /* inputs of the law but speed and angle */
    double inertia;
    double gear; /* speed of the joint over that of the motor */
    double stiffness;
    double damping;
    double tau_motor;
    double q_link;
    double dq_link;
    double clearance; /* of the spring on either side of q_link */
    double servo;     /* torque of a servo at speed 0 */
    double gain;      /* minus its slope */
    double most;      /* its limit */
    double h;         /* [s] */
    double euler;     /* 1 for explicit Euler */
} Step;

/* A speed v, and what would be at the end of a step with it. */
typedef struct {
    double v;
    double residual;
    double slope;
    double size; /* scale of the residual's terms */
    double tau_f;
    double tau_link;
    double x[MAX_STATES];
} Trial;

/* Input at `time` [s] after the start of the communication step; parameters are constant. */
static double input_at(const Component *component, int variable, double time) {
    const double slope = variable < SLOPES ? component->slope[variable] : 0.0;
    return component->v[variable] + slope * time;
}

/* Input of a coordinate, mixed from the joints, at `time` [s] after the start of the step. */
static double mixed_at(const Component *component, bool torque, int vector, int i, double time) {
    double sum = 0.0;
    if (!COUPLED) {
        return input_at(component, vector + i, time);
    }
    for (int m = 0; m < JOINTS; m++) {
        sum += share_of(torque, i, m) * input_at(component, vector + m, time);
    }
    return sum;
}

/* Fill the inputs u of the law at a motor's angle and speed. */
static void see(const Step *step, double q, double dq, double *u) {
    memcpy(u, step->u, sizeof step->u);
    u[0] = step->gear * dq;
    u[1] = step->gear * q;
}

/* Torque of a spring at the inputs u of the law; its slope along du is added. */
static double link_torque(const Step *step, const double *u, const double *du, double *slope);

/* Evaluate friction and spring in joint coordinates at a motor speed v held over the step; h =
 * 0 keeps the states. Slopes are derivatives with respect to v. */
static void attempt(const Step *step, const Motion *from, double v, Trial *trial) {
    const double du[MAX_INPUTS] = {step->gear, step->gear * step->h};
    double u[MAX_INPUTS];
    double slope[MAX_OUTPUTS];
    double torque[MAX_OUTPUTS];
    see(step, from->q + step->h * v, v, u);
    step->joint->attempt(step->k, u, from->x, step->h, step->euler, du, trial->x, torque, slope);
    trial->v = v;
    trial->tau_f = torque[0];
    trial->tau_link = link_torque(step, u, du, &slope[0]);
    trial->slope = slope[0];
}

/* Evaluate the residual of the balance [N.m] at a motor speed v, with its slope and its size. */
static void balance(const Step *step, const Motion *from, double v, Trial *trial) {
    attempt(step, from, v, trial);
    const double rate = step->inertia / step->h;
    const double needed = rate * (v - from->dq);
    const double passive = step->gear * (trial->tau_f + trial->tau_link);
    trial->residual = needed - step->tau_motor + passive;
    trial->slope = rate + step->gear * trial->slope;
    trial->size = fabs(needed) + fabs(step->tau_motor) +
                  fabs(step->gear) * (fabs(trial->tau_f) + fabs(trial->tau_link));
}

#endif
