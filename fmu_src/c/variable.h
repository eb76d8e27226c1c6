/* What the glue and the component know of a scalar variable, and how the glue finds those that a
 * host asks for. The generated interface.h fills a table of each. */
#ifndef VARIABLE_H
#define VARIABLE_H

typedef enum {
    INPUT,      /* set at any time */
    OUTPUT,     /* computed */
    ON_DEMAND,  /* computed when somebody reads it */
    LOCAL,      /* computed, not for connection */
    DERIVATIVE, /* of a state, computed when somebody reads it */
    STATE,      /* set before the initialisation ends, then moved by steps or by a solver */
    FIXED,      /* parameter, set before the initialisation ends */
    TUNABLE,    /* parameter, set between steps or at events */
} Role;

typedef enum {
    REAL,
    INTEGER, /* or an enumeration */
} Type;

typedef struct {
    const char *name;
    double start;
    Role role;
    Type type;
    int low, high; /* bounds of an INTEGER */
    int used;      /* whether what is computed depends on it directly, be it at the start only */
} Variable;

/* What a value reference stands for: variables from a place on, one or those of an array. */
typedef struct {
    int first, size;
} Reference;

#endif
