/* Friction of three joints as an engineer writes it by hand, behind a minimal layer of FMI 2.0: one
 * array of variables, no checks, no events. The header by_hand.h has the coefficients of LuGre,
 * ParFam-H or ParFam-S (LAW) in the order of the law's file. Value references: dq 0 to 2, tau 3 to
 * 5, then the coefficients of each joint. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2.h"

enum { LUGRE, PARFAM_H, PARFAM_S, JOINTS = 3, TAU = JOINTS, FIRST = TAU + JOINTS };

#include "by_hand.h" /* LAW, COEFFICIENTS, start, STOPS, AGED, per_width */

enum { VARIABLES = FIRST + JOINTS * COEFFICIENTS, STATES = STOPS + AGED + 1 };

typedef struct {
    double v[VARIABLES];
    double x[JOINTS][STATES];
} Instance;

#if LAW == 0

/* z' = v - sigma_0 |v| / g z, solved for the steps' constant v. */
static double torque(const double *k, double *x, double v, double h) {
    const double r = v / k[5], g = k[3] + (k[4] - k[3]) * exp(-r * r);
    const double rest = v > 0.0 ? g / k[0] : v < 0.0 ? -g / k[0] : 0.0;
    const double rate = k[0] * fabs(v) / g, z = rest + (x[0] - rest) * exp(-rate * h);
    x[0] = z;
    return k[0] * z + k[1] * (v - rate * z) + k[2] * v + k[6];
}

#elif LAW == 1

/* h' = alpha (tanh(beta v) - h); tau = c_0 + c_h h + c_dh h' + c_g tanh(theta . (1, v, h, h')). */
static double torque(const double *k, double *x, double v, double step) {
    const double drive = tanh(k[9] * v);
    const double h = drive + (x[0] - drive) * exp(-k[8] * step), dh = k[8] * (drive - h);
    x[0] = h;
    return k[0] + k[1] * h + k[2] * dh + k[3] * tanh(k[4] + k[5] * v + k[6] * h + k[7] * dh);
}

#else

static double limited(double x, double b) {
    return x < -b ? -b : x > b ? b : x;
}

/* Parallel stops and viscous terms; some stops weaken with the age of their contacts. */
static double torque(const double *k, double *x, double v, double h) {
    const double *viscous = k + STOPS + AGED, *age = viscous + 5, r = v / age[0];
    const double fresh = exp(-r * r), speed = fabs(v);
    double sum = viscous[3] + v * (viscous[0] + viscous[1] * speed);
    const double level = (x[0] = fresh + (x[0] - fresh) * exp(-h / age[1]));
    const double bound = level < age[2] ? level : age[2];
    for (int i = 0; i < STOPS + AGED; i++) {
        x[i + 1] = limited(x[i + 1] + v * h * per_width[i], i < STOPS ? 1.0 : bound);
        sum += k[i] * x[i + 1];
    }
    return sum + v * viscous[2] / (1.0 + speed / viscous[4]);
}

#endif

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *host, fmi2Boolean visible,
                              fmi2Boolean logging) {
    Instance *instance = calloc(1, sizeof *instance);
    (void)name, (void)type, (void)guid, (void)resources, (void)host, (void)visible, (void)logging;
    for (int i = 0; instance && i < JOINTS; i++) {
        memcpy(instance->v + FIRST + i * COEFFICIENTS, start[i], sizeof start[i]);
        instance->x[i][0] = LAW == PARFAM_S;
    }
    return instance;
}

void fmi2FreeInstance(fmi2Component c) {
    free(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerant, fmi2Real tolerance,
                               fmi2Real begin, fmi2Boolean ends, fmi2Real end) {
    (void)c, (void)tolerant, (void)tolerance, (void)begin, (void)ends, (void)end;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                       const fmi2Real value[]) {
    Instance *instance = c;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= VARIABLES) {
            return fmi2Error;
        }
        instance->v[vr[i]] = value[i];
    }
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    const Instance *instance = c;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= VARIABLES) {
            return fmi2Error;
        }
        value[i] = instance->v[vr[i]];
    }
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_set_state) {
    Instance *instance = c;
    (void)time, (void)no_set_state;
    for (int i = 0; i < JOINTS; i++) {
        const double *k = instance->v + FIRST + i * COEFFICIENTS;
        instance->v[TAU + i] = torque(k, instance->x[i], instance->v[i], step);
    }
    return fmi2OK;
}
