/* Functions of the generated equations, branch-free for vectorised loops, with identical bits on
 * every IEEE 754 machine for any compiler, C library and vector width. Elementary functions are
 * within a relative error of 1e-15, sin and cos within 1e-15 absolutely. */
#ifndef LAW_MATH_H
#define LAW_MATH_H

#include <stdbool.h>
#include <stdint.h>

#ifdef WITHOUT_LIBRARY
#define copysign __builtin_copysign
#define fabs __builtin_fabs
#define memcpy __builtin_memcpy
#else
#include <math.h>
#include <string.h>
#endif

/* Multiplication and addition are rounded separately. Without this, GCC keeps branches for
 * floating-point exceptions. */
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off", "no-trapping-math", "tree-vectorize",                      \
                     "vect-cost-model=dynamic")
#elif defined(_MSC_VER)
#pragma fp_contract(off)
#endif

/* Shared helpers are not inlined, short functions of a step always; cold ones are optimised for
 * size. */
#if defined(__GNUC__)
#define IN_ONE_PLACE static __attribute__((noinline, unused))
#define QUICK static inline __attribute__((always_inline))
#elif defined(_MSC_VER)
#define IN_ONE_PLACE static
#define QUICK static __forceinline
#else
#define IN_ONE_PLACE static
#define QUICK static inline
#endif
#if !defined(SELDOM) && defined(__clang__) && !defined(_WIN32)
#define SELDOM __attribute__((cold, minsize))
#elif !defined(SELDOM)
#define SELDOM
#endif

/* Added to a number below 2^51, leaves the nearest integer in the last bits. */
#define TO_INTEGER 0x1.8p52

/* The bits of a number. */
static inline uint64_t bits_of(double x) {
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

/* The number with these bits. */
static inline double of_bits(uint64_t bits) {
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* 2^n for -1022 <= n <= 1023, with n in the last bits. */
static inline double power_of_two(uint64_t n) {
    return of_bits((n + 1023) << 52);
}

/* x - k ln(2). The upper part of ln(2) is short enough for its product with k to be exact. */
static inline double reduced(double x, double k) {
    return (x - k * 0x1.62e42feep-1) - k * 0x1.a39ef35793c76p-33;
}

/* 2 (exp(r) - 1) + more for |r| <= ln(2) / 2, to 4e-17, in pairs of terms for parallelism. */
static inline double twice_short(double r, double more) {
    const double z = r * r;
    const double y = z * z;
    const double q0 = 1.0000000000000002 + r * 0.33333333333333337;
    const double q2 = 0.08333333333324798 + r * 0.016666666666660102;
    const double q4 = 0.0027777777834563588 + r * 0.00039682539726211937;
    const double q6 = 4.960304238043546e-05 + r * 5.5114536757368385e-06;
    const double q8 = 5.524027743946799e-07 + r * 5.0200848314010134e-08;
    return ((more + (r + r)) + z * (q0 + z * q2)) + (z * y) * ((q4 + z * q6) + y * q8);
}

/* exp(x) with overflow to inf and underflow to 0; underflow is evaluated at a safe argument because
 * denormals are slow. */
static inline double even_exp(double x) {
    const bool vanishes = x < -746.0;
    const double above = vanishes ? -700.0 : x;
    const double inside = above > 710.0 ? 710.0 : above;
    const double shifted = inside * 0x1.71547652b82fep+0 + TO_INTEGER;
    const double e = twice_short(reduced(inside, shifted - TO_INTEGER), 2.0);
    /* 2^k as the product of two powers, because one may overflow or underflow. */
    const uint64_t n = (bits_of(shifted) + 2047) & 4095;
    const uint64_t part = n / 2;
    const double half = power_of_two(part - 1024) * power_of_two(n - part - 1024);
    return vanishes ? 0.0 : e * half;
}

/* For single numbers: the same bits. Clang interleaves joints better without branches, GCC does not
 * interleave them. */
QUICK double quick_exp(double x) {
#ifndef __clang__
    if (fabs(x) < 700.0) {
        const double shifted = x * 0x1.71547652b82fep+0 + TO_INTEGER;
        return twice_short(reduced(x, shifted - TO_INTEGER), 2.0) *
               power_of_two(bits_of(shifted) - 1);
    }
#endif
    return even_exp(x);
}

/* exp(x) - 1 for x <= 0. */
static inline double even_expm1(double x) {
    const double inside = x < -60.0 ? -60.0 : x;
    const double shifted = inside * 0x1.71547652b82fep+0 + TO_INTEGER;
    const double half = power_of_two(bits_of(shifted) - 1);
    return half * twice_short(reduced(inside, shifted - TO_INTEGER), 0.0) + (2.0 * half - 1.0);
}

/* For single numbers: the same bits, faster if saturated. */
QUICK double quick_expm1(double x) {
    return x < -60.0 ? -1.0 : even_expm1(x);
}

/* tanh(x) from exp(-2 |x|) - 1. */
static inline double tanh_of(double expm1, double x) {
    return copysign(-expm1 / (expm1 + 2.0), x);
}

/* tanh(x) without branches. */
static inline double even_tanh(double x) {
    return tanh_of(even_expm1(-2.0 * fabs(x)), x);
}

/* For single numbers: the same bits, faster if saturated. */
IN_ONE_PLACE double quick_tanh(double x) {
    return tanh_of(quick_expm1(-2.0 * fabs(x)), x);
}

/* The integer nearest to x, for |x| < 2^51. */
static inline double nearest(double x) {
    return (x + TO_INTEGER) - TO_INTEGER;
}

/* Largest argument of `even_sin` and `even_cos`: its quarter turns times parts of pi / 2 are
 * exact. */
#define LARGEST_ANGLE 1e6

/* Sine and cosine for |x| <= LARGEST_ANGLE: Taylor series on an eighth of a turn. */
static inline double even_turn(double x, double *cosine) {
    const double n = nearest(x * 0x1.45f306dc9c883p-1);
    const double r = ((x - n * 0x1.921fb544p+0) - n * 0x1.0b4611a6p-34) - n * 0x1.3198a2e037073p-69;
    const double z = r * r;
    const double y = z * z;
    const double w = y * y;
    const double o1 = -1.0 / 6.0 + z * (1.0 / 120.0);
    const double o3 = -1.0 / 5040.0 + z * (1.0 / 362880.0);
    const double o5 = -1.0 / 39916800.0 + z * (1.0 / 6227020800.0);
    const double odd = r + r * z * ((o1 + y * o3) + w * (o5 + y * (-1.0 / 1307674368000.0)));
    const double e1 = -0.5 + z * (1.0 / 24.0);
    const double e3 = -1.0 / 720.0 + z * (1.0 / 40320.0);
    const double e5 = -1.0 / 3628800.0 + z * (1.0 / 479001600.0);
    const double e7 = -1.0 / 87178291200.0 + z * (1.0 / 20922789888000.0);
    const double even = 1.0 + z * ((e1 + y * e3) + w * (e5 + y * e7));
    const uint64_t quadrant = bits_of(n + TO_INTEGER);
    const double s = quadrant & 1 ? even : odd;
    const double c = quadrant & 1 ? odd : even;
    *cosine = (quadrant + 1) & 2 ? -c : c;
    return quadrant & 2 ? -s : s;
}

/* sin(x) for |x| <= LARGEST_ANGLE. */
static inline double even_sin(double x) {
    double unused;
    return even_turn(x, &unused);
}

/* cos(x) for |x| <= LARGEST_ANGLE. */
static inline double even_cos(double x) {
    double cosine;
    even_turn(x, &cosine);
    return cosine;
}

/* Below this value series are exact to double precision and quotients are not; as in
 * hesr_model.equations.functions. */
#define SERIES_BELOW 1e-3

/* Added to a non-negative divisor to avoid division by zero. */
#define TINY 1e-300

/* 1, 0 or -1; 0 if x is NaN. */
static inline double sgn(double x) {
    return (x > 0.0 ? 1.0 : 0.0) - (x < 0.0 ? 1.0 : 0.0);
}

static inline double square(double x) {
    return x * x;
}

static inline double cube(double x) {
    return x * x * x;
}

/* max(x, 0); 0 if x is NaN. */
static inline double positive(double x) {
    return x > 0.0 ? x : 0.0;
}

/* 1 if a > b, else 0. */
static inline double exceeds(double a, double b) {
    return a > b ? 1.0 : 0.0;
}

/* max(a, b); NaN if a is NaN. */
static inline double larger(double a, double b) {
    return a > b || a != a ? a : b;
}

/* x limited to -b .. b. */
static inline double clip(double x, double b) {
    const double above = x < -b ? -b : x;
    return above > b ? b : above;
}

/* x as a divisor. Compilers divide before they choose between a quotient and a limit, and hosts may
 * trap invalid operations. */
static inline double not_zero(double x) {
    return fabs(x) > TINY ? x : TINY;
}

/* a / b for b > 0, else `otherwise`; b is limited as in `not_zero`. */
static inline double over(double a, double b, double otherwise) {
    const double quotient = a / larger(b, TINY);
    return b > 0.0 ? quotient : otherwise;
}

/* exp(-z) - 1, the relative decay of a state over a step; -z for Euler's method. */
static inline double decay(double z, double euler) {
    return euler > 0.0 ? -z : even_expm1(-z);
}

/* For single numbers: the same bits, faster if saturated. */
static inline double quick_decay(double z, double euler) {
    return euler > 0.0 ? -z : quick_expm1(-z);
}

/* (1 - exp(-z)) / z, continued by 1 at 0; e is decay(z, euler). */
static inline double share(double z, double e, double euler) {
    const bool small = fabs(z) < SERIES_BELOW;
    const double y = z * z;
    const double series =
        (1.0 - 0.5 * z) + y * ((1.0 / 6.0 - z * (1.0 / 24.0)) + y * (1.0 / 120.0));
    if (euler > 0.0) {
        return 1.0;
    }
    return small ? series : -e / (z + TINY);
}

/* Derivative of share with respect to z. */
static inline double share_slope(double z, double e, double euler) {
    const bool small = fabs(z) < SERIES_BELOW;
    const double y = z * z;
    const double divisor = z + TINY;
    const double series =
        (-0.5 + z * (1.0 / 3.0)) - y * ((1.0 / 8.0 - z * (1.0 / 30.0)) + y * (1.0 / 144.0));
    if (euler > 0.0) {
        return 0.0;
    }
    return small ? series : (1.0 + e - -e / divisor) / divisor;
}

/* sin(x) / x, continued by 1 at 0, from x and its sine. */
static inline double cardinal(double x, double sine_of_x) {
    const double z = x * x;
    const double series = 1.0 - z * (1.0 / 6.0) * (1.0 - z * (1.0 / 20.0));
    const double quotient = sine_of_x / not_zero(x);
    return fabs(x) < SERIES_BELOW ? series : quotient;
}

/* sin(x) / x for |x| <= LARGEST_ANGLE. */
static inline double even_cardinal_sine(double x) {
    return cardinal(x, even_sin(x));
}

#ifndef WITHOUT_LIBRARY

/* sin(x). Beyond LARGEST_ANGLE range reduction is inexact: use libm. */
static inline double sine(double x) {
    return fabs(x) <= LARGEST_ANGLE ? even_sin(x) : sin(x);
}

/* cos(x), as `sine`. */
static inline double cosine(double x) {
    return fabs(x) <= LARGEST_ANGLE ? even_cos(x) : cos(x);
}

/* sin(x) / x of any x. */
static inline double cardinal_sine(double x) {
    return cardinal(x, sine(x));
}

/* Derivative of cardinal. */
static inline double cardinal_slope(double x) {
    const double series = -x * (1.0 / 3.0) * (1.0 - x * x * (1.0 / 10.0));
    const double quotient = (cosine(x) - cardinal_sine(x)) / not_zero(x);
    return fabs(x) < SERIES_BELOW ? series : quotient;
}

#endif

#endif
