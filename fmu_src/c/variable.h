/* What the glue and the component know of a variable. The generated interface.h fills a table. */
#ifndef VARIABLE_H
#define VARIABLE_H

typedef enum {
    INPUT,   /* set at any time */
    OUTPUT,  /* computed */
    LOCAL,   /* computed, not for connection */
    STATE,   /* set before the initialisation ends, then moved by steps */
    FIXED,   /* parameter, set before the initialisation ends */
    TUNABLE, /* parameter, set at any time */
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
} Variable;

#endif
