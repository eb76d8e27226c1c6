/* Joints moved together by motors: equations belong to coordinates, variables to joints.
 *
 *     u = C q,  du = C dq,  tau_u = C'^-1 tau_q;  tau_q = C' tau_u
 *
 * The generated equations.h defines C as `forward` and C'^-1 as `backward`. Without a coupling,
 * coordinate i is joint i. */
#ifndef COUPLING_H
#define COUPLING_H

#include "component.h"
#include "equations.h"

/* Inputs of a joint that a coupling mixes: velocity, position and load torque. */
enum { LOAD = 2, MIXED = 3 };

/* Coefficients of a joint's law. */
static inline const double *parameters_of(const double *v, const Joint *joint) {
    return joint->constants ? joint->constants : &v[joint->first_parameter];
}

/* Whether an explicit Euler step is short enough for the rates of a joint's states at a speed, a
 * variable and its value. */
static inline bool is_stable(const Joint *joint, const double *rate, double step, int speed,
                             double value, Message *why) {
    for (int j = 0; j < joint->states; j++) {
        if (!(rate[j] * step < 1.0)) {
            return deny(why,
                        "%s: Euler needs rate * step < 1 but found %g at %s = %g; take a smaller "
                        "step or the exact discretisation.",
                        variables[joint->first_state + j].name, rate[j] * step,
                        variables[speed].name, value);
        }
    }
    return true;
}

/* Coefficient of joint m in coordinate i, of a torque or of a motion. */
static inline double share_of(bool torque, int i, int m) {
    return torque ? backward[i][m] : forward[i][m];
}

/* Input j of coordinate i, mixed from the joints. */
static inline double input_of(const double *v, int i, int j) {
    double sum = 0.0;
    if (!COUPLED || j >= MIXED) {
        return v[joints[i].input[j]];
    }
    for (int m = 0; m < JOINTS; m++) {
        sum += share_of(j == LOAD, i, m) * v[joints[m].input[j]];
    }
    return sum;
}

/* Add a torque of coordinate i to those of the joints in a vector of variables. */
static inline void add_torque(double *v, int vector, int i, double torque) {
    for (int m = 0; m < JOINTS; m++) {
        const double share = COUPLED ? forward[i][m] : (double)(i == m);
        v[vector + m] += share * torque;
    }
}

/* Clear the torques and bands of joints, to which coordinates add theirs. */
static inline void clear_torques(double *v) {
    for (int m = 0; COUPLED && m < JOINTS; m++) {
        v[joints[m].output[0]] = 0.0;
        for (int end = 0; BAND > 0 && end < 2; end++) {
            v[joints[m].output[BAND + end]] = 0.0;
        }
    }
}

/* Store the outputs y of coordinate i in the values v; the first is a torque. Those of a band are
 * squares of distances from it, which add until put_ends. */
static inline void put_outputs(double *v, int i, const double *y) {
    for (int m = 0; COUPLED && m < JOINTS; m++) {
        v[joints[m].output[0]] += forward[i][m] * y[0];
        for (int end = 0; BAND > 0 && end < 2; end++) {
            /* A negative coefficient exchanges the ends. */
            const int source = forward[i][m] < 0.0 ? 1 - end : end;
            const double square = y[BAND + source];
            v[joints[m].output[BAND + end]] += forward[i][m] * forward[i][m] * square;
        }
    }
    for (int j = COUPLED ? 1 : 0; j < joints[i].outputs; j++) {
        if (!(COUPLED && BAND > 0) || j < BAND || j > BAND + 1) {
            v[joints[i].output[j]] = y[j];
        }
    }
}

/* Replace the sums of squares by the ends of the bands of joints, or, of derivatives `to`, by those
 * of the ends v. */
static inline void put_ends(const double *v, double *to) {
    for (int m = 0; COUPLED && BAND > 0 && m < JOINTS; m++) {
        const int *output = joints[m].output;
        for (int end = 0; end < 2; end++) {
            double *limit = &to[output[BAND + end]];
            const double width = fabs(v[output[BAND + end]] - v[output[0]]);
            double distance = 0.0;
            if (v == to) {
                distance = sqrt(*limit);
            } else if (width > 0.0) { /* derivative of the root */
                distance = *limit / (2.0 * width);
            }
            *limit = to[output[0]] + (end ? distance : -distance);
        }
    }
}

#endif
