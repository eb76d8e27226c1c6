/* Parameters of an MJCF's FMU: their valid values and their effect on the model. */
#ifndef MJCF_PARAMETERS_H
#define MJCF_PARAMETERS_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>

#include "component.h"
#include "mujoco_library.h"
#include "signals.h"

/* How parameters change the model: factor on friction, payload [kg], latency [s]. */
typedef struct {
    double scale;
    double payload;
    double latency;
} Changes;

/* Value of a variable that the FMU may lack. */
static double value_or(const double *v, int place, double otherwise) {
    return place >= 0 ? v[place] : otherwise;
}

/* Changes by the parameters in the values v. */
static Changes changes_of(const double *v) {
    const Changes changes = {value_or(v, FRICTION_SCALE, 1.0), value_or(v, PAYLOAD, 0.0),
                             value_or(v, LATENCY, -1.0)};
    return changes;
}

/* 32 bits of the noise seed, which are a signed integer of FMI. */
static uint64_t seed_half(const double *v, int half) {
    return NOISE_SEED >= 0 ? (uint32_t)(int32_t)v[NOISE_SEED + half] : 0u;
}

/* Whether a parameter that the FMU may lack is not negative. */
static bool not_negative(const double *v, int place, Message *why) {
    return place < 0 || sound(v, place, v[place] >= 0.0, "not be negative", why);
}

/* Whether all parameters are in their ranges. */
static bool parameters_are_usable(const double *v, Message *why) {
    bool usable = not_negative(v, FRICTION_SCALE, why) && not_negative(v, PAYLOAD, why) &&
                  not_negative(v, LATENCY, why);
    for (int i = 0; usable && i < NOISY; i++) {
        usable = not_negative(v, noises[i].sigma, why);
    }
    /* Accumulated time steps have an error of a few bits. */
    if (usable && value_or(v, LATENCY, 0.0) > LONGEST_LATENCY * (1.0 + 1e-9)) {
        return deny(why, "latency is %g s; the model's buffers hold %g s.", v[LATENCY],
                    LONGEST_LATENCY);
    }
    return usable;
}

/* LuGre forces scale with stiffness, damping and levels. Friction scaled to zero keeps a trace,
 * because MuJoCo has no bristles without stiffness. */
static void scale_friction(mjModel *m, int actuator, double wanted) {
    const double scale = fmax(wanted, 1e-9);
    mjtNum *bias = &m->actuator_biasprm[actuator * mjNBIAS];
    mjtNum *dynamics = &m->actuator_dynprm[actuator * mjNDYN];
    bias[0] *= scale; /* amplitude of cogging */
    bias[3] *= scale; /* Coulomb friction */
    bias[4] *= scale; /* static friction */
    dynamics[5] *= scale;
    dynamics[6] *= scale;
    m->actuator_damping[actuator] *= scale;
    for (int i = 0; i < mjNPOLY; i++) {
        m->actuator_dampingpoly[actuator * mjNPOLY + i] *= scale;
    }
}

/* Delay of an actuator for a latency, both in s. Without interpolation a command acts at the first
 * step after the delay. Half a step less protects it from round-off. */
static double delay_of(const mjModel *m, int actuator, double latency) {
    const double steps = ceil(latency / m->opt.timestep - 1e-6);
    const bool interpolated = m->actuator_history[2 * actuator + 1] > 0;
    return interpolated ? latency : fmax(steps - 0.5, 0.0) * m->opt.timestep;
}

#endif
