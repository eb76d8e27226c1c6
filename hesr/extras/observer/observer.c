/* Component: external torque of a robot, by an observer of its generalised momentum M(q) dq.
 *
 *     (M dq)' = tau_motor - friction - b(q, dq) + M' dq + tau_ext,  r' = K (tau_ext - r)
 *
 * r is the estimate. Between two samples M dq and M' dq need no accelerations and derivatives, for
 *
 *     M+ dq+ - M dq - (M+ - M) (dq+ + dq) / 2 = (M+ + M) (dq+ - dq) / 2
 *
 * Other torques are means of both samples, and the low pass is exact, hence stable at any step. The
 * squares of half-widths pass it as well. De Luca and Mattone, ICRA (2005). */
#include <math.h>
#include <string.h>

#include "component_alone.h"
#include "component_plain.h"
#include "coupling.h"
#include "equations.h"

/* Own memory: whether initialisation has ended; of the last sample mass matrix, speeds, and torques
 * other than inertial and external ones; filtered inertial torques and squares of half-widths;
 * parameters of dynamics.h. */
enum { STARTED = 0 };
enum { MASS = 1 };
enum { SPEED = MASS + JOINTS * JOINTS };
enum { OTHERS = SPEED + JOINTS };
enum { INERTIAL = OTHERS + JOINTS };
enum { SQUARE = INERTIAL + JOINTS };
enum { TABLE = SQUARE + JOINTS };

#include "jacobian.h"
#include "regroup.h"

#include "band.h"
#include "warmth.h"

/* Half-width at 95 % in standard deviations. */
#define DEVIATIONS 1.96

/* Standard deviation of force and moment in a direction that a singular posture hides [N, N.m]. */
#define UNKNOWN 1e4

/* Smallest square of a half-width [N2.m2] in the weights of joints, which divide by it. */
#define MIN_SQUARE 1e-12

#define TWO_PI 6.283185307179586

/* Force and moment on the flange. */
enum { WRENCH = 6 };

/* Fill the inputs u of the law of joint i and return its coefficients.
 *
 * With a temperature, the inputs after those of the motion are scales of friction. */
static const double *read_law(const double *v, int i, double *u) {
    const Joint *joint = &joints[i];
    const bool is_thermal = TEMPERATURE != CONTACT;
    double factors[2] = {1.0, 1.0}; /* on Coulomb and viscous friction */
    if (is_thermal) {
        find_warmth(v, i, factors);
    }
    for (int j = 0; j < joint->inputs; j++) {
        u[j] = input_of(v, i, j);
        if (is_thermal && j >= MIXED) {
            const bool is_viscous = joint->input[j] == VISCOUS_SCALE + i;
            u[j] *= factors[is_viscous];
        }
    }
    return joint->constants ? joint->constants : &v[joint->first_parameter];
}

/* Move the states of the law of joint i over a step [s] and return its torque [N.m]. A step of 0
 * sets them to their start first. */
static double step_friction(double *v, int i, double step) {
    static const double no_rates[MAX_INPUTS] = {0.0}; /* of the inputs: its slopes are not used */
    const Joint *joint = &joints[i];
    double u[MAX_INPUTS];
    double next_states[MAX_STATES];
    double torque[MAX_OUTPUTS];
    double slope[MAX_OUTPUTS];
    const double *coefficients = read_law(v, i, u);
    double *x = &v[joint->first_state];
    const size_t size = (size_t)joint->states * sizeof *x;
    if (step == 0.0) {
        memcpy(x, &v[joint->first_start], size);
        if (joint->states > 0 && v[START_MODE] == STEADY) {
            joint->begin(coefficients, u, x);
        }
    }
    joint->attempt(coefficients, u, x, step, v[DISCRETISATION] == EULER, no_rates, next_states,
                   torque, slope);
    memcpy(x, next_states, size);
    return torque[0];
}

/* Invert a symmetric positive definite matrix in place by sweeps, which need no pivot search. */
static void invert(double a[WRENCH][WRENCH]) {
    for (int k = 0; k < WRENCH; k++) {
        const double pivot = a[k][k];
        for (int row = 0; row < WRENCH; row++) {
            for (int column = 0; column < WRENCH; column++) {
                if (row != k && column != k) {
                    a[row][column] -= a[row][k] * a[k][column] / pivot;
                }
            }
        }
        for (int i = 0; i < WRENCH; i++) {
            if (i != k) {
                a[i][k] = -a[i][k] / pivot;
                a[k][i] = a[k][i] / pivot;
            }
        }
        a[k][k] = 1.0 / pivot;
    }
}

/* Put force [N] and moment [N.m] on the flange and their covariances, from the squares of the
 * joints' half-widths [N2.m2]: weighted least squares of tau_ext = J' (force, moment). */
static void put_wrench(double *v, const double *squares) {
    double jacobian[WRENCH][JOINTS];
    double covariance[WRENCH][WRENCH]; /* first its inverse, the information of the joints */
    double projection[WRENCH] = {0.0}; /* J W tau_ext */
    flange_jacobian(&v[Q], jacobian);
    for (int a = 0; a < WRENCH; a++) {
        for (int b = 0; b < WRENCH; b++) {
            covariance[a][b] = 0.0;
        }
        covariance[a][a] = 1.0 / (UNKNOWN * UNKNOWN);
        for (int i = 0; i < JOINTS; i++) {
            const double weight = DEVIATIONS * DEVIATIONS / fmax(squares[i], MIN_SQUARE);
            for (int b = 0; b < WRENCH; b++) {
                covariance[a][b] += jacobian[a][i] * weight * jacobian[b][i];
            }
            projection[a] += jacobian[a][i] * weight * v[TAU_EXT + i];
        }
    }
    invert(covariance);
    for (int a = 0; a < 3; a++) {
        for (int b = 0; b < 3; b++) {
            v[FORCE_COVARIANCE + 3 * a + b] = covariance[a][b];
            v[MOMENT_COVARIANCE + 3 * a + b] = covariance[a + 3][b + 3];
            v[FORCE_MOMENT_COVARIANCE + 3 * a + b] = covariance[a][b + 3];
        }
    }
    for (int a = 0; a < WRENCH; a++) {
        double *element = a < 3 ? &v[FORCE + a] : &v[MOMENT + a - 3];
        *element = 0.0;
        for (int b = 0; b < WRENCH; b++) {
            *element += covariance[a][b] * projection[b];
        }
    }
}

/* Put limits and thresholds [N.m] of the external torques, whether one is beyond its threshold,
 * and the wrench of an arm that shows it. */
static void put_limits(Component *component) {
    double *v = component->v;
    v[CONTACT] = 0.0;
    for (int i = 0; i < JOINTS; i++) {
        const double half_width = sqrt(component->own[SQUARE + i]);
        v[TAU_EXT_LOWER + i] = v[TAU_EXT + i] - half_width;
        v[TAU_EXT_UPPER + i] = v[TAU_EXT + i] + half_width;
        v[CONTACT_THRESHOLD + i] = v[CONTACT_FACTOR] * half_width;
        if (fabs(v[TAU_EXT + i]) > v[CONTACT_THRESHOLD + i]) {
            v[CONTACT] = 1.0;
        }
    }
    if (FORCE != CONTACT) {
        put_wrench(v, &component->own[SQUARE]);
    }
}

/* Return the inertial torque [N.m] of joint i over a step [s]: (M+ + M) (dq+ - dq) / 2 per step.
 * Both mass matrices have their lower triangles only. */
static double find_inertial_torque(const Component *component, double mass[JOINTS][JOINTS], int i,
                                   double step) {
    const double *v = component->v;
    const double *own = component->own;
    double torque = 0.0;
    for (int j = 0; j < JOINTS; j++) {
        const int row = i < j ? j : i;
        const int column = i < j ? i : j;
        const double last_mass = own[MASS + row * JOINTS + column];
        const double change = v[DQ + j] - own[SPEED + j];
        torque += 0.5 * (mass[row][column] + last_mass) * change / step;
    }
    return torque;
}

/* Observe the sample in the inputs after a step [s]; a step of 0 is the first one. */
static void observe_sample(Component *component, double step) {
    double *v = component->v;
    double *own = component->own;
    double mass[JOINTS][JOINTS];
    double bias[JOINTS];
    double inertial[JOINTS];
    const bool begins = step == 0.0;
    /* The low pass is exact for inputs that are held over the step. */
    const double share = begins ? 1.0 : -expm1(-TWO_PI * v[BANDWIDTH] * step);
    if (begins || component->changed != 0.0) {
        regroup(component);
    }
    dynamics(&own[TABLE], &v[ROTORS], &v[SPRINGS], &v[GRAVITY], &v[Q], &v[DQ], mass, bias);
    for (int i = 0; i < JOINTS; i++) {
        inertial[i] = begins ? 0.0 : find_inertial_torque(component, mass, i, step);
        own[INERTIAL + i] += share * (inertial[i] - own[INERTIAL + i]);
        v[TAU_LOAD + i] = bias[i] + own[INERTIAL + i];
        v[TAU_FRICTION + i] = 0.0;
    }
    /* After all loads: a coupled law mixes those of several joints. */
    for (int i = 0; i < JOINTS; i++) {
        add_torque(v, TAU_FRICTION, i, step_friction(v, i, step));
    }
    for (int i = 0; i < JOINTS; i++) {
        const double motor = v[TORQUE_CONSTANT + i] * v[TAU_MOTOR + i];
        const double others = bias[i] + v[TAU_FRICTION + i] - motor;
        const double external = inertial[i] + 0.5 * (others + own[OTHERS + i]);
        double half_squared;
        find_half_squared(v, i, &half_squared);
        v[TAU_EXT + i] = begins ? 0.0 : v[TAU_EXT + i] + share * (external - v[TAU_EXT + i]);
        own[OTHERS + i] = others;
        own[SQUARE + i] += share * (half_squared - own[SQUARE + i]);
    }
    memcpy(&own[SPEED], &v[DQ], JOINTS * sizeof *v);
    memcpy(&own[MASS], mass, sizeof mass);
    put_limits(component);
}

/* Start with the first sample. */
static bool component_initialise(Component *component, void *workspace, Message *why) {
    (void)workspace;
    (void)why;
    observe_sample(component, 0.0);
    component->own[STARTED] = 1.0;
    return true;
}

/* Put the outputs, and the derivatives of the states. Before the first step, outputs follow the
 * inputs; then they are those of the last step. */
static bool component_output(Component *component, void *workspace, Message *why) {
    (void)workspace;
    (void)why;
    if (component->own[STARTED] == 0.0) {
        observe_sample(component, 0.0);
    }
    for (int i = 0; i < JOINTS; i++) {
        double u[MAX_INPUTS];
        const double *coefficients = read_law(component->v, i, u);
        double *x = &component->v[joints[i].first_state];
        joints[i].solved_derivatives(coefficients, u, x, x + joints[i].states);
    }
    return true;
}

/* Observe the sample after a step [s]. */
static bool component_step(Component *component, void *workspace, double step, Message *why) {
    (void)workspace;
    (void)why;
    observe_sample(component, step);
    return true;
}
