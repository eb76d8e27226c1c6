/* Inner step of a joint that a flexspline couples to its link. */
#ifndef DRIVE_STEP_H
#define DRIVE_STEP_H

#include "balance.h"

/* Inner step of length h that ends at `time` [s] after the start of the communication step. It is
 * implicit: its inputs are those at its end. */
static Step step_of(const Component *component, int i, double h, double time) {
    const Joint *joint = &joints[i];
    const double *v = component->v;
    Step step;
    memset(&step, 0, sizeof step);
    step.joint = joint;
    step.k = parameters_of(v, joint);
    step.inertia = v[INERTIA + i];
    step.gear = 1.0 / v[RATIO + i];
    step.stiffness = v[STIFFNESS + i];
    step.damping = v[DAMPING + i];
    step.tau_motor = input_at(component, TAU_MOTOR + i, time);
    step.q_link = mixed_at(component, false, Q_LINK, i, time);
    step.dq_link = mixed_at(component, false, DQ_LINK, i, time);
    step.h = h;
    step.euler = v[DISCRETISATION] == EULER;
    for (int j = 2; j < joint->inputs; j++) {
        if (j == LOAD) {
            step.u[j] = mixed_at(component, true, TAU_LOAD, i, time);
        } else {
            step.u[j] = input_at(component, joint->input[j], time);
        }
    }
    return step;
}

/* Torque [N.m] of the flexspline; see balance.h. */
static double link_torque(const Step *step, const double *u, const double *du, double *slope) {
    *slope += step->stiffness * du[1] + step->damping * du[0];
    return step->stiffness * (u[1] - step->q_link) + step->damping * (u[0] - step->dq_link);
}

#endif
