/* One step of x' = b - r x with b and r held, and its derivative. */
#ifndef RELAX_H
#define RELAX_H

#include <math.h>
#include <stdbool.h>
#include <stdio.h>

#include "component.h"

/* Below this the series of phi is exact to double precision and the quotient is not; the same
 * number as in hesr_model.friction.evaluate. */
#define PHI_SERIES_BELOW 1e-3

/* (1 - exp(-z)) / z, continued by phi(0) = 1; e is expm1(-z). */
static double phi(double z, double e) {
    if (fabs(z) < PHI_SERIES_BELOW) {
        return 1.0 - z / 2.0 * (1.0 - z / 3.0 * (1.0 - z / 4.0 * (1.0 - z / 5.0)));
    }
    return -e / z;
}

static double derivative_of_phi(double z, double e) {
    if (fabs(z) < PHI_SERIES_BELOW) {
        return -1.0 / 2.0 + z * (1.0 / 3.0 - z * (1.0 / 8.0 - z * (1.0 / 30.0 - z / 144.0)));
    }
    return (1.0 + e - phi(z, e)) / z;
}

/* What a rate makes of a step. */
typedef struct {
    double dt;    /* [s] */
    double z;     /* rate times dt */
    double e;     /* expm1(-z) */
    double left;  /* share of the state */
    double taken; /* share of the drive times dt */
    bool euler;
} Decay;

/* Exactly, or by an Euler step (eq. 10). */
static Decay decay(double r, double dt, bool euler) {
    const double z = r * dt;
    if (euler) {
        return (Decay){.dt = dt, .z = z, .left = 1.0 - z, .taken = 1.0, .euler = true};
    }
    const double e = expm1(-z);
    return (Decay){.dt = dt, .z = z, .e = e, .left = 1.0 + e, .taken = phi(z, e)};
}

/* The state after a step. */
static double relax(double x, double b, const Decay *over) {
    return over->left * x + b * over->dt * over->taken;
}

/* Derivative of a state that a step has just reached with respect to what its drive and rate depend
 * on; what is left of the state before the step is recovered from the one after it. */
static double tangent_of_relax(double x, double b, double db, double dr, const Decay *over) {
    const double dt = over->dt, dz = dr * dt;
    const double left = x - b * dt * over->taken;
    const double fades =
        over->euler ? left / over->left : left - b * dt * derivative_of_phi(over->z, over->e);
    return db * dt * over->taken - fades * dz;
}

/* Whether a state can move by a step; the message says at which speed it cannot. */
static bool can_relax(const char *state, double rate, double step, bool euler, const char *speed,
                      double at, Message *why) {
    const double z = rate * step;
    if (!(z >= 0.0)) {
        snprintf(why->text, sizeof why->text,
                 "%s: the relaxation rate is %g 1/s at %s = %g; it must not be negative.", state,
                 rate, speed, at);
        return false;
    }
    if (euler && !(z < 1.0)) {
        snprintf(why->text, sizeof why->text,
                 "%s: Euler needs rate * step < 1 but found %g at %s = %g; take a smaller "
                 "step or the exact discretisation.",
                 state, z, speed, at);
        return false;
    }
    return true;
}

#endif
