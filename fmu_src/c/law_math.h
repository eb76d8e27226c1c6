/* Functions that the generated laws use beside those of math.h. */
#ifndef LAW_MATH_H
#define LAW_MATH_H

#include <math.h>

static inline double sgn(double x) {
    return (double)((x > 0.0) - (x < 0.0));
}

static inline double square(double x) {
    return x * x;
}

static inline double cube(double x) {
    return x * x * x;
}

#endif
