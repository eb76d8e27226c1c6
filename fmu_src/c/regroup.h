/* Parameters of dynamics.h from those of links and payload.
 *
 * The component defines TABLE, their place in its own memory, before it includes this file. */
#ifndef REGROUP_H
#define REGROUP_H

#include "dynamics.h"
#include "equations.h"

/* Sum the parameters in the values v, and those of the payload, into p. */
static void gather(const double *v, const double *load, double *p) {
    memset(p, 0, 10 * LINKS * sizeof *p);
    for (int n = 0; n < (int)(sizeof regrouped / sizeof regrouped[0]); n++) {
        const Entry *one = &regrouped[n];
        const int of_load = one->column - 10 * LAST_LINK;
        const double more = of_load >= 0 && of_load < 10 ? load[of_load] : 0.0;
        p[one->row] += one->factor * (v[PARAMETERS + one->column] + more);
    }
}

static const int pair[6][2] = {{0, 0}, {0, 1}, {1, 1}, {0, 2}, {1, 2}, {2, 2}};

static void regroup(Component *component) {
    const double *v = component->v, *c = &v[PAYLOAD_COM], m = v[PAYLOAD_M];
    const double squared = c[0] * c[0] + c[1] * c[1] + c[2] * c[2];
    double load[10] = {m, m * c[0], m * c[1], m * c[2]};
    for (int k = 0; k < 6; k++) { /* Steiner */
        const int i = pair[k][0], j = pair[k][1];
        load[4 + k] = v[PAYLOAD_INERTIA + k] + m * ((i == j ? squared : 0.0) - c[i] * c[j]);
    }
    gather(v, load, &component->own[TABLE]);
    component->changed = 0.0;
}

#endif
