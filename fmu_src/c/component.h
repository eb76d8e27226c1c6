/* The seam between FMI and the equations of a component.
 *
 * A component is a plain struct of doubles, one for each variable of the interface; the index of a
 * variable is its FMI value reference. It holds no pointers, so its state is a copy of it. The glue
 * (fmi2.c) knows only what is declared here, and a component knows nothing of FMI.
 *
 * The generated interface.h defines MODEL_GUID, VARIABLES (how many there are) and the table
 * `variables`.
 */
#ifndef COMPONENT_H
#define COMPONENT_H

#include <stdbool.h>

#include "interface.h"

/* Values of all variables, Integers and enumerations included, and nothing else. */
typedef struct {
    double v[VARIABLES];
} Component;

/* Why a function of the component returned false, in one sentence for the user. */
typedef struct {
    char text[256];
} Message;

/* To be defined by the component. The glue has put start values, parameters and inputs into
 * `v` before it calls any of them; false means that the simulation cannot go on. */

/* Once, when all start values are known and before the first output. */
static bool component_initialise(Component *component, Message *why);

/* Compute outputs and local variables from inputs, states and parameters, without moving states. */
static bool component_output(Component *component, Message *why);

/* Move the states from `time` to `time + step` [s] with the inputs held; step > 0. The glue calls
 * component_output afterwards. */
static bool component_step(Component *component, double time, double step, Message *why);

#endif
