/* The torques on the motor of a joint, at any speed that it may have at the end of a step. */
#ifndef BALANCE_H
#define BALANCE_H

#include <math.h>
#include <stdbool.h>

#include "component.h"
#include "laws.h"
#include "relax.h"

/* Where the motor of a joint is, with its friction states. */
typedef struct {
    double q, dq; /* of the motor */
    double ddq, tau_f, tau_link;
    double x[MAX_STATES], dx[MAX_STATES];
} Motion;

/* What does not change in a step. */
typedef struct {
    const Joint *joint;
    const double *k; /* coefficients */
    double scale;    /* of the law's torque */
    double inertia, gear, stiffness, damping;
    double tau_motor, tau_load, q_link, dq_link;
    double h; /* [s] */
    bool euler;
} Step;

/* What a speed at the end of the step would mean. */
typedef struct {
    double v, residual, slope;
    double size; /* of what the residual is the sum of */
    double tau_f, tau_link;
    double x[MAX_STATES], dx[MAX_STATES], rate[MAX_STATES];
} Trial;

/* An input at a time [s] after the beginning of the glue's step. */
static double input_at(const Component *component, int variable, double time) {
    return component->v[variable] + component->slope[variable] * time;
}

/* An inner step of h that ends at a time [s] after the beginning of the glue's; it is implicit, so
 * its inputs are those of its end. */
static Step step_of(const Component *component, int i, double h, double time) {
    const Joint *joint = &joints[i];
    const double *v = component->v;
    return (Step){
        .joint = joint,
        .k = joint->constants ? joint->constants : &v[joint->first_parameter],
        .scale = joint->constants ? v[joint->first_parameter] : 1.0,
        .inertia = v[INERTIA + i],
        .gear = 1.0 / v[RATIO + i],
        .stiffness = v[STIFFNESS + i],
        .damping = v[DAMPING + i],
        .tau_motor = input_at(component, TAU_MOTOR + i, time),
        .tau_load = input_at(component, TAU_LOAD + i, time),
        .q_link = input_at(component, Q_LINK + i, time),
        .dq_link = input_at(component, DQ_LINK + i, time),
        .h = h,
        .euler = v[DISCRETISATION] == EULER,
    };
}

/* Friction and flexspline at a speed v of the motor that is held over the step; h = 0 leaves the
 * states where they are. The slopes are those over v, torques and speeds those of the joint. */
static void attempt(const Step *step, const Motion *from, double v, Trial *trial) {
    const Joint *joint = step->joint;
    const double q = from->q + step->h * v;
    const double u[INPUTS_OF_JOINT] = {step->gear * v, step->gear * q, step->tau_load};
    const double du[INPUTS_OF_JOINT] = {step->gear, step->gear * step->h, 0.0};
    double s[MAX_SWITCHES], drive[MAX_STATES], d_drive[MAX_STATES], d_rate[MAX_STATES];
    double d_x[MAX_STATES], d_dx[MAX_STATES], slope;
    joint->switches(step->k, u, s);
    for (int j = 0; j < joint->switches_of_joint; j++) {
        s[j] = sgn(s[j]);
    }
    joint->relaxations(step->k, u, s, du, drive, trial->rate, d_drive, d_rate);
    for (int j = 0; j < joint->states; j++) {
        const Decay over = decay(trial->rate[j], step->h, step->euler);
        const double x = relax(from->x[j], drive[j], &over);
        trial->x[j] = x;
        trial->dx[j] = drive[j] - trial->rate[j] * x;
        d_x[j] = tangent_of_relax(x, drive[j], d_drive[j], d_rate[j], &over);
        d_dx[j] = d_drive[j] - d_rate[j] * x - trial->rate[j] * d_x[j];
    }
    const double torque = joint->torque(step->k, u, s, trial->x, trial->dx, du, d_x, d_dx, &slope);
    trial->v = v;
    trial->tau_f = step->scale * torque;
    trial->tau_link =
        step->stiffness * (u[1] - step->q_link) + step->damping * (u[0] - step->dq_link);
    trial->slope = step->scale * slope + step->stiffness * du[1] + step->damping * du[0];
}

/* The same, and what is left of the balance of torques. */
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
