/* What the glue and the component know of a variable. The generated interface.h fills a table. */
#ifndef VARIABLE_H
#define VARIABLE_H

typedef enum {
    INPUT,     /* set at any time */
    OUTPUT,    /* computed */
    ON_DEMAND, /* computed when somebody reads it */
    LOCAL,     /* computed, not for connection */
    STATE,     /* set before the initialisation ends, then moved by steps or by a solver */
    FIXED,     /* parameter, set before the initialisation ends */
    TUNABLE,   /* parameter, set between steps or at events */
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
    int felt;      /* whether what is computed depends on it directly, be it at the start only */
} Variable;

#endif
