/* Parameters of dynamics.h from those of links and payload.
 *
 * The component defines TABLE, their place in its own memory, before it includes this file. */
#ifndef REGROUP_H
#define REGROUP_H

#include "dynamics.h"
#include "equations.h"

/* Sum the parameters in the values v, and the ten of the payload, into p. */
static void gather(const double *v, const double *payload, double *p) {
    memset(p, 0, 10 * LINKS * sizeof *p);
    for (int n = 0; n < (int)(sizeof regrouped / sizeof regrouped[0]); n++) {
        const Entry *entry = &regrouped[n];
        const int place = entry->column - 10 * LAST_LINK; /* among those of the last link */
        const double added = place >= 0 && place < 10 ? payload[place] : 0.0;
        p[entry->row] += entry->factor * (v[PARAMETERS + entry->column] + added);
    }
}

/* Rows and columns of an inertia's six parameters. */
static const int pair[6][2] = {{0, 0}, {0, 1}, {1, 1}, {0, 2}, {1, 2}, {2, 2}};

/* Compute the parameters of dynamics.h from those in the variables. */
static void regroup(Component *component) {
    const double *v = component->v;
    const double *c = &v[PAYLOAD_COM];
    const double m = v[PAYLOAD_M];
    const double squared = c[0] * c[0] + c[1] * c[1] + c[2] * c[2];
    double payload[10] = {m, m * c[0], m * c[1], m * c[2]};
    for (int k = 0; k < 6; k++) { /* Steiner */
        const int i = pair[k][0];
        const int j = pair[k][1];
        const double diagonal = i == j ? squared : 0.0;
        payload[4 + k] = v[PAYLOAD_INERTIA + k] + m * (diagonal - c[i] * c[j]);
    }
    gather(v, payload, &component->own[TABLE]);
    component->changed = 0.0;
}

#endif
