/* Component: velocity commands from desired motion, models and measurements.
 *
 *     dq_cmd = dq_d + dq_comp + Kx (q_d - q),   tau_d = tau_rb + friction_gain tau_f
 *
 *     none             dq_comp = 0
 *     torque_error     dq_comp = exp(-lambda |dq_d|) (Kp e + Kd de/dt), e = tau_d - tau_meas
 *                      (section V.D and Fig. 6 of the paper)
 *     servo_inversion  dq_comp = C^-1 (tau_d - tau_g), C(s) = Kv + Ki / s being the servo's own
 *
 * A command is held over a sample, so C acts on it in the sample's middle on average. The loop
 * begins at rest, with the servo in equilibrium. The generated control.h says where the variables
 * stand. */
#include <math.h>
#include <stdio.h>

#include "component_alone.h"
#include "component_plain.h"
#include "control.h"

/* What is remembered of each joint. */
enum {
    INTEGRAL = 0,          /* of the command of servo_inversion [rad] */
    COMMAND = JOINTS,      /* that command over the last sample [rad/s] */
    ERROR = 2 * JOINTS,    /* torque error of the last sample [N.m] */
    PREVIOUS = 3 * JOINTS, /* and of the one before */
    STARTED = 4 * JOINTS,  /* whether the initialisation has ended */
};

/* At rest the servo's own integral holds the torque already. */
static double equilibrium(const double *v, int i) {
    return v[KI + i] > 0.0 ? (v[TAU_D + i] - v[TAU_G + i]) / v[KI + i] : 0.0;
}

/* Until the initialisation ends nothing is remembered, and the loop is as it begins. */
static double compensation(const Component *component, int i, double *error) {
    const double *v = component->v, *own = component->own;
    const bool started = own[STARTED] > 0.0;
    const double sample = v[SAMPLE_TIME];
    *error = 0.0;
    if (v[COMPENSATION] == TORQUE_ERROR) {
        *error = v[TAU_D + i] - v[TAU_MEAS + i];
        const double rate = started ? (*error - own[PREVIOUS + i]) / sample : 0.0;
        return exp(-v[LAMBDA] * fabs(v[DQ_D + i])) * (v[KP + i] * *error + v[KD + i] * rate);
    }
    if (v[COMPENSATION] == SERVO_INVERSION) {
        const double integral = started ? own[INTEGRAL + i] : equilibrium(v, i);
        const double wanted = v[TAU_D + i] - v[TAU_G + i] - v[KI + i] * integral;
        return wanted / (v[KV + i] + 0.5 * sample * v[KI + i]);
    }
    return 0.0;
}

static bool component_output(Component *component, void *workspace, Message *why) {
    double *v = component->v;
    (void)workspace, (void)why;
    for (int i = 0; i < JOINTS; i++) {
        double error;
        v[TAU_D + i] = v[TAU_RB + i] + v[FRICTION_GAIN] * v[TAU_F + i];
        v[DQ_COMP + i] = compensation(component, i, &error);
        v[DQ_CMD + i] = v[DQ_D + i] + v[DQ_COMP + i] + v[KX + i] * (v[Q_D + i] - v[Q + i]);
    }
    return true;
}

/* Keep what the next sample needs of this one. */
static void remember(Component *component) {
    for (int i = 0; i < JOINTS; i++) {
        component->own[COMMAND + i] = compensation(component, i, &component->own[ERROR + i]);
    }
}

static bool component_initialise(Component *component, void *workspace, Message *why) {
    double *v = component->v, *own = component->own;
    if (!(v[SAMPLE_TIME] > 0.0)) {
        snprintf(why->text, sizeof why->text, "sample_time is %g s; it must be positive.",
                 v[SAMPLE_TIME]);
        return false;
    }
    for (int i = 0; v[COMPENSATION] == SERVO_INVERSION && i < JOINTS; i++) {
        if (!(v[KV + i] > 0.0 && v[KI + i] >= 0.0)) {
            snprintf(why->text, sizeof why->text,
                     "%s is %g and %s is %g; servo_inversion needs the servo's gains.",
                     variables[KV + i].name, v[KV + i], variables[KI + i].name, v[KI + i]);
            return false;
        }
    }
    component_output(component, workspace, why);
    remember(component);
    for (int i = 0; i < JOINTS; i++) {
        own[INTEGRAL + i] = v[COMPENSATION] == SERVO_INVERSION ? equilibrium(v, i) : 0.0;
        own[PREVIOUS + i] = own[ERROR + i];
    }
    own[STARTED] = 1.0;
    return true;
}

static bool component_step(Component *component, void *workspace, double step, Message *why) {
    double *own = component->own;
    const double sample = component->v[SAMPLE_TIME];
    if (!(fabs(step - sample) <= 1e-6 * sample)) {
        snprintf(why->text, sizeof why->text,
                 "The step is %g s; the controller samples every %g s.", step, sample);
        return false;
    }
    for (int i = 0; i < JOINTS; i++) {
        own[INTEGRAL + i] += own[COMMAND + i] * sample;
        own[PREVIOUS + i] = own[ERROR + i];
    }
    component_output(component, workspace, why);
    remember(component);
    return true;
}
