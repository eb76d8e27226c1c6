/* Steps of a co-simulation of FMUs in this process, equal to those of fmu_src/run/master.py.
 *
 * fmu_src/run/native.py loads and initialises the FMUs, fills in these tables and reports failures.
 */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "fmi2.h"

#ifdef _WIN32
#define PUBLIC __declspec(dllexport)
#else
#define PUBLIC __attribute__((visibility("default")))
#endif

/* An FMU with its functions, and the buffers of its inputs and outputs. */
typedef struct {
    fmi2Component component;
    __typeof__(&fmi2SetReal) set;
    __typeof__(&fmi2GetReal) get;
    __typeof__(&fmi2DoStep) step;
    int64_t every; /* its step, in communication steps */
    int64_t inputs;
    int64_t outputs;
    const fmi2ValueReference *input_references;
    const fmi2ValueReference *output_references;
    const int64_t *sources; /* index of each input's value */
    double *input_values;
    double *output_values;
} Station;

/* How the steps ended. */
typedef enum { DONE, NOT_FINITE, OUTSIDE, SET_FAILED, STEP_FAILED, GET_FAILED } End;

/* Recorded rows, and the station and the function that is called, as `End`. Other processes may
 * read it. */
typedef struct {
    int64_t done;
    int64_t station;
    int64_t call;
} StepRecord;

typedef struct {
    const Station *stations;
    int64_t count;
    bool jacobi;
    double step; /* [s] */
    const double *values;
    int64_t size;
    const int64_t *rows; /* indices of the recorded values */
    int64_t width;
    const int64_t *limited; /* indices of the values with limits */
    const double *low;
    const double *high;
    int64_t limits;
    double *kept; /* (steps + 1, width) */
    StepRecord *progress;
    fmi2Status status;
} System;

/* Every other status is an error, including values that FMI does not define. */
static bool is_good(fmi2Status status) {
    return status == fmi2OK || status == fmi2Warning;
}

/* Note the station and the function that is called next. */
static void note(System *s, int64_t i, End call) {
    s->progress->station = i;
    s->progress->call = call;
}

/* Set the inputs of a station from the values of the system. */
static bool set_inputs(System *s, int64_t i) {
    const Station *at = &s->stations[i];
    if (at->inputs == 0) {
        return true;
    }
    for (int64_t j = 0; j < at->inputs; j++) {
        at->input_values[j] = s->values[at->sources[j]];
    }
    note(s, i, SET_FAILED);
    s->status = at->set(at->component, at->input_references, (size_t)at->inputs, at->input_values);
    return is_good(s->status);
}

/* Step a station to the end of communication step k. */
static bool do_step(System *s, int64_t i, int64_t k) {
    const Station *at = &s->stations[i];
    const double from = (double)(k + 1 - at->every) * s->step;
    note(s, i, STEP_FAILED);
    s->status = at->step(at->component, from, (double)at->every * s->step, fmi2True);
    return is_good(s->status);
}

/* Read the outputs of a station into the values of the system. */
static bool read_outputs(System *s, int64_t i) {
    const Station *at = &s->stations[i];
    if (at->outputs == 0) {
        return true;
    }
    note(s, i, GET_FAILED);
    s->status =
        at->get(at->component, at->output_references, (size_t)at->outputs, at->output_values);
    return is_good(s->status);
}

/* Take communication step k by Gauss-Seidel: a station sees new outputs of those before it. */
static bool gauss_seidel(System *s, int64_t k) {
    bool good = true;
    for (int64_t i = 0; good && i < s->count; i++) {
        if ((k + 1) % s->stations[i].every == 0) {
            good = set_inputs(s, i) && do_step(s, i, k) && read_outputs(s, i);
        }
    }
    return good;
}

/* Take communication step k by Jacobi: all stations see the outputs of the previous step. */
static bool jacobi(System *s, int64_t k) {
    bool good = true;
    for (int64_t i = 0; good && i < s->count; i++) {
        good = k % s->stations[i].every != 0 || set_inputs(s, i);
    }
    for (int64_t i = 0; good && i < s->count; i++) {
        good = (k + 1) % s->stations[i].every != 0 || do_step(s, i, k);
    }
    for (int64_t i = 0; good && i < s->count; i++) {
        good = (k + 1) % s->stations[i].every != 0 || read_outputs(s, i);
    }
    return good;
}

/* Step until `stop` rows are recorded; return how the steps ended. */
PUBLIC int advance(System *s, int64_t stop) {
    while (s->progress->done < stop) {
        const int64_t k = s->progress->done;
        if (k > 0) {
            const bool good = s->jacobi ? jacobi(s, k - 1) : gauss_seidel(s, k - 1);
            if (!good) {
                return (int)s->progress->call;
            }
        }
        for (int64_t i = 0; i < s->size; i++) {
            if (!isfinite(s->values[i])) {
                return NOT_FINITE;
            }
        }
        for (int64_t i = 0; i < s->width; i++) {
            s->kept[k * s->width + i] = s->values[s->rows[i]];
        }
        s->progress->done = k + 1;
        for (int64_t i = 0; i < s->limits; i++) {
            const double value = s->values[s->limited[i]];
            if (value < s->low[i] || value > s->high[i]) {
                return OUTSIDE;
            }
        }
    }
    return DONE;
}

/* Step a component through rows of inputs, after `done` of them: step k starts at times[k] and has
 * length sizes[k]. */
PUBLIC int through(const Station *at, const double *times, const double *sizes, const double *rows,
                   double *kept, int64_t stop, int64_t *done, fmi2Status *status) {
    for (; *done < stop; ++*done) {
        const int64_t k = *done;
        *status =
            at->set(at->component, at->input_references, (size_t)at->inputs, rows + k * at->inputs);
        if (!is_good(*status)) {
            return SET_FAILED;
        }
        *status = at->step(at->component, times[k], sizes[k], fmi2True);
        if (!is_good(*status)) {
            return STEP_FAILED;
        }
        *status = at->get(at->component, at->output_references, (size_t)at->outputs,
                          kept + k * at->outputs);
        if (!is_good(*status)) {
            return GET_FAILED;
        }
    }
    return DONE;
}
