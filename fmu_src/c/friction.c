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
#include "relax.h"

/* What the component remembers besides its variables. */
enum {
    LAST_STEP = 0, /* length of the last step [s], 0 before the first */
    USED = 1,      /* the inputs that were held over it */
    HELD = USED + JOINTS * INPUTS_OF_JOINT,
};

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

static bool component_step(Component *component, void *workspace, double step, Message *why) {
    const bool euler = component->v[DISCRETISATION] == EULER;
    double drive[JOINTS][MAX_STATES], rate[JOINTS][MAX_STATES];
    (void)workspace;
    for (int i = 0; i < JOINTS; i++) {
        const Place at = place_of(component, i);
        at.joint->relaxations(at.k, at.u, at.s, drive[i], rate[i]);
        for (int j = 0; j < at.joint->states; j++) {
            const char *state = variables[at.joint->first_state + j].name;
            if (!can_relax(state, rate[i][j], step, euler, variables[DQ + i].name, at.u[0], why)) {
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
            const Decay over = decay(rate[i][j], step, euler);
            x[j] = relax(x[j], drive[i][j], &over);
        }
        evaluate(component, i, &at, drive[i], rate[i]);
    }
    return true;
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
            const Decay over = decay(rate[j], step, euler);
            d_x[j] = tangent_of_relax(x[j], drive[j], d_drive[j], d_rate[j], &over);
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
