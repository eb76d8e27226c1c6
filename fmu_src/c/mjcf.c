/* Component: whatever an MJCF describes, simulated by MuJoCo.
 *
 * Inputs drive named actuators, outputs are weighted sums of named sensors with seeded noise; the
 * generated signals.h says which. All that moves is kept in `own` as MuJoCo's integration state, so
 * a component is as easily copied as any other; model and scratch memory are the workspace. */
#include <math.h>
#include <mujoco/mujoco.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "component_plain.h"
#include "signals.h"

#define TWO_PI 6.283185307179586477

/* What is remembered. */
enum { STARTED = 0, SAMPLES = 1, MUJOCO_STATE = 2 };

typedef struct {
    mjModel *model;
    mjModel *original; /* without payload and scales */
    mjData *data;
    double adapted[ADAPTED]; /* the parameters that the model has been given */
} Workspace;

/* The file in the FMU's resources, whose place is given as a URI. */
static bool path_of_model(const char *uri, char *path, size_t size) {
    size_t n = 0;
    const char *from = uri ? uri : "";
    if (strncmp(from, "file:", 5) == 0) {
        from += 5;
        if (strncmp(from, "//", 2) == 0) {
            from = strchr(from + 2, '/');
        }
    }
    for (; from && *from && n + 1 < size; from++) {
        unsigned code;
        if (*from == '%' && sscanf(from + 1, "%2x", &code) == 1) {
            path[n++] = (char)code;
            from += 2;
        } else {
            path[n++] = *from;
        }
    }
    const int rest = snprintf(path + n, size - n, "/%s", MODEL_FILE);
    return from && *from == '\0' && rest > 0 && (size_t)rest < size - n;
}

static void component_close(void *workspace) {
    Workspace *w = workspace;
    if (w) {
        mj_deleteData(w->data);
        mj_deleteModel(w->model);
        mj_deleteModel(w->original);
        free(w);
    }
}

static void *component_open(const char *resources, Message *why) {
    char path[4096];
    Workspace *w = calloc(1, sizeof *w);
    if (!w || !path_of_model(resources, path, sizeof path)) {
        snprintf(why->text, sizeof why->text, "The place of the FMU's resources is not usable.");
        free(w);
        return NULL;
    }
    w->original = mj_loadModel(path, NULL);
    w->model = w->original ? mj_copyModel(NULL, w->original) : NULL;
    w->data = w->model ? mj_makeData(w->model) : NULL;
    if (!w->data || mj_stateSize(w->model, mjSTATE_INTEGRATION) != STATE_SIZE) {
        snprintf(why->text, sizeof why->text, "%s cannot be loaded from the FMU's resources.",
                 MODEL_FILE);
        component_close(w);
        return NULL;
    }
    return w;
}

/* A word of the counter-based generator: splitmix64 over seed, stream and counter. */
static uint64_t mixed(uint64_t z) {
    z += 0x9E3779B97F4A7C15u;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

static double standard_normal(uint64_t seed, uint64_t stream, uint64_t counter) {
    const uint64_t gamma = 0x9E3779B97F4A7C15u;
    const uint64_t base = mixed(mixed(seed) ^ stream);
    const uint64_t first = mixed(base + 2 * counter * gamma);
    const uint64_t second = mixed(base + (2 * counter + 1) * gamma);
    const double u = (double)((first >> 11) + 1) * 0x1p-53;
    const double w = (double)(second >> 11) * 0x1p-53;
    return sqrt(-2.0 * log(u)) * cos(TWO_PI * w);
}

/* Give the model the parameters that change it. */
static void adapt(Workspace *w, const double *v) {
    mjModel *m = w->model;
    mj_copyModel(m, w->original);
    for (int i = 0; i < RUBBING; i++) {
        /* LuGre's forces all scale with its stiffness, damping and levels, the shape stays. */
        const int actuator = rubbing[i];
        mjtNum *bias = &m->actuator_biasprm[actuator * mjNBIAS];
        mjtNum *dynamics = &m->actuator_dynprm[actuator * mjNDYN];
        bias[0] *= v[FRICTION_SCALE];
        bias[3] *= v[FRICTION_SCALE];
        bias[4] *= v[FRICTION_SCALE];
        dynamics[5] *= v[FRICTION_SCALE];
        dynamics[6] *= v[FRICTION_SCALE];
        m->actuator_damping[actuator] *= v[FRICTION_SCALE];
    }
    for (int i = 0; i < m->nu; i++) {
        if (m->actuator_delay[i] > 0.0) {
            m->actuator_delay[i] = v[LATENCY];
        }
    }
    if (PAYLOAD_BODY >= 0) {
        m->body_mass[PAYLOAD_BODY] += v[PAYLOAD];
        mj_setConst(m, w->data);
    }
    memcpy(w->adapted, &v[FRICTION_SCALE], sizeof w->adapted);
}

/* Put the model and the scratch memory where the component is. */
static void restore(const Component *component, Workspace *w) {
    if (memcmp(w->adapted, &component->v[FRICTION_SCALE], sizeof w->adapted) != 0) {
        adapt(w, component->v);
    }
    mj_setState(w->model, w->data, &component->own[MUJOCO_STATE], mjSTATE_INTEGRATION);
}

static double without_noise(const Component *component, const mjData *data, int output) {
    double sum = 0.0;
    for (int i = 0; i < READS; i++) {
        if (reads[i].output == output) {
            const double scale = reads[i].scaled ? component->v[FRICTION_SCALE] : 1.0;
            sum += scale * reads[i].factor * data->sensordata[reads[i].sensor];
        }
    }
    return sum;
}

/* Evaluate the forces at the present instant and read all outputs. */
static void read_sensors(Component *component, Workspace *w) {
    double *v = component->v;
    const uint64_t seed = (uint64_t)v[NOISE_SEED] | (uint64_t)v[NOISE_SEED + 1] << 32;
    mj_forward(w->model, w->data);
    for (int i = 0; i < OUTPUTS; i++) {
        v[FIRST_OUTPUT + i] = without_noise(component, w->data, FIRST_OUTPUT + i);
    }
    for (int i = 0; i < NOISY; i++) {
        const uint64_t counter = (uint64_t)component->own[SAMPLES];
        v[noises[i].output] +=
            v[noises[i].sigma] * standard_normal(seed, noises[i].stream, counter);
    }
}

/* Put everything at its start. */
static void begin(Component *component, Workspace *w) {
    const double *v = component->v;
    adapt(w, v);
    mj_resetData(w->model, w->data);
    for (int i = 0; i < STARTS; i++) {
        double *place = starts[i].activation ? w->data->act : w->data->qpos;
        place[starts[i].index] = v[starts[i].parameter];
    }
    /* What a sum of sensors says at rest, an integral can be made to hold. */
    double held[STARTS > 0 ? STARTS : 1] = {0.0};
    mj_forward(w->model, w->data);
    for (int i = 0; i < STARTS; i++) {
        if (starts[i].held_output >= 0) {
            held[i] = without_noise(component, w->data, starts[i].held_output) / starts[i].gain;
        }
    }
    for (int i = 0; i < STARTS; i++) {
        if (starts[i].held_output >= 0) {
            w->data->act[starts[i].index] += held[i];
        }
    }
    mj_getState(w->model, w->data, &component->own[MUJOCO_STATE], mjSTATE_INTEGRATION);
}

static bool component_initialise(Component *component, void *workspace, Message *why) {
    const double *v = component->v;
    for (int i = FRICTION_SCALE; i < FRICTION_SCALE + ADAPTED; i++) {
        if (!(v[i] >= 0.0)) {
            snprintf(why->text, sizeof why->text, "%s is %g; it must not be negative.",
                     variables[i].name, v[i]);
            return false;
        }
    }
    if (v[LATENCY] > LONGEST_LATENCY) {
        snprintf(why->text, sizeof why->text, "latency is %g s; the model's buffers hold %g s.",
                 v[LATENCY], LONGEST_LATENCY);
        return false;
    }
    begin(component, workspace);
    component->own[STARTED] = 1.0;
    return true;
}

static bool component_output(Component *component, void *workspace, Message *why) {
    (void)why;
    if (component->own[STARTED] > 0.0) {
        restore(component, workspace);
    } else {
        begin(component, workspace); /* before the initialisation ends, start values may change */
    }
    read_sensors(component, workspace);
    return true;
}

static bool component_step(Component *component, void *workspace, double step, Message *why) {
    Workspace *w = workspace;
    const double ratio = step / w->model->opt.timestep;
    const int count = (int)floor(ratio + 0.5);
    if (!(ratio < 1e6) || count < 1 || fabs(ratio - count) > 1e-6) {
        snprintf(why->text, sizeof why->text,
                 "The step is %g s; a multiple of the simulation's own, %g s, is needed.", step,
                 w->model->opt.timestep);
        return false;
    }
    restore(component, w);
    for (int i = 0; i < DRIVES; i++) {
        w->data->ctrl[drives[i].control] = component->v[drives[i].input];
    }
    for (int i = 0; i < count; i++) {
        mj_step(w->model, w->data);
    }
    for (int i = mjWARN_BADQPOS; i <= mjWARN_BADQACC; i++) {
        if (w->data->warning[i].number > 0) {
            snprintf(why->text, sizeof why->text,
                     "The simulation has diverged between %g and %g s.", component->time,
                     component->time + step);
            mj_resetData(w->model, w->data);
            return false;
        }
    }
    component->own[SAMPLES] += 1.0;
    mj_getState(w->model, w->data, &component->own[MUJOCO_STATE], mjSTATE_INTEGRATION);
    read_sensors(component, w);
    return true;
}
