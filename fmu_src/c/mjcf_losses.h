/* Dry friction of variable level: the `frictionloss` of the instance's own model, set before each
 * step from the result of the previous one; fmu_src/arm/losses.py has the equations. */
#ifndef MJCF_LOSSES_H
#define MJCF_LOSSES_H

#include <math.h>

#include "losses.h"
#include "mujoco_library.h"
#include "signals.h"

/* A joint with zero friction is absent from MuJoCo's constraints. */
static const double LEAST_LEVEL = 1e-9;

/* Level of a loss [N.m] at an age [s], at the instant evaluated last. */
static double level_of(const Loss *loss, const mjData *d, double age) {
    double torque = 0.0;
    if (loss->carrier >= 0) {
        torque = d->qfrc_spring[loss->carrier] + d->qfrc_gravcomp[loss->carrier];
    }
    double level;
    find_level(loss, torque, d->qvel[loss->dof], age, &level);
    return level;
}

/* Age of a loss [s] after a step [s]. */
static double age_after(const Loss *loss, const mjData *d, double age, double step) {
    double aged;
    find_age(loss, d->qvel[loss->dof], age, step, &aged);
    return aged;
}

/* Write levels [N.m], times a factor, into the model. */
static void set_levels(mjModel *m, const double *levels, double scale) {
    for (int i = 0; i < LOSSES; i++) {
        m->dof_frictionloss[losses[i].dof] = fmax(scale * levels[i], LEAST_LEVEL);
    }
}

/* Torque [N.m] that opposes the motion, at the instant evaluated last. */
static double lost_torque(const Loss *loss, const mjModel *m, const mjData *d) {
    return m->dof_damping[loss->dof] * d->qvel[loss->dof] - d->qfrc_constraint[loss->dof];
}

#endif
