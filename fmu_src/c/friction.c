/* Component: one friction law for each joint.
 *
 *     x' = drive - rate x,  tau = f(inputs, x, x')        for every joint
 *
 * The generated laws.h defines the functions of the laws and the table `joints`; it says where the
 * inputs, states, coefficients and outputs of a joint stand among the variables.
 */
#include <math.h>
#include <stdio.h>

#include "component.h"
#include "laws.h"

/* Below this the series of phi is exact to double precision and the quotient is not; the same
 * number as in hesr_model.friction.evaluate, which this file equals digit by digit. */
#define PHI_SERIES_BELOW 1e-3

/* (1 - exp(-z)) / z, continued by phi(0) = 1. */
static double phi(double z) {
    if (fabs(z) < PHI_SERIES_BELOW) {
        return 1.0 - z / 2.0 * (1.0 - z / 3.0 * (1.0 - z / 4.0 * (1.0 - z / 5.0)));
    }
    return -expm1(-z) / z;
}

/* Advance x' = b - r x by dt [s] with b and r held: exactly, or by an Euler step (eq. 10). */
static double relax(double x, double b, double r, double dt, bool euler) {
    const double z = r * dt;
    return euler ? (1.0 - z) * x + b * dt : exp(-z) * x + b * dt * phi(z);
}

static bool component_initialise(Component *component, Message *why) {
    (void)component, (void)why; /* states start at their start values */
    return true;
}

static void inputs_of(const Component *component, int joint, double *u) {
    u[0] = component->v[DQ + joint];
    u[1] = component->v[Q + joint];
    u[2] = component->v[TAU_LOAD + joint];
}

static const double *coefficients_of(const Component *component, const Joint *joint) {
    return joint->constants ? joint->constants : &component->v[joint->first_parameter];
}

static bool component_output(Component *component, Message *why) {
    (void)why; /* the glue itself looks for infinite outputs */
    for (int i = 0; i < JOINTS; i++) {
        const Joint *joint = &joints[i];
        const double *k = coefficients_of(component, joint);
        const double *x = &component->v[joint->first_state];
        double *dx = &component->v[joint->first_state + joint->states];
        double u[INPUTS_OF_JOINT], drive[MAX_STATES], rate[MAX_STATES];
        inputs_of(component, i, u);
        joint->relaxations(k, u, drive, rate);
        for (int j = 0; j < joint->states; j++) {
            dx[j] = drive[j] - rate[j] * x[j];
        }
        const double scale = joint->constants ? component->v[joint->first_parameter] : 1.0;
        component->v[TAU + i] = scale * joint->torque(k, u, x, dx);
    }
    return true;
}

static bool component_step(Component *component, double time, double step, Message *why) {
    const bool euler = component->v[DISCRETISATION] == EULER;
    (void)time; /* the laws do not depend on it */
    for (int i = 0; i < JOINTS; i++) {
        const Joint *joint = &joints[i];
        double u[INPUTS_OF_JOINT], drive[MAX_STATES], rate[MAX_STATES];
        inputs_of(component, i, u);
        joint->relaxations(coefficients_of(component, joint), u, drive, rate);
        for (int j = 0; j < joint->states; j++) {
            const int state = joint->first_state + j;
            const double z = rate[j] * step;
            if (!(z >= 0.0)) {
                snprintf(why->text, sizeof why->text,
                         "%s: the relaxation rate is %g 1/s at %s = %g; it must not be negative.",
                         variables[state].name, rate[j], variables[DQ + i].name, u[0]);
                return false;
            }
            if (euler && !(z < 1.0)) {
                snprintf(why->text, sizeof why->text,
                         "%s: Euler needs rate * step < 1 but found %g at %s = %g; take a smaller "
                         "step or the exact discretisation.",
                         variables[state].name, z, variables[DQ + i].name, u[0]);
                return false;
            }
            component->v[state] = relax(component->v[state], drive[j], rate[j], step, euler);
        }
    }
    return true;
}
