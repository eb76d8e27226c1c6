/* Component: one friction law for each joint.
 *
 *     x' = drive - rate x,  tau = f(inputs, x, x')        for every joint
 *
 * The generated laws.h defines the functions of the laws and the table `joints`; it says where the
 * inputs, states, coefficients and outputs of a joint stand among the variables. Signs of inputs,
 * on which some laws jump or bend, are held between events.
 */
#include <math.h>
#include <stdio.h>

#include "component_alone.h"
#include "laws.h"

/* What the component remembers besides its variables. */
enum {
    LAST_STEP = 0, /* length of the last step [s], 0 before the first */
    USED = 1,      /* the inputs that were held over it */
    HELD = USED + JOINTS * INPUTS_OF_JOINT,
};

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

/* Advance x' = b - r x by dt [s] with b and r held: exactly, or by an Euler step (eq. 10). */
static double relax(double x, double b, double r, double dt, bool euler) {
    const double z = r * dt;
    if (euler) {
        return (1.0 - z) * x + b * dt;
    }
    const double e = expm1(-z);
    return (1.0 + e) * x + b * dt * phi(z, e);
}

/* All that a law is evaluated at. */
typedef struct {
    const Joint *joint;
    const double *k; /* coefficients */
    const double *s; /* signs */
    double u[INPUTS_OF_JOINT];
} Place;

static Place place_of(const Component *component, int i) {
    const Joint *joint = &joints[i];
    const double *v = component->v;
    return (Place){
        .joint = joint,
        .k = joint->constants ? joint->constants : &v[joint->first_parameter],
        .s = &component->own[HELD + joint->first_switch],
        .u = {v[DQ + i], v[Q + i], v[TAU_LOAD + i]},
    };
}

static bool component_initialise(Component *component, void *workspace, Message *why) {
    (void)component, (void)workspace, (void)why; /* states start at their start values */
    return true;
}

/* Derivatives of the states and the torque. */
static void evaluate(Component *component, int i, const Place *at, const double *drive,
                     const double *rate) {
    const Joint *joint = at->joint;
    const double *x = &component->v[joint->first_state];
    double *dx = &component->v[joint->first_state + joint->states];
    for (int j = 0; j < joint->states; j++) {
        dx[j] = drive[j] - rate[j] * x[j];
    }
    const double scale = joint->constants ? component->v[joint->first_parameter] : 1.0;
    component->v[TAU + i] = scale * joint->torque(at->k, at->u, at->s, x, dx);
}

static bool component_output(Component *component, void *workspace, Message *why) {
    (void)workspace, (void)why; /* the glue itself looks for infinite outputs */
    for (int i = 0; i < JOINTS; i++) {
        double drive[MAX_STATES], rate[MAX_STATES];
        const Place at = place_of(component, i);
        at.joint->relaxations(at.k, at.u, at.s, drive, rate);
        evaluate(component, i, &at, drive, rate);
    }
    return true;
}

/* Whether a state can move by a step. */
static bool can_move(const Place *at, int joint, int state, double rate, double step, bool euler,
                     Message *why) {
    const double z = rate * step;
    if (!(z >= 0.0)) {
        snprintf(why->text, sizeof why->text,
                 "%s: the relaxation rate is %g 1/s at %s = %g; it must not be negative.",
                 variables[state].name, rate, variables[DQ + joint].name, at->u[0]);
        return false;
    }
    if (euler && !(z < 1.0)) {
        snprintf(why->text, sizeof why->text,
                 "%s: Euler needs rate * step < 1 but found %g at %s = %g; take a smaller "
                 "step or the exact discretisation.",
                 variables[state].name, z, variables[DQ + joint].name, at->u[0]);
        return false;
    }
    return true;
}

static bool component_step(Component *component, void *workspace, double step, Message *why) {
    const bool euler = component->v[DISCRETISATION] == EULER;
    double drive[JOINTS][MAX_STATES], rate[JOINTS][MAX_STATES];
    (void)workspace;
    for (int i = 0; i < JOINTS; i++) {
        const Place at = place_of(component, i);
        at.joint->relaxations(at.k, at.u, at.s, drive[i], rate[i]);
        for (int j = 0; j < at.joint->states; j++) {
            if (!can_move(&at, i, at.joint->first_state + j, rate[i][j], step, euler, why)) {
                return false;
            }
        }
    }
    component->own[LAST_STEP] = step;
    for (int i = 0; i < JOINTS; i++) {
        const Place at = place_of(component, i);
        double *x = &component->v[at.joint->first_state];
        for (int j = 0; j < INPUTS_OF_JOINT; j++) {
            component->own[USED + i * INPUTS_OF_JOINT + j] = at.u[j];
        }
        for (int j = 0; j < at.joint->states; j++) {
            x[j] = relax(x[j], drive[i][j], rate[i][j], step, euler);
        }
        evaluate(component, i, &at, drive[i], rate[i]);
    }
    return true;
}

/* Derivative of a state that a step has just reached with respect to what its drive and rate depend
 * on; the state before the step is recovered from the one after it. */
static double tangent_of_relax(double x, double b, double r, double db, double dr, double dt,
                               bool euler) {
    const double z = r * dt, dz = dr * dt;
    if (euler) {
        return db * dt - (x - b * dt) / (1.0 - z) * dz;
    }
    const double e = expm1(-z);
    return db * dt * phi(z, e) - (x - b * dt * phi(z, e) - b * dt * derivative_of_phi(z, e)) * dz;
}

/* d tau / d dq of a joint, with the states following as they did in the last step. */
static double slope_of_step(const Component *component, int i) {
    const bool euler = component->v[DISCRETISATION] == EULER;
    const double step = component->own[LAST_STEP];
    const Place at = place_of(component, i);
    const Joint *joint = at.joint;
    const double *used = &component->own[USED + i * INPUTS_OF_JOINT];
    const double *x = &component->v[joint->first_state], *dx = x + joint->states;
    const double du[INPUTS_OF_JOINT] = {1.0};
    double drive[MAX_STATES], rate[MAX_STATES], d_drive[MAX_STATES], d_rate[MAX_STATES];
    double d_x[MAX_STATES] = {0.0}, d_dx[MAX_STATES], s[MAX_SWITCHES];
    if (step > 0.0) {
        /* Where inputs had slopes, a sign may since have changed. */
        joint->switches(at.k, used, s);
        for (int j = 0; j < joint->switches_of_joint; j++) {
            s[j] = sgn(s[j]);
        }
        joint->relaxations(at.k, used, s, drive, rate);
        joint->relaxations_tangent(at.k, used, s, no_change, du, d_drive, d_rate);
        for (int j = 0; j < joint->states; j++) {
            d_x[j] = tangent_of_relax(x[j], drive[j], rate[j], d_drive[j], d_rate[j], step, euler);
        }
    }
    joint->relaxations(at.k, at.u, at.s, drive, rate);
    joint->relaxations_tangent(at.k, at.u, at.s, no_change, du, d_drive, d_rate);
    for (int j = 0; j < joint->states; j++) {
        d_dx[j] = d_drive[j] - d_rate[j] * x[j] - rate[j] * d_x[j];
    }
    const double scale = joint->constants ? component->v[joint->first_parameter] : 1.0;
    return scale * joint->torque_tangent(at.k, at.u, at.s, x, dx, no_change, du, d_x, d_dx);
}

static void component_demand(Component *component) {
    for (int i = 0; i < JOINTS; i++) {
        component->v[DTAU_DDQ + i] = slope_of_step(component, i);
    }
}

static bool component_event(Component *component, double rest, Message *what) {
    bool changed = false;
    for (int i = 0; i < JOINTS; i++) {
        double z[MAX_SWITCHES];
        const Place at = place_of(component, i);
        double *held = &component->own[HELD + at.joint->first_switch];
        at.joint->switches(at.k, at.u, z);
        for (int j = 0; j < at.joint->switches_of_joint; j++) {
            const double sign = fabs(z[j]) < rest ? 0.0 : sgn(z[j]);
            if (what && sign != held[j]) {
                snprintf(what->text, sizeof what->text, "The sign of %s of joint %d becomes %g.",
                         at.joint->names[j], i + 1, sign);
            }
            changed = changed || sign != held[j];
            held[j] = sign;
        }
    }
    return changed;
}

static void component_indicators(const Component *component, double rest, double *indicator) {
    for (int i = 0; i < JOINTS; i++) {
        double z[MAX_SWITCHES];
        const Place at = place_of(component, i);
        at.joint->switches(at.k, at.u, z);
        for (int j = 0; j < at.joint->switches_of_joint; j++) {
            *indicator++ = at.s[j] != 0.0 ? at.s[j] * z[j] : rest - fabs(z[j]);
        }
    }
}

static void component_tangent(const Component *component, const double *seed, double *tangent) {
    for (int i = 0; i < JOINTS; i++) {
        const Place at = place_of(component, i);
        const Joint *joint = at.joint;
        const double *x = &component->v[joint->first_state], *dx = x + joint->states;
        const double *d_x = &seed[joint->first_state];
        const double *dk = joint->constants ? no_change : &seed[joint->first_parameter];
        const double du[] = {seed[DQ + i], seed[Q + i], seed[TAU_LOAD + i]};
        double *d_dx = &tangent[joint->first_state + joint->states];
        double drive[MAX_STATES], rate[MAX_STATES], d_drive[MAX_STATES], d_rate[MAX_STATES];
        joint->relaxations(at.k, at.u, at.s, drive, rate);
        joint->relaxations_tangent(at.k, at.u, at.s, dk, du, d_drive, d_rate);
        for (int j = 0; j < joint->states; j++) {
            d_dx[j] = d_drive[j] - d_rate[j] * x[j] - rate[j] * d_x[j];
        }
        double change = joint->torque_tangent(at.k, at.u, at.s, x, dx, dk, du, d_x, d_dx);
        if (joint->constants) {
            change = component->v[joint->first_parameter] * change +
                     seed[joint->first_parameter] * joint->torque(at.k, at.u, at.s, x, dx);
        }
        tangent[TAU + i] = change;
    }
}
