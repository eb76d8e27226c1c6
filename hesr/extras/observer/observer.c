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

/* Own memory: whether initialisation has ended; mass matrix, speeds and other torques of the last
 * sample; filtered inertial torques and squares of half-widths; parameters of dynamics.h. */
enum { STARTED = 0, MASS = 1, SPEED = MASS + JOINTS * JOINTS, OTHERS = SPEED + JOINTS };
enum { INERTIAL = OTHERS + JOINTS, SQUARE = INERTIAL + JOINTS, TABLE = SQUARE + JOINTS };

#include "jacobian.h"
#include "regroup.h"

#include "band.h"
#include "warmth.h"

#define DEVIATIONS 1.96   /* half-width at 95 % in standard deviations */

/* Standard deviation of force and moment in a direction that a singular posture hides [N, N.m]. */
#define UNKNOWN 1e4

/* Fill the inputs of a law and return its coefficients. */
static const double *see_law(const double *v, int i, double *u) {
    const bool is_thermal = TEMPERATURE != CONTACT;
    double factors[2] = {1.0, 1.0}; /* on Coulomb and viscous friction */
    if (is_thermal) {
        find_warmth(v, i, factors);
    }
    for (int j = 0; j < joints[i].inputs; j++) {
        u[j] = input_of(v, i, j);
        if (is_thermal && j >= MIXED) {
            u[j] *= factors[joints[i].input[j] == VISCOUS_SCALE + i];
        }
    }
    return joints[i].constants ? joints[i].constants : &v[joints[i].first_parameter];
}

static double friction(double *v, int i, double step) {
    static const double still[MAX_INPUTS] = {0.0};
    const Joint *joint = &joints[i];
    double u[MAX_INPUTS], moved[MAX_STATES], torque[MAX_OUTPUTS], slope[MAX_OUTPUTS];
    const double *k = see_law(v, i, u);
    double *x = &v[joint->first_state];
    if (step == 0.0) {
        memcpy(x, &v[joint->first_start], (size_t)joint->states * sizeof *x);
        if (joint->states > 0 && v[START_MODE] == STEADY) {
            joint->begin(k, u, x);
        }
    }
    joint->attempt(k, u, x, step, v[DISCRETISATION] == EULER, still, moved, torque, slope);
    memcpy(x, moved, (size_t)joint->states * sizeof *x);
    return torque[0];
}

/* Invert a symmetric positive definite matrix by sweeps, without pivots. */
static void invert(double a[6][6]) {
    for (int k = 0; k < 6; k++) {
        const double pivot = a[k][k];
        for (int i = 0; i < 36; i++) {
            const int row = i / 6, column = i % 6;
            if (row != k && column != k) {
                a[row][column] -= a[row][k] * a[k][column] / pivot;
            }
        }
        for (int i = 0; i < 6; i++) {
            a[i][k] = i == k ? 1.0 / pivot : -a[i][k] / pivot;
            a[k][i] = i == k ? a[k][k] : a[k][i] / pivot;
        }
    }
}

/* Weighted least squares of tau_ext = J' (force, moment). */
static void put_wrench(double *v, const double *squares) {
    double jacobian[6][JOINTS], covariance[6][6], sum[6] = {0.0};
    flange_jacobian(&v[Q], jacobian);
    for (int a = 0; a < 6; a++) {
        for (int b = 0; b < 6; b++) {
            covariance[a][b] = a == b ? 1.0 / (UNKNOWN * UNKNOWN) : 0.0;
            for (int i = 0; i < JOINTS; i++) {
                const double weight = DEVIATIONS * DEVIATIONS / fmax(squares[i], 1e-12);
                covariance[a][b] += jacobian[a][i] * weight * jacobian[b][i];
                sum[a] += b == 0 ? jacobian[a][i] * weight * v[TAU_EXT + i] : 0.0;
            }
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
    for (int a = 0; a < 6; a++) {
        double *one = a < 3 ? &v[FORCE + a] : &v[MOMENT + a - 3];
        *one = 0.0;
        for (int b = 0; b < 6; b++) {
            *one += covariance[a][b] * sum[b];
        }
    }
}

static void put_limits(Component *component) {
    double *v = component->v;
    v[CONTACT] = 0.0;
    for (int i = 0; i < JOINTS; i++) {
        const double half = sqrt(component->own[SQUARE + i]);
        v[TAU_EXT_LOWER + i] = v[TAU_EXT + i] - half;
        v[TAU_EXT_UPPER + i] = v[TAU_EXT + i] + half;
        v[CONTACT_THRESHOLD + i] = v[CONTACT_FACTOR] * half;
        if (fabs(v[TAU_EXT + i]) > v[CONTACT_THRESHOLD + i]) {
            v[CONTACT] = 1.0;
        }
    }
    if (FORCE != CONTACT) {
        put_wrench(v, &component->own[SQUARE]);
    }
}

/* Observe the sample in the inputs; a step of 0 is the first one. */
static void observe_sample(Component *component, double step) {
    double *v = component->v, *own = component->own;
    double mass[JOINTS][JOINTS], bias[JOINTS], moving[JOINTS];
    const bool begins = step == 0.0;
    const double share = begins ? 1.0 : -expm1(-6.283185307179586 * v[BANDWIDTH] * step);
    if (begins || component->changed != 0.0) {
        regroup(component);
    }
    dynamics(&own[TABLE], &v[ROTORS], &v[SPRINGS], &v[GRAVITY], &v[Q], &v[DQ], mass, bias);
    for (int i = 0; i < JOINTS; i++) {
        double inertial = 0.0;
        for (int j = 0; j < JOINTS && !begins; j++) {
            const double now = i < j ? mass[j][i] : mass[i][j];
            const double before = own[MASS + (i < j ? j * JOINTS + i : i * JOINTS + j)];
            inertial += 0.5 * (now + before) * (v[DQ + j] - own[SPEED + j]) / step;
        }
        own[INERTIAL + i] += share * (inertial - own[INERTIAL + i]);
        v[TAU_LOAD + i] = bias[i] + own[INERTIAL + i];
        v[TAU_FRICTION + i] = 0.0;
        moving[i] = inertial;
    }
    for (int i = 0; i < JOINTS; i++) {
        add_torque(v, TAU_FRICTION, i, friction(v, i, step));
    }
    for (int i = 0; i < JOINTS; i++) {
        const double rest =
            bias[i] + v[TAU_FRICTION + i] - v[TORQUE_CONSTANT + i] * v[TAU_MOTOR + i];
        const double external = moving[i] + 0.5 * (rest + own[OTHERS + i]);
        v[TAU_EXT + i] = begins ? 0.0 : v[TAU_EXT + i] + share * (external - v[TAU_EXT + i]);
        double half_squared;
        find_half_squared(v, i, &half_squared);
        own[OTHERS + i] = rest;
        own[SQUARE + i] += share * (half_squared - own[SQUARE + i]);
    }
    memcpy(&own[SPEED], &v[DQ], JOINTS * sizeof *v);
    memcpy(&own[MASS], mass, sizeof mass);
    put_limits(component);
}

static bool component_initialise(Component *component, void *workspace, Message *why) {
    (void)workspace, (void)why;
    observe_sample(component, 0.0);
    component->own[STARTED] = 1.0;
    return true;
}

/* Before the first step, outputs follow the inputs; then they are those of the last step. */
static bool component_output(Component *component, void *workspace, Message *why) {
    (void)workspace, (void)why;
    if (component->own[STARTED] == 0.0) {
        observe_sample(component, 0.0);
    }
    for (int i = 0; i < JOINTS; i++) {
        double u[MAX_INPUTS], *v = component->v, *x = &v[joints[i].first_state];
        const double *k = see_law(v, i, u);
        joints[i].solved_derivatives(k, u, x, x + joints[i].states);
    }
    return true;
}

static bool component_step(Component *component, void *workspace, double step, Message *why) {
    (void)workspace, (void)why;
    observe_sample(component, step);
    return true;
}
