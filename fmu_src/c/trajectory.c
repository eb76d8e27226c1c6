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
    double re, im;
} Complex;

static Complex times(Complex a, Complex b) {
    return (Complex){a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
}

static Complex turned(double size, double angle) {
    return (Complex){size * cos(angle), size * sin(angle)};
}

/* exp(-i u^2) times the integral of exp(i s^2) from u to infinity, u >= 0, to round-off: trapezium
 * rule with a pole correction (Alazah, Chandler-Wilde and La Porte, Numerische Mathematik 128,
 * 2014). */
static Complex beyond(double u) {
    enum { NODES = 12 };
    const double square = PI / (NODES + 0.5); /* square of the distance between nodes */
    const double a = sqrt(PI * (NODES + 0.5)), c = sqrt(2.0) * a * u;
    double weight = exp(-0.25 * square), ratio = exp(-2.0 * square);
    Complex sum = {0.0, 0.0};
    for (int k = 0; k < NODES; k++) {
        const double t2 = (k + 0.5) * (k + 0.5) * square, size = u * u * u * u + t2 * t2;
        sum.re += weight * (u * u) / size;
        sum.im -= weight * t2 / size;
        weight *= ratio;
        ratio *= exp(-2.0 * square);
    }
    sum = times(sum, turned(u / a, 0.25 * PI));
    if (c < 50.0) { /* beyond, the pole is negligible */
        const Complex e = {1.0 + exp(c) * cos(c), exp(c) * sin(c)};
        const Complex pole = times(e, turned(1.0 / (e.re * e.re + e.im * e.im), -u * u));
        sum.re += pole.re;
        sum.im += pole.im;
    }
    return times(sum, turned(sqrt(PI), 0.25 * PI));
}

/* Integral of exp(i (phase + rate s + slope s^2 / 2)) from s = 0 to t, by completing the square. */
static Complex integral(double phase, double rate, double slope, double t) {
    const double end = rate + slope * t;
    if (slope < 0.0) {
        const Complex mirrored = integral(-phase, -rate, -slope, t);
        return (Complex){mirrored.re, -mirrored.im};
    }
    if (0.5 * slope * t * t < 1e-17) { /* the rate is effectively constant */
        const double half = 0.5 * rate * t;
        return turned(t * (half != 0.0 ? sin(half) / half : 1.0), phase + half);
    }
    /* u = rate / sqrt(2 slope) at either end; negative values are mirrored. */
    const double stretch = 1.0 / sqrt(2.0 * slope), both = 2.0 * stretch;
    const Complex first = times(beyond(fabs(rate) * stretch), turned(both, phase));
    const Complex last =
        times(beyond(fabs(end) * stretch), turned(both, phase + rate * t + 0.5 * slope * t * t));
    const double one = rate < 0.0 ? -1.0 : 1.0, other = end < 0.0 ? -1.0 : 1.0;
    Complex sum = {one * first.re - other * last.re, one * first.im - other * last.im};
    if (one < other) {
        const double u = rate * stretch;
        const Complex whole = turned(both * sqrt(PI), phase - u * u + 0.25 * PI);
        sum.re += whole.re;
        sum.im += whole.im;
    }
    return sum;
}

static void sweep(const double *v, int i, double t, double *q, double *dq, double *ddq) {
    const double slow = TWO_PI / v[SWING_PERIOD], own = v[SWING_PHASE + i];
    const double rate = TWO_PI * v[FIRST];
    const double slope = TWO_PI * (v[LAST] - v[FIRST]) / v[LENGTH];
    const double phase = rate * t + 0.5 * slope * t * t, swell = slow * t + own;
    const double peak = v[AMPLITUDE + i] + v[SWING + i] * sin(swell);
    *q = v[OFFSET + i] + v[AMPLITUDE + i] * integral(0.0, rate, slope, t).im;
    if (v[SWING + i] != 0.0) {
        /* 2 sin(a) sin(b) = cos(a - b) - cos(a + b): every term has a quadratic phase. */
        *q += 0.5 * v[SWING + i] *
              (integral(-own, rate - slow, slope, t).re - integral(own, rate + slow, slope, t).re);
    }
    *dq = peak * sin(phase);
    *ddq = slow * v[SWING + i] * cos(swell) * sin(phase) + peak * (rate + slope * t) * cos(phase);
}

static int harmonics_of(const double *v) {
    for (int k = HARMONICS; k > 0; k--) {
        for (int i = 0; i < JOINTS; i++) {
            if (v[A + i * HARMONICS + k - 1] != 0.0 || v[B + i * HARMONICS + k - 1] != 0.0) {
                return k;
            }
        }
    }
    return 0;
}

static void fourier(const double *v, double t, double *q, double *dq, double *ddq) {
    const int harmonics = harmonics_of(v);
    for (int i = 0; i < JOINTS; i++) {
        q[i] = v[OFFSET + i];
        dq[i] = ddq[i] = 0.0;
    }
    for (int k = 0; k < harmonics; k++) {
        const double rate = TWO_PI / v[PERIOD] * (k + 1);
        const double c = cos(rate * t), s = sin(rate * t);
        for (int i = 0; i < JOINTS; i++) {
            const double a = v[A + i * HARMONICS + k], b = v[B + i * HARMONICS + k];
            q[i] += (a * s - b * c) / rate;
            dq[i] += a * c + b * s;
            ddq[i] += (b * c - a * s) * rate;
        }
    }
}

/* Store the motion at `time` [s] in the outputs; it starts after the rest. */
static void evaluate(double *v, double time, double *q, double *dq, double *ddq) {
    const double elapsed = fmax(time - v[REST_TIME], 0.0);
    const double t = v[KIND] == SWEEP ? fmin(elapsed, v[LENGTH]) : elapsed;
    const bool rests = time < v[REST_TIME] - ROUNDING || elapsed > t + ROUNDING;
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
        if (rests) {
            dq[i] = ddq[i] = 0.0;
        }
    }
}

static void evaluate_both(Component *component, double t) {
    double *v = component->v;
    evaluate(v, t, &v[POSITION], &v[VELOCITY], &v[ACCELERATION]);
    evaluate(v, t + v[PREVIEW], &v[POSITION_AHEAD], &v[VELOCITY_AHEAD], &v[ACCELERATION_AHEAD]);
}

static bool component_initialise(Component *component, void *workspace, Message *why) {
    static const int positive[] = {PERIOD, SWING_PERIOD, FIRST, LAST, LENGTH};
    (void)workspace;
    for (size_t i = 0; i < sizeof positive / sizeof positive[0]; i++) {
        const double *v = component->v;
        if (!sound(v, positive[i], v[positive[i]] > 0.0, "be positive", why)) {
            return false;
        }
    }
    return true;
}

static bool component_output(Component *component, void *workspace, Message *why) {
    (void)workspace, (void)why;
    evaluate_both(component, component->time);
    return true;
}

static bool component_step(Component *component, void *workspace, double step, Message *why) {
    (void)workspace, (void)why;
    evaluate_both(component, component->time + step);
    return true;
}
