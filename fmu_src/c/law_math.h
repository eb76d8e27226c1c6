/* Functions that generated equations use beside those of math.h. */
#ifndef LAW_MATH_H
#define LAW_MATH_H

#include <math.h>

/* Below this the series of share is exact to double precision and the quotient is not; the same
 * number as in hesr_model.equations.functions. */
#define SHARE_SERIES_BELOW 1e-3

static inline double sgn(double x) {
    return (double)((x > 0.0) - (x < 0.0));
}

static inline double square(double x) {
    return x * x;
}

static inline double cube(double x) {
    return x * x * x;
}

/* max(x, 0), 0 for what is not a number. */
static inline double positive(double x) {
    return x > 0.0 ? x : 0.0;
}

static inline double exceeds(double a, double b) {
    return a > b ? 1.0 : 0.0;
}

/* x between -b and b. */
static inline double clip(double x, double b) {
    return fmin(fmax(x, -b), b);
}

/* a / b for b > 0. */
static inline double over(double a, double b, double otherwise) {
    return b > 0.0 ? a / b : otherwise;
}

/* exp(-z) - 1, by which a state falls over a step; -z by Euler's. */
static inline double decay(double z, double euler) {
    return euler > 0.0 ? -z : expm1(-z);
}

/* (1 - exp(-z)) / z, continued by 1 at 0; e is decay(z, euler). */
static inline double share(double z, double e, double euler) {
    if (euler > 0.0) {
        return 1.0;
    }
    if (fabs(z) < SHARE_SERIES_BELOW) {
        return 1.0 - z / 2.0 * (1.0 - z / 3.0 * (1.0 - z / 4.0 * (1.0 - z / 5.0)));
    }
    return -e / z;
}

/* Derivative of share by z. */
static inline double share_slope(double z, double e, double euler) {
    if (euler > 0.0) {
        return 0.0;
    }
    if (fabs(z) < SHARE_SERIES_BELOW) {
        return -1.0 / 2.0 + z * (1.0 / 3.0 - z * (1.0 / 8.0 - z * (1.0 / 30.0 - z / 144.0)));
    }
    return (1.0 + e + e / z) / z;
}

/* sin(x) / x, continued by 1 at 0. */
static inline double cardinal_sine(double x) {
    if (fabs(x) < SHARE_SERIES_BELOW) {
        return 1.0 - x * x / 6.0 * (1.0 - x * x / 20.0);
    }
    return sin(x) / x;
}

/* Its derivative. */
static inline double cardinal_slope(double x) {
    if (fabs(x) < SHARE_SERIES_BELOW) {
        return -x / 3.0 * (1.0 - x * x / 10.0);
    }
    return (cos(x) - cardinal_sine(x)) / x;
}

#endif
