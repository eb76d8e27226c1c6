/* Elementary functions without a branch: a compiler makes vectors of loops over them, and they give
 * the same bits on every machine that rounds as IEEE 754 says, whatever the width of its vectors.
 * Within 1e-15 of the exact values, relative to these; of sin and cos, relative to 1. */
#ifndef ELEMENTARY_H
#define ELEMENTARY_H

#include <stdint.h>

#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif

/* Added to a number below 2^51 it leaves the nearest integer in the last bits. */
#define TO_INTEGER 0x1.8p52

static inline uint64_t bits_of(double x) {
    uint64_t bits;
    __builtin_memcpy(&bits, &x, sizeof bits);
    return bits;
}

static inline double of_bits(uint64_t bits) {
    double x;
    __builtin_memcpy(&x, &bits, sizeof x);
    return x;
}

/* 2^k for -1022 <= k <= 1023, from k + TO_INTEGER. */
static inline double power_of_two(double k) {
    return of_bits((bits_of(k) << 52) + 0x3FF0000000000000u);
}

/* expm1(r) for |r| <= ln(2) / 2: Taylor's series, whose remainder is 4e-18; in pairs of terms,
 * which wait less for one another. */
static inline double short_expm1(double r) {
    const double z = r * r, y = z * z;
    const double p2 = 0.5 + r * (1.0 / 6.0), p4 = 1.0 / 24.0 + r * (1.0 / 120.0);
    const double p6 = 1.0 / 720.0 + r * (1.0 / 5040.0);
    const double p8 = 1.0 / 40320.0 + r * (1.0 / 362880.0);
    const double p10 = 1.0 / 3628800.0 + r * (1.0 / 39916800.0);
    const double p12 = 1.0 / 479001600.0 + r * (1.0 / 6227020800.0);
    return r + z * ((p2 + z * p4) + y * ((p6 + z * p8) + y * (p10 + z * p12)));
}

/* What is left of x without k ln(2); the upper part of ln(2) has so few bits that k times it is
 * exact. */
static inline double without(double x, double k) {
    return (x - k * 0x1.62e42feep-1) - k * 0x1.a39ef35793c76p-33;
}

static inline double nearest(double x) {
    return (x + TO_INTEGER) - TO_INTEGER;
}

/* Of numbers so large that it is infinite, and of those so small that it is 0, too. */
static inline double even_exp(double x) {
    const double below = x > 710.0 ? 710.0 : x;
    const double inside = below < -746.0 ? -746.0 : below;
    const double k = nearest(inside * 0x1.71547652b82fep+0);
    const double part = nearest(0.5 * k);
    const double e = 1.0 + short_expm1(without(inside, k));
    return e * power_of_two(part + TO_INTEGER) * power_of_two((k - part) + TO_INTEGER);
}

static inline double even_expm1(double x) {
    const double below = x > 710.0 ? 710.0 : x;
    const double inside = below < -60.0 ? -60.0 : below;
    const double k = nearest(inside * 0x1.71547652b82fep+0);
    const double half = power_of_two((k - 1.0) + TO_INTEGER); /* 2^k itself may be too large */
    return 2.0 * (half * short_expm1(without(inside, k)) + (half - 0.5));
}

static inline double even_tanh(double x) {
    const double e = even_expm1(-2.0 * __builtin_fabs(x));
    return __builtin_copysign(-e / (e + 2.0), x);
}

/* Largest argument of `even_sin` and `even_cos`: its quarter turns times parts of pi / 2 are exact.
 */
#define LARGEST_ANGLE 1e6

/* sin(x + quarters pi / 2) for |x| <= LARGEST_ANGLE: Taylor's series on an eighth of a turn. */
static inline double turned_sin(double x, double quarters) {
    const double n = nearest(x * 0x1.45f306dc9c883p-1);
    const double r = ((x - n * 0x1.921fb544p+0) - n * 0x1.0b4611a6p-34) - n * 0x1.3198a2e037073p-69;
    const double z = r * r;
    const double y = z * z, w = y * y;
    const double o1 = -1.0 / 6.0 + z * (1.0 / 120.0);
    const double o3 = -1.0 / 5040.0 + z * (1.0 / 362880.0);
    const double o5 = -1.0 / 39916800.0 + z * (1.0 / 6227020800.0);
    const double odd = r + r * z * ((o1 + y * o3) + w * (o5 + y * (-1.0 / 1307674368000.0)));
    const double e1 = -0.5 + z * (1.0 / 24.0), e3 = -1.0 / 720.0 + z * (1.0 / 40320.0);
    const double e5 = -1.0 / 3628800.0 + z * (1.0 / 479001600.0);
    const double e7 = -1.0 / 87178291200.0 + z * (1.0 / 20922789888000.0);
    const double even = 1.0 + z * ((e1 + y * e3) + w * (e5 + y * e7));
    const uint64_t quadrant = bits_of((n + quarters) + TO_INTEGER);
    const double found = quadrant & 1 ? even : odd;
    return quadrant & 2 ? -found : found;
}

static inline double even_sin(double x) {
    return turned_sin(x, 0.0);
}

static inline double even_cos(double x) {
    return turned_sin(x, 1.0);
}

#endif
