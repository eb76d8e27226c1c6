/* Component: desired motion of all joints, now and at a fixed preview time.
 *
 * Accuracy and cost of the closed-form formulas of hesr_model.motions.trajectories do not depend on
 * the time. A sweep is at rest before its start and after its end. The generated motion.h holds the
 * indices of the variables. */
#include <math.h>

#include "component_alone.h"
#include "component_plain.h"
#include "motion.h"

#define PI 3.14159265358979324
#define TWO_PI 6.283185307179586477

/* Round-off tolerance of the start and end of the motion [s]. */
#define ROUNDING 1e-9

typedef struct {
    double re;
    double im;
} Complex;

static Complex multiply(Complex a, Complex b) {
    return (Complex){a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
}

/* size exp(i angle), with the angle in rad. */
static Complex polar(double size, double angle) {
    return (Complex){size * cos(angle), size * sin(angle)};
}

/* exp(-i u^2) times the integral of exp(i s^2) from u to infinity, u >= 0, to round-off: trapezium
 * rule with a pole correction (Alazah, Chandler-Wilde and La Porte, Numerische Mathematik 128,
 * 2014). */
static Complex fresnel_tail(double u) {
    enum { NODES = 12 };
    const double square = PI / (NODES + 0.5); /* square of the distance between nodes */
    const double a = sqrt(PI * (NODES + 0.5));
    const double c = sqrt(2.0) * a * u;
    /* exp(-t^2) at the nodes t, which are half a distance off zero, by a recursion. */
    double weight = exp(-0.25 * square);
    double ratio = exp(-2.0 * square);
    Complex sum = {0.0, 0.0};
    for (int k = 0; k < NODES; k++) {
        const double t2 = (k + 0.5) * (k + 0.5) * square;
        const double size = u * u * u * u + t2 * t2;
        sum.re += weight * (u * u) / size;
        sum.im -= weight * t2 / size;
        weight *= ratio;
        ratio *= exp(-2.0 * square);
    }
    sum = multiply(sum, polar(u / a, 0.25 * PI));
    if (c < 50.0) { /* beyond, the pole is negligible */
        const Complex e = {1.0 + exp(c) * cos(c), exp(c) * sin(c)};
        const Complex pole = multiply(e, polar(1.0 / (e.re * e.re + e.im * e.im), -u * u));
        sum.re += pole.re;
        sum.im += pole.im;
    }
    return multiply(sum, polar(sqrt(PI), 0.25 * PI));
}

/* sin(x) / x, continued by 1 at 0. */
static double sinc(double x) {
    if (x == 0.0) {
        return 1.0;
    }
    return sin(x) / x;
}

/* 1 or -1; 1 for zero. */
static double sign_of(double x) {
    return x < 0.0 ? -1.0 : 1.0;
}

/* Integral of exp(i (phase + rate s + slope s^2 / 2)) from s = 0 to t, by completing the square;
 * phase in rad, rate in rad/s, slope in rad/s2, t in s. */
static Complex integrate(double phase, double rate, double slope, double t) {
    if (slope < 0.0) {
        const Complex mirrored = integrate(-phase, -rate, -slope, t);
        return (Complex){mirrored.re, -mirrored.im};
    }
    if (0.5 * slope * t * t < 1e-17) { /* the rate is effectively constant */
        const double half = 0.5 * rate * t;
        return polar(t * sinc(half), phase + half);
    }
    /* u = rate / sqrt(2 slope) at either end; negative values are mirrored. */
    const double end_rate = rate + slope * t;
    const double end_phase = phase + rate * t + 0.5 * slope * t * t;
    const double stretch = 1.0 / sqrt(2.0 * slope);
    const double size = 2.0 * stretch;
    const Complex first = multiply(fresnel_tail(fabs(rate) * stretch), polar(size, phase));
    const Complex last = multiply(fresnel_tail(fabs(end_rate) * stretch), polar(size, end_phase));
    const double first_sign = sign_of(rate);
    const double last_sign = sign_of(end_rate);
    Complex sum = {first_sign * first.re - last_sign * last.re,
                   first_sign * first.im - last_sign * last.im};
    if (first_sign < last_sign) { /* the rate passes zero: add the integral over all times */
        const double u = rate * stretch;
        const Complex whole = polar(size * sqrt(PI), phase - u * u + 0.25 * PI);
        sum.re += whole.re;
        sum.im += whole.im;
    }
    return sum;
}

/* Position, velocity and acceleration [rad, rad/s, rad/s2] of joint i at time t [s] of a sweep. */
static void sweep(const double *v, int i, double t, double *q, double *dq, double *ddq) {
    const double swing_rate = TWO_PI / v[SWING_PERIOD];
    const double swing_start = v[SWING_PHASE + i];
    const double swing_phase = swing_rate * t + swing_start;
    const double rate = TWO_PI * v[FIRST];
    const double slope = TWO_PI * (v[LAST] - v[FIRST]) / v[LENGTH];
    const double phase = rate * t + 0.5 * slope * t * t;
    const double peak = v[AMPLITUDE + i] + v[SWING + i] * sin(swing_phase);
    *q = v[OFFSET + i] + v[AMPLITUDE + i] * integrate(0.0, rate, slope, t).im;
    if (v[SWING + i] != 0.0) {
        /* 2 sin(a) sin(b) = cos(a - b) - cos(a + b): every term has a quadratic phase. */
        *q += 0.5 * v[SWING + i] *
              (integrate(-swing_start, rate - swing_rate, slope, t).re -
               integrate(swing_start, rate + swing_rate, slope, t).re);
    }
    *dq = peak * sin(phase);
    *ddq = swing_rate * v[SWING + i] * cos(swing_phase) * sin(phase) +
           peak * (rate + slope * t) * cos(phase);
}

/* Number of harmonics up to the last one that any joint has. */
static int count_harmonics(const double *v) {
    for (int k = HARMONICS; k > 0; k--) {
        for (int i = 0; i < JOINTS; i++) {
            const int place = i * HARMONICS + k - 1;
            if (v[A + place] != 0.0 || v[B + place] != 0.0) {
                return k;
            }
        }
    }
    return 0;
}

/* Positions, velocities and accelerations [rad, rad/s, rad/s2] of all joints at a time t [s] of a
 * Fourier series. */
static void fourier(const double *v, double t, double *q, double *dq, double *ddq) {
    const int harmonics = count_harmonics(v);
    for (int i = 0; i < JOINTS; i++) {
        q[i] = v[OFFSET + i];
        dq[i] = 0.0;
        ddq[i] = 0.0;
    }
    for (int k = 0; k < harmonics; k++) {
        const double rate = TWO_PI / v[PERIOD] * (k + 1);
        const double cosine = cos(rate * t);
        const double sine = sin(rate * t);
        for (int i = 0; i < JOINTS; i++) {
            const double a = v[A + i * HARMONICS + k];
            const double b = v[B + i * HARMONICS + k];
            q[i] += (a * sine - b * cosine) / rate;
            dq[i] += a * cosine + b * sine;
            ddq[i] += (b * cosine - a * sine) * rate;
        }
    }
}

/* Store the motion at `time` [s] in the outputs; it starts after the rest. */
static void evaluate(double *v, double time, double *q, double *dq, double *ddq) {
    const double elapsed = fmax(time - v[REST_TIME], 0.0);
    const double t = v[KIND] == SWEEP ? fmin(elapsed, v[LENGTH]) : elapsed;
    const bool is_before = time < v[REST_TIME] - ROUNDING;
    const bool is_after = elapsed > t + ROUNDING;
    const double rate = TWO_PI * v[FIRST];
    if (v[KIND] == FOURIER) {
        fourier(v, t, q, dq, ddq);
    }
    for (int i = 0; i < JOINTS; i++) {
        if (v[KIND] == SINE) {
            q[i] = v[OFFSET + i] - v[AMPLITUDE + i] / rate * cos(rate * t);
            dq[i] = v[AMPLITUDE + i] * sin(rate * t);
            ddq[i] = v[AMPLITUDE + i] * rate * cos(rate * t);
        } else if (v[KIND] == SWEEP) {
            sweep(v, i, t, &q[i], &dq[i], &ddq[i]);
        }
        if (is_before || is_after) {
            dq[i] = 0.0;
            ddq[i] = 0.0;
        }
    }
}

/* Store the motion at a time [s], and that a preview time later. */
static void evaluate_both(Component *component, double time) {
    double *v = component->v;
    evaluate(v, time, &v[POSITION], &v[VELOCITY], &v[ACCELERATION]);
    evaluate(v, time + v[PREVIEW], &v[POSITION_AHEAD], &v[VELOCITY_AHEAD], &v[ACCELERATION_AHEAD]);
}

static bool component_initialise(Component *component, void *workspace, Message *why) {
    static const int positive[] = {PERIOD, SWING_PERIOD, FIRST, LAST, LENGTH};
    const double *v = component->v;
    (void)workspace;
    for (size_t i = 0; i < sizeof positive / sizeof positive[0]; i++) {
        if (!sound(v, positive[i], v[positive[i]] > 0.0, "be positive", why)) {
            return false;
        }
    }
    return true;
}

static bool component_output(Component *component, void *workspace, Message *why) {
    (void)workspace;
    (void)why;
    evaluate_both(component, component->time);
    return true;
}

static bool component_step(Component *component, void *workspace, double step, Message *why) {
    (void)workspace;
    (void)why;
    evaluate_both(component, component->time + step);
    return true;
}
