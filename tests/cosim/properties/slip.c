/* A friction FMU of the tests, as from another tool: three spring-sliders side by side, which have
 * non-local memory, and viscous friction. */
#include "component_alone.h"
#include "component_plain.h"

/* Value references, in the order of the table in subjects.py. */
enum { DQ, Q, TAU_LOAD, TAU };
enum { SLIDERS = 3 };

static const double most[SLIDERS] = {5.0, 3.0, 2.0};            /* N.m */
static const double deflection[SLIDERS] = {4e-4, 1.2e-3, 4e-3}; /* rad */
static const double viscous = 5.0;                              /* N.m.s/rad */

static bool component_initialise(Component *component, void *workspace, Message *why) {
    (void)component, (void)workspace, (void)why;
    return true;
}

static bool component_output(Component *component, void *workspace, Message *why) {
    double tau = viscous * component->v[DQ];
    (void)workspace, (void)why;
    for (int i = 0; i < SLIDERS; i++) {
        tau += most[i] * component->own[i];
    }
    component->v[TAU] = tau;
    return true;
}

static bool component_step(Component *component, void *workspace, double step, Message *why) {
    for (int i = 0; i < SLIDERS; i++) {
        const double x = component->own[i] + component->v[DQ] * step / deflection[i];
        component->own[i] = x > 1.0 ? 1.0 : x < -1.0 ? -1.0 : x;
    }
    return component_output(component, workspace, why);
}
