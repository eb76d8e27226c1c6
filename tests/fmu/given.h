/* Start values that a host is given: NAME=VALUE of variables, or of all elements of vectors. */
#ifndef GIVEN_H
#define GIVEN_H

#include <stdlib.h>
#include <string.h>

#include "fmi2.h"
#include "interface.h"

static char **given; /* up to a NULL */

static void start(fmi2Component c) {
    for (char **one = given; one && *one; one++) {
        const size_t length = strcspn(*one, "=");
        const fmi2Real value = atof(*one + length + 1);
        for (fmi2ValueReference v = 0; v < VARIABLES; v++) {
            const char *name = variables[v].name;
            if (strncmp(name, *one, length) == 0 && (!name[length] || name[length] == '[')) {
                const fmi2Integer choice = (fmi2Integer)value;
                if (variables[v].type == INTEGER) {
                    fmi2SetInteger(c, &v, 1, &choice);
                } else {
                    fmi2SetReal(c, &v, 1, &value);
                }
            }
        }
    }
}

#endif
