/* A component of the tests: T x' = u - x, y = x, by the exact step for inputs held; it refuses
 * steps past a given time. */
#include <math.h>
#include <stdio.h>

#include "component_alone.h"
#include "component_plain.h"

/* Value references, in the order of the table in small_fmus.py. */
enum { U, Y, X, DER_X, T, REFUSED, X_START };

/* State in addition: whether the initialisation has ended. */
enum { STARTED };

static bool component_output(Component *component, void *workspace, Message *why) {
    double *v = component->v;
    (void)workspace, (void)why;
    if (component->own[STARTED] == 0.0) {
        v[X] = v[X_START];
    }
    v[DER_X] = (v[U] - v[X]) / v[T];
    v[Y] = v[X];
    return true;
}

static bool component_initialise(Component *component, void *workspace, Message *why) {
    if (!(component->v[T] > 0.0)) {
        snprintf(why->text, sizeof why->text, "T is %g s; it must be positive.", component->v[T]);
        return false;
    }
    component_output(component, workspace, why);
    component->own[STARTED] = 1.0;
    return true;
}

static bool component_step(Component *component, void *workspace, double step, Message *why) {
    double *v = component->v;
    if (component->time + step > v[REFUSED]) {
        snprintf(why->text, sizeof why->text, "The step passes %g s, where it is refused.",
                 v[REFUSED]);
        return false;
    }
    v[X] += (v[U] - v[X]) * -expm1(-step / v[T]);
    return component_output(component, workspace, why);
}
