/* The seam between FMI and the equations of a component.
 *
 * A component is a plain struct of doubles: one for each scalar variable of the interface, whose
 * index is its place in the generated table, and what it remembers besides. It holds no pointers,
 * so its state is a copy of it. The glue (fmi2*.c) knows only what is declared here, and a
 * component knows nothing of FMI.
 *
 * Value references are the glue's alone: a table leads from each to its first place.
 *
 * The generated interface.h defines MODEL_GUID, the PREFERRED_STEP, how many VARIABLES, STATES and
 * INDICATORS there are, how many doubles the component remembers besides (OWN), up to which
 * variable there may be inputs with SLOPES, whether it makes INNER_STEPS, and the tables of these.
 */
#ifndef COMPONENT_H
#define COMPONENT_H

#include <stdbool.h>

#include "interface.h"

/* Of functions that are to be small rather than quick. On Windows isfinite() is a function that
 * must be inlined. */
#if defined(__clang__) && !defined(_WIN32)
#define SELDOM __attribute__((cold, minsize))
#else
#define SELDOM
#endif

typedef struct {
    double v[VARIABLES];           /* Integers and enumerations included */
    double own[OWN > 0 ? OWN : 1]; /* zero at the start; the glue only copies it */
    double slope[SLOPES];          /* of inputs over the next step [unit/s], kept by the glue */
    double time;                   /* [s], kept by the glue */
    double may_end_early;          /* whether a step may end at an event, kept by the glue */
    double done;                   /* of the last step [s] */
    double event;                  /* whether there was one at its end */
    double changed; /* whether more than inputs has been set since the component put it to zero */
} Component;

/* One sentence for the user: why a function refused, or what happened. */
typedef struct {
    char text[256];
} Message;

/* To be defined by the component. The glue has put start values, parameters and inputs into
 * `v` before it calls any of them. A function that returns false has changed nothing and says why.
 */

/* Get what the functions below work with besides the component and what nobody needs to save: a
 * model read from the FMU's resources, say. NULL, with the reason, if that cannot be had. */
static void *component_open(const char *resources, Message *why);
static void component_close(void *workspace);

/* Once, when all start values are known, after the first event and before the first output. */
static bool component_initialise(Component *component, void *workspace, Message *why);

/* Compute outputs, local variables and derivatives from inputs, states, parameters and what was
 * held at the last event; nothing of these moves. */
static bool component_output(Component *component, void *workspace, Message *why);

/* Move the states by `step` > 0 [s] with the inputs held, and compute as component_output does for
 * the end of the step; it may leave out derivatives. With INNER_STEPS the inputs are those of the
 * step's beginning, from which they follow their slopes; such a component says whether there was an
 * event at the end of the step, and where it may, ends the step at the first one and says how much
 * is done. The glue advances the time afterwards. */
static bool component_step(Component *component, void *workspace, double step, Message *why);

/* Compute the variables that are marked as on demand. */
static void component_demand(Component *component);

/* Bring what is held between events up to date with the inputs; true if that changed anything, with
 * what it was in `what` if this is not NULL. In co-simulation every evaluation is such an event.
 * What is nearer to zero than `rest` of its units counts as zero. */
static bool component_event(Component *component, double rest, Message *what);

/* Positive while what is held agrees with the inputs, else not. */
static void component_indicators(const Component *component, double rest, double *indicator);

/* Derivatives of continuous outputs and of state derivatives along a direction: `seed` holds the
 * direction for inputs, states and tunable parameters, and zeros; both have VARIABLES elements. */
static void component_tangent(const Component *component, const double *seed, double *tangent);

#endif
