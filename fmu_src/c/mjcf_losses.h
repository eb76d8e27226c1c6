/* Dry friction of variable level: the `frictionloss` of the instance's own model, set before each
 * step from the result of the previous one.
 *
 *     level = constant + load |torque| + direct ln(1 + |v| / speed) + evolution ln(1 + s / age)
 *     s' = 1 - (|v| / slip + 1 / longest) s
 *
 * The torque is that of the carrier's springs and its gravity compensation. */
#ifndef MJCF_LOSSES_H
#define MJCF_LOSSES_H

#include <math.h>

#include "mujoco_library.h"
#include "signals.h"

/* A joint with zero friction is absent from MuJoCo's constraints. */
static const double LEAST_LEVEL = 1e-9;

static double level_of(const Loss *loss, const mjData *d, double age) {
    double load = 0.0;
    if (loss->carrier >= 0) {
        load = d->qfrc_spring[loss->carrier] + d->qfrc_gravcomp[loss->carrier];
    }
    return loss->constant + loss->load * fabs(load) +
           loss->direct * log1p(fabs(d->qvel[loss->dof]) / loss->speed) +
           loss->evolution * log1p(age / loss->age);
}

/* Exact for a constant speed over the step. */
static double age_after(const Loss *loss, const mjData *d, double age, double step) {
    const double rate = fabs(d->qvel[loss->dof]) / loss->slip + 1.0 / loss->longest;
    return age * exp(-rate * step) - expm1(-rate * step) / rate;
}

static void set_levels(mjModel *m, const double *levels, double scale) {
    for (int i = 0; i < LOSSES; i++) {
        m->dof_frictionloss[losses[i].dof] = fmax(scale * levels[i], LEAST_LEVEL);
    }
}

/* Torque that opposes the motion, at the instant evaluated last. */
static double lost_torque(const Loss *loss, const mjModel *m, const mjData *d) {
    return m->dof_damping[loss->dof] * d->qvel[loss->dof] - d->qfrc_constraint[loss->dof];
}

#endif
