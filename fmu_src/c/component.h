/* Interface between FMI and the equations of a component, independent of FMI.
 *
 * A component is a struct of doubles: one per scalar variable, at its index in the generated table,
 * and its own memory. It holds no pointers, so copying it saves its state. The glue (fmi2*.c) uses
 * only the declarations here; value references are indices of variables.
 *
 * The generated interface.h defines MODEL_GUID, PREFERRED_STEP, the numbers of VARIABLES, STATES
 * and INDICATORS, the size of the own memory (OWN), the number of leading variables that may be
 * inputs with SLOPES, whether the component makes INNER_STEPS, and the tables. */
#ifndef COMPONENT_H
#define COMPONENT_H

#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>

#include "interface.h"

/* Attribute of functions optimised for size. Not on Windows, where isfinite() is a function that
 * must be inlined. */
#if defined(__clang__) && !defined(_WIN32)
#define SELDOM __attribute__((cold, minsize))
#else
#define SELDOM
#endif

/* Attribute of functions that would be copied into several callers. */
#ifdef __GNUC__
#define NOINLINE __attribute__((noinline))
#else
#define NOINLINE
#endif

typedef struct {
    double v[VARIABLES];           /* including integers and enumerations */
    double own[OWN > 0 ? OWN : 1]; /* initially zero; the glue only copies it */
    double slope[SLOPES]; /* of inputs over the next step [unit/s], maintained by the glue */
    double time;          /* [s], maintained by the glue */
    double may_end_early; /* whether a step may end at an event, maintained by the glue */
    double continuous;    /* whether a solver integrates the states, maintained by the glue */
    double done;          /* completed length of the last step [s] */
    double event;         /* whether the last step ended at an event */
    double changed; /* whether more than inputs was set since the component cleared this flag */
} Component;

/* One sentence for the user: the reason of a refusal, or an event. */
typedef struct {
    char text[256];
} Message;

/* Write a message, usually the reason of a refusal; always return false. */
SELDOM static inline bool deny(Message *why, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(why->text, sizeof why->text, format, arguments);
    va_end(arguments);
    return false;
}

/* Check a parameter; NaN fails. */
static inline bool sound(const double *v, int i, bool right, const char *needed, Message *why) {
    return right || deny(why, "%s is %g; it must %s.", variables[i].name, v[i], needed);
}

/* Functions of a component. Before calling any, the glue stores start values, parameters and inputs
 * in `v`. One that returns false has changed nothing and gives the reason. */

/* Open the workspace, which is not part of the state, such as a model from the FMU's resources.
 * Returns NULL, with the reason, on failure. */
static void *component_open(const char *resources, Message *why);
static void component_close(void *workspace);

/* Called once, when all start values are known, after the first event and before the first
 * output. */
static bool component_initialise(Component *component, void *workspace, Message *why);

/* Compute outputs, local variables and derivatives from inputs, states, parameters and held values,
 * without changing these. */
static bool component_output(Component *component, void *workspace, Message *why);

/* Advance the states by `step` > 0 [s] with the inputs held, and compute the outputs at its end as
 * component_output does; derivatives may be omitted. With INNER_STEPS the inputs follow their
 * slopes from the start; such a component reports an event at the end of the step or, if allowed,
 * ends it at the first one and reports the completed length. The glue then advances the time. */
static bool component_step(Component *component, void *workspace, double step, Message *why);

/* Compute the variables marked ON_DEMAND. */
static void component_demand(Component *component);

/* Update the values held between events from the inputs. Returns whether any changed, described in
 * `what` unless NULL. In co-simulation every evaluation is such an event. An input within `rest` of
 * zero counts as zero. */
static bool component_event(Component *component, double rest, Message *what);

/* Compute the event indicators, positive while a held value agrees with the inputs. Returns whether
 * all values do, also those without an indicator. */
static bool component_indicators(const Component *component, double rest, double *indicator);

/* Derivatives of continuous outputs and state derivatives along `seed`, a direction of inputs,
 * states and tunable parameters; both have VARIABLES elements. */
static void component_tangent(const Component *component, const double *seed, double *tangent);

#endif
