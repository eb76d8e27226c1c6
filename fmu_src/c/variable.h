/* Scalar variables for glue and component, in the order of their value references; the generated
 * interface.h has the table. */
#ifndef VARIABLE_H
#define VARIABLE_H

#include <math.h>

typedef enum {
    INPUT,      /* set at any time */
    OUTPUT,     /* computed */
    ON_DEMAND,  /* computed on reading */
    LOCAL,      /* computed, not for connection */
    DERIVATIVE, /* of a state, computed on reading */
    STATE,      /* set before initialisation ends, then advanced by steps or a solver */
    FIXED,      /* parameter, set before initialisation ends */
    TUNABLE,    /* parameter, set between steps or at events */
} Role;

typedef enum {
    REAL,
    INTEGER, /* or an enumeration */
    LOGICAL, /* 0 or 1 */
} Type;

typedef struct {
    const char *name;
    unsigned char role; /* Role and Type, in bytes to keep the table small */
    unsigned char type;
    unsigned char used; /* whether any result depends directly on it, even if only at the start */
    int alike;          /* length of the run of reals without bounds that starts here and needs only
                           one check, or 0 */
} Variable;

#endif
