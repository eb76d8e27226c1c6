/* Component: velocity of measured positions, by backward differences and a first-order low-pass.
 *
 * The generated filter.h says where the variables stand. */
#include <math.h>
#include <stdio.h>

#include "component_alone.h"
#include "component_plain.h"
#include "filter.h"

/* What is remembered: the positions of the last sample [rad]. */
static bool component_initialise(Component *component, void *workspace, Message *why) {
    (void)workspace;
    if (!(component->v[TIME_CONSTANT] >= 0.0)) {
        snprintf(why->text, sizeof why->text, "time_constant is %g s; it must not be negative.",
                 component->v[TIME_CONSTANT]);
        return false;
    }
    for (int i = 0; i < JOINTS; i++) {
        component->own[i] = component->v[POSITION + i];
    }
    return true;
}

static bool component_output(Component *component, void *workspace, Message *why) {
    (void)component, (void)workspace, (void)why; /* it changes by steps only, from zero */
    return true;
}

static bool component_step(Component *component, void *workspace, double step, Message *why) {
    double *v = component->v, *own = component->own;
    const double tau = v[TIME_CONSTANT];
    const double share = tau > 0.0 ? -expm1(-step / tau) : 1.0;
    (void)workspace, (void)why;
    for (int i = 0; i < JOINTS; i++) {
        const double speed = (v[POSITION + i] - own[i]) / step;
        v[VELOCITY + i] += share * (speed - v[VELOCITY + i]);
        own[i] = v[POSITION + i];
    }
    return true;
}
