/* Component: a desired motion of all joints, now and a fixed time ahead.
 *
 * The same formulas as in hesr_model.motions.trajectories. Fourier series and sines are closed
 * forms; a sweep's velocity is one too, and its position is that integrated by Gauss's rule, whose
 * error on so smooth a function is that of rounding.
 *
 * The generated motion.h says where the variables stand. */
#include <math.h>
#include <stdio.h>

#include "component_alone.h"
#include "component_plain.h"
#include "motion.h"

#define TWO_PI 6.283185307179586477

/* Longest panel of the rule [s]; at 10 Hz its error is still below rounding. */
#define PANEL 0.01

/* By which a sum of steps may miss the instant at which the motion begins [s]. */
#define ROUNDING 1e-9

/* Two clocks, each with the time [s] to which its sweep is integrated, and the integrals [rad]. */
enum { NOW, AHEAD };
#define CLOCK (1 + JOINTS)

static double sweep_velocity(const double *v, int i, double t, double *ddq) {
    const double slow = TWO_PI / v[SWING_PERIOD];
    const double rise = (v[LAST] - v[FIRST]) / v[LENGTH];
    const double phase = TWO_PI * (v[FIRST] * t + 0.5 * rise * t * t);
    const double rate = TWO_PI * (v[FIRST] + rise * t);
    const double swell = slow * t + v[SWING_PHASE + i];
    const double peak = v[AMPLITUDE + i] + v[SWING + i] * sin(swell);
    *ddq = slow * v[SWING + i] * cos(swell) * sin(phase) + peak * rate * cos(phase);
    return peak * sin(phase);
}

/* Bring the integrals of a clock to a time, forwards or backwards. */
static void integrate(Component *component, int clock, double t) {
    static const double node[] = {0.0, 0.5384693101056830910, 0.9061798459386639928};
    static const double weight[] = {0.5688888888888888889, 0.4786286704993664680,
                                    0.2369268850561890875};
    double *own = &component->own[clock * CLOCK];
    const int panels = (int)ceil(fabs(t - own[0]) / PANEL);
    const double half = panels > 0 ? 0.5 * (t - own[0]) / panels : 0.0;
    for (int k = 0; k < panels; k++) {
        const double middle = own[0] + (2 * k + 1) * half;
        for (int i = 0; i < JOINTS; i++) {
            double sum = 0.0, ddq;
            for (int j = 0; j < 3; j++) {
                const double right = sweep_velocity(component->v, i, middle + half * node[j], &ddq);
                const double left = sweep_velocity(component->v, i, middle - half * node[j], &ddq);
                sum += weight[j] * (j > 0 ? left + right : right);
            }
            own[1 + i] += half * sum;
        }
    }
    own[0] = t;
}

static void fourier(const double *v, int i, double t, double *q, double *dq, double *ddq) {
    *q = v[OFFSET + i];
    *dq = *ddq = 0.0;
    for (int k = 0; k < HARMONICS; k++) {
        const double rate = TWO_PI / v[PERIOD] * (k + 1);
        const double a = v[A + i * HARMONICS + k], b = v[B + i * HARMONICS + k];
        const double c = cos(rate * t), s = sin(rate * t);
        *q += (a * s - b * c) / rate;
        *dq += a * c + b * s;
        *ddq += (b * c - a * s) * rate;
    }
}

/* Put the motion at a time where a clock's outputs stand; it begins after the rest. */
static void evaluate(Component *component, int clock, double time) {
    double *v = component->v;
    const double t = fmax(time - v[REST_TIME], 0.0);
    double *q = &v[clock == NOW ? POSITION : POSITION_AHEAD];
    double *dq = &v[clock == NOW ? VELOCITY : VELOCITY_AHEAD];
    double *ddq = &v[clock == NOW ? ACCELERATION : ACCELERATION_AHEAD];
    const double rate = TWO_PI * v[FIRST];
    if (v[KIND] == SWEEP) {
        integrate(component, clock, t);
    }
    for (int i = 0; i < JOINTS; i++) {
        if (v[KIND] == FOURIER) {
            fourier(v, i, t, &q[i], &dq[i], &ddq[i]);
        } else if (v[KIND] == SINE) {
            q[i] = v[OFFSET + i] - v[AMPLITUDE + i] / rate * cos(rate * t);
            dq[i] = v[AMPLITUDE + i] * sin(rate * t);
            ddq[i] = v[AMPLITUDE + i] * rate * cos(rate * t);
        } else {
            dq[i] = sweep_velocity(v, i, t, &ddq[i]);
            q[i] = v[OFFSET + i] + component->own[clock * CLOCK + 1 + i];
        }
        if (time < v[REST_TIME] - ROUNDING) {
            dq[i] = ddq[i] = 0.0;
        }
    }
}

static void evaluate_both(Component *component, double t) {
    evaluate(component, NOW, t);
    evaluate(component, AHEAD, t + component->v[PREVIEW]);
}

static bool component_initialise(Component *component, void *workspace, Message *why) {
    static const int positive[] = {PERIOD, SWING_PERIOD, FIRST, LAST, LENGTH};
    (void)workspace;
    for (size_t i = 0; i < sizeof positive / sizeof positive[0]; i++) {
        if (!(component->v[positive[i]] > 0.0)) {
            snprintf(why->text, sizeof why->text, "%s is %g; it must be positive.",
                     variables[positive[i]].name, component->v[positive[i]]);
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
