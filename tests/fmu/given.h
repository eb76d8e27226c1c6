/* Start values of a host: NAME=VALUE of variables, or of all elements of vectors. */
#ifndef GIVEN_H
#define GIVEN_H

#include <stdlib.h>
#include <string.h>

#include "fmi.h"

static char **given; /* up to a NULL */

static void start(Fmu c) {
    for (char **one = given; one && *one; one++) {
        const size_t length = strcspn(*one, "=");
        const double value = atof(*one + length + 1);
        for (Ref v = 0; v < VARIABLES; v++) {
            const char *name = variables[v].name;
            if (strncmp(name, *one, length) == 0 && (!name[length] || name[length] == '[')) {
                set_at(c, v, value);
            }
        }
    }
}

#endif
