/* For components without events and on-demand variables, and, unless WITH_TANGENT, derivatives. */
#ifndef COMPONENT_PLAIN_H
#define COMPONENT_PLAIN_H

#include "component.h"

static void component_demand(Component *component) {
    (void)component;
}

static bool component_event(Component *component, double rest, Message *what) {
    (void)component, (void)rest, (void)what;
    return false;
}

static bool component_indicators(const Component *component, double rest, double *indicator) {
    (void)component, (void)rest, (void)indicator;
    return true;
}

#ifndef WITH_TANGENT
static void component_tangent(const Component *component, const double *seed, double *tangent) {
    (void)component, (void)seed, (void)tangent;
}
#endif

#endif
