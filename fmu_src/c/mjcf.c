/* Component: any MJCF model, simulated by MuJoCo.
 *
 * Inputs drive actuators; outputs are weighted sums of sensors with seeded noise, as the generated
 * signals.h defines. MuJoCo's integration state is kept in `own`, so a component can be copied;
 * model and scratch memory are the workspace. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "component_plain.h"
#include "guard.h"
#include "mjcf_losses.h"
#include "mjcf_parameters.h"
#include "mujoco_library.h"
#include "noise.h"
#include "resource.h"
#include "signals.h"

/* The component's own memory: whether initialisation has ended, noise samples, start time [s],
 * MuJoCo steps since then, levels [N.m] and ages [s] of the losses, MuJoCo's state. */
enum {
    STARTED = 0,
    SAMPLES = 1,
    ORIGIN = 2,
    MADE = 3,
    LEVELS = 4,
    AGES = LEVELS + LOSSES,
    MUJOCO_STATE = AGES + LOSSES
};

/* Tolerance of times as a fraction of MuJoCo's step. */
static const double ROUNDING = 1e-6;

/* Maximum number of MuJoCo's steps in a step. */
static const double MAX_STEPS = 1e6;

typedef struct {
    mjModel *model;
    mjModel *original; /* the unmodified model */
    mjData *data;
    bool changed; /* whether and how the model has been modified */
    Changes changes;
    bool sensors_remember; /* whether earlier sensor readings are part of the state */
    bool evaluated;        /* whether the data belong to this state: */
    double state[AGES + LOSSES + STATE_SIZE - LEVELS];
} Workspace;

typedef struct {
    Component *component;
    Workspace *workspace;
    Message *why;
    double steps; /* number of MuJoCo steps to make */
    const char *path;
} Call;

static void component_close(void *workspace) {
    Workspace *w = workspace;
    if (w) {
        mj_deleteData(w->data);
        mj_deleteModel(w->model);
        mj_deleteModel(w->original);
        free(w);
    }
}

/* Load the model; called with MuJoCo's errors caught, as the other functions of a `Call`. */
static bool load(void *argument) {
    const Call *call = argument;
    Workspace *w = call->workspace;
    w->original = mj_loadModel(call->path, NULL);
    if (w->original) {
        w->model = mj_copyModel(NULL, w->original);
    }
    if (w->model) {
        w->data = mj_makeData(w->model);
    }
    for (int i = 0; w->data && i < w->model->nsensor; i++) {
        w->sensors_remember |= w->model->sensor_history[2 * i] > 0;
    }
    return w->data && mj_stateSize(w->model, mjSTATE_INTEGRATION) == STATE_SIZE;
}

static void *component_open(const char *resources, Message *why) {
    char path[4096];
    if (!library_is_there(why)) {
        return NULL;
    }
    if (mj_version() != mjVERSION_HEADER) {
        deny(why, "The host has loaded another MuJoCo, version %d.", mj_version());
        return NULL;
    }
    if (!path_of_resource(resources, MODEL_FILE, path, sizeof path)) {
        deny(why, "fmi2Instantiate: the location of the FMU's resources is needed, as a file URI.");
        return NULL;
    }
    Call call = {.workspace = calloc(1, sizeof(Workspace)), .why = why, .path = path};
    if (!call.workspace || !guarded(load, &call, why)) {
        deny(why, "%s cannot be loaded from the FMU's resources.", MODEL_FILE);
        component_close(call.workspace);
        return NULL;
    }
    return call.workspace;
}

/* Change the model unless it has these changes. */
static void change(Workspace *w, Changes changes) {
    mjModel *m = w->model;
    if (w->changed && memcmp(&w->changes, &changes, sizeof changes) == 0) {
        return;
    }
    w->evaluated = false;
    mj_copyModel(m, w->original);
    for (int i = 0; i < RUBBING; i++) {
        scale_friction(m, rubbing[i], changes.scale);
    }
    for (int i = 0; i < LOSSES; i++) {
        m->dof_damping[losses[i].dof] *= changes.scale;
    }
    for (int i = 0; i < m->nactuator && LATENCY >= 0; i++) {
        if (m->actuator_delay[i] > 0.0) {
            m->actuator_delay[i] = delay_of(m, i, changes.latency);
        }
    }
    if (PAYLOAD_BODY >= 0) {
        m->body_mass[PAYLOAD_BODY] += changes.payload;
        mj_setConst(m, w->data);
    }
    w->changes = changes;
    w->changed = true;
}

/* Store MuJoCo's state in the component. */
static void save(Component *component, const Workspace *w) {
    mj_getState(w->model, w->data, &component->own[MUJOCO_STATE], mjSTATE_INTEGRATION);
}

/* Return model and data to the state of the component. */
static void restore(const Component *component, Workspace *w) {
    change(w, changes_of(component->v));
    memset(w->data->warning, 0, sizeof w->data->warning); /* warnings of a discarded future */
    w->model->opt.disableflags = w->original->opt.disableflags;
    if (w->evaluated && memcmp(&component->own[LEVELS], w->state, sizeof w->state) == 0) {
        return;
    }
    w->evaluated = false;
    set_levels(w->model, &component->own[LEVELS], w->changes.scale);
    mj_setState(w->model, w->data, &component->own[MUJOCO_STATE], mjSTATE_INTEGRATION);
}

/* Evaluate forces and sensors at the state of the component. */
static void evaluate(const Component *component, Workspace *w) {
    if (w->evaluated) {
        return;
    }
    mj_forward(w->model, w->data);
    memcpy(w->state, &component->own[LEVELS], sizeof w->state);
    w->evaluated = true;
}

/* Make one MuJoCo step. If its start has just been evaluated, only forces are evaluated again;
 * Runge-Kutta steps and sleeping bodies require a full evaluation. */
static void make_step(Workspace *w) {
    const mjModel *m = w->model;
    const bool halves = m->opt.integrator != mjINT_RK4 && (m->opt.enableflags & mjENBL_SLEEP) == 0;
    const bool half_done = w->evaluated && halves;
    w->evaluated = false;
    if (half_done) {
        mj_step2(m, w->data);
    } else {
        mj_step(m, w->data);
    }
}

/* Sum the sensors and losses of each output. */
static void read_without_noise(double *v, const Workspace *w) {
    const mjData *data = w->data;
    const double scale = value_or(v, FRICTION_SCALE, 1.0);
    memset(&v[FIRST_OUTPUT], 0, OUTPUTS * sizeof *v);
    for (int i = 0; i < READS; i++) {
        const double read_scale = reads[i].scaled ? scale : 1.0;
        const double factor = read_scale * reads[i].factor;
        v[reads[i].output] += factor * data->sensordata[reads[i].sensor];
    }
    for (int i = 0; i < LOST; i++) {
        v[lost[i].output] += lost_torque(&losses[lost[i].loss], w->model, data);
    }
}

/* Set the outputs at the state of the component, with the noise of this sample. */
static void read_sensors(Component *component, Workspace *w) {
    double *v = component->v;
    const uint64_t seed = seed_half(v, 0) | seed_half(v, 1) << 32;
    evaluate(component, w);
    read_without_noise(v, w);
    for (int i = 0; i < NOISY; i++) {
        const uint64_t counter = (uint64_t)component->own[SAMPLES];
        v[noises[i].output] +=
            v[noises[i].sigma] * standard_normal(seed, noises[i].stream, counter);
    }
}

/* Set the state to the start values. */
static bool begin(void *argument) {
    const Call *call = argument;
    Workspace *w = call->workspace;
    const double *v = call->component->v;
    double *own = call->component->own;
    if (!parameters_are_usable(v, call->why)) {
        return false;
    }
    change(w, changes_of(v));
    w->evaluated = false;
    mj_resetData(w->model, w->data);
    for (int i = 0; i < STARTS; i++) {
        double *place = starts[i].activation ? w->data->act : w->data->qpos;
        place[starts[i].index] = v[starts[i].parameter];
    }
    /* Start an integral so that it holds the other torques on its joint at rest. */
    mj_forward(w->model, w->data);
    for (int i = 0; i < STARTS; i++) {
        if (starts[i].held_dof >= 0) {
            w->data->act[starts[i].index] -=
                w->data->qfrc_smooth[starts[i].held_dof] / starts[i].gain;
        }
    }
    for (int i = 0; i < LOSSES; i++) {
        own[AGES + i] = 0.0;
        own[LEVELS + i] = level_of(&losses[i], w->data, 0.0);
    }
    save(call->component, w);
    return true;
}

static bool component_initialise(Component *component, void *workspace, Message *why) {
    Call call = {.component = component, .workspace = workspace, .why = why};
    if (!guarded(begin, &call, why)) {
        return false;
    }
    component->own[STARTED] = 1.0;
    component->own[ORIGIN] = component->time;
    component->own[MADE] = 0.0;
    return true;
}

/* Set the outputs. */
static bool output(void *argument) {
    const Call *call = argument;
    if (call->component->own[STARTED] > 0.0) {
        restore(call->component, call->workspace);
    } else if (!begin(argument)) { /* before initialisation ends, start values may change */
        return false;
    }
    read_sensors(call->component, call->workspace);
    return true;
}

static bool component_output(Component *component, void *workspace, Message *why) {
    Call call = {.component = component, .workspace = workspace, .why = why};
    return guarded(output, &call, why);
}

/* MuJoCo replaces inputs beyond its bound by zero; refuse them instead. */
static bool drive(const Component *component, const Workspace *w, Message *why) {
    for (int i = 0; i < DRIVES; i++) {
        const double value = component->v[drives[i].input];
        if (!(fabs(value) <= mjMAXVAL)) {
            return deny(why, "%s is %g; the largest that MuJoCo takes is %g.",
                        variables[drives[i].input].name, value, mjMAXVAL);
        }
        w->data->ctrl[drives[i].control] = value;
    }
    return true;
}

/* Whether MuJoCo restarted on divergence or dropped contacts that exceed its memory. */
static bool given_up(const mjData *data, Message *why) {
    for (int i = mjWARN_CONTACTFULL; i < mjNWARNING; i++) {
        const mjWarningStat *warning = &data->warning[i];
        if (warning->number > 0) {
            tell_of_mujoco(why, mju_warningText(i, (size_t)warning->lastinfo));
            return true;
        }
    }
    return false;
}

/* Conditions that MuJoCo would detect at the start of the next step. */
static bool out_of_bounds(const mjModel *m, const mjData *data) {
    bool bad = false;
    for (int i = 0; i < m->nq; i++) {
        bad = bad || mju_isBad(data->qpos[i]);
    }
    for (int i = 0; i < m->nv; i++) {
        bad = bad || mju_isBad(data->qvel[i]);
    }
    return bad;
}

/* Advance levels and ages of the losses by the last step of MuJoCo. */
static void age(Component *component, Workspace *w) {
    double *levels = &component->own[LEVELS];
    double *ages = &component->own[AGES];
    for (int i = 0; i < LOSSES; i++) {
        ages[i] = age_after(&losses[i], w->data, ages[i], w->model->opt.timestep);
        levels[i] = level_of(&losses[i], w->data, ages[i]);
    }
    set_levels(w->model, levels, w->changes.scale);
}

/* Make the steps of MuJoCo. */
static bool advance(void *argument) {
    const Call *call = argument;
    Workspace *w = call->workspace;
    restore(call->component, w);
    if (!drive(call->component, w, call->why)) {
        return false;
    }
    if (!w->sensors_remember) { /* no sensor is read within the step */
        w->model->opt.disableflags |= mjDSBL_SENSOR;
    }
    for (double i = 0.0; i < call->steps; i++) {
        make_step(w);
        if (given_up(w->data, call->why)) {
            return false;
        }
        age(call->component, w);
    }
    if (out_of_bounds(w->model, w->data)) {
        return deny(call->why, "The simulation has diverged.");
    }
    call->component->own[SAMPLES] += 1.0;
    call->component->own[MADE] += call->steps;
    w->model->opt.disableflags = w->original->opt.disableflags;
    save(call->component, w);
    read_sensors(call->component, w);
    return true;
}

/* MuJoCo samples at multiples of its own step and holds its outputs, so any step is valid. */
static bool component_step(Component *component, void *workspace, double step, Message *why) {
    Workspace *w = workspace;
    const double passed = component->time + step - component->own[ORIGIN];
    const double due = floor(passed / w->model->opt.timestep + ROUNDING) - component->own[MADE];
    if (!(due <= MAX_STEPS)) {
        return deny(why, "A step of %g s would be %g of the simulation's own; at most %g are made.",
                    step, due, MAX_STEPS);
    }
    if (due < 1.0) {
        return true;
    }
    const Component before = *component;
    Call call = {.component = component, .workspace = workspace, .why = why, .steps = due};
    if (!guarded(advance, &call, why)) {
        w->evaluated = false;
        mj_resetData(w->model, w->data);
        *component = before;
        return false;
    }
    return true;
}
