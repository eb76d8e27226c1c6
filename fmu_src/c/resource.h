/* Path of a file in the resources of an FMU, whose location hosts pass as a URI. */
#ifndef RESOURCE_H
#define RESOURCE_H

#include <ctype.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

static int hexadecimal(char c) {
    return isdigit((unsigned char)c) ? c - '0' : tolower((unsigned char)c) - 'a' + 10;
}

/* Hosts write file:/x, file:///x, file://localhost/x and, against the standard, /x. */
static bool path_of_resource(const char *uri, const char *name, char *path, size_t size) {
    const char *from = uri ? uri : "";
    size_t n = 0;
    const bool encoded = strncmp(from, "file:", 5) == 0;
    if (encoded) {
        from += 5;
        from = strncmp(from, "//", 2) == 0 ? strchr(from + 2, '/') : from;
    }
    if (!from || !*from) {
        return false;
    }
    for (; *from && n + 1 < size; from++) {
        if (encoded && *from == '%' && isxdigit((unsigned char)from[1]) &&
            isxdigit((unsigned char)from[2])) {
            path[n++] = (char)(16 * hexadecimal(from[1]) + hexadecimal(from[2]));
            from += 2;
        } else {
            path[n++] = *from;
        }
    }
#ifdef _WIN32
    /* The path of file:///C:/x is C:/x. */
    if (encoded && n > 2 && path[0] == '/' && path[2] == ':') {
        memmove(path, path + 1, --n);
    }
#endif
    const int rest = snprintf(path + n, size - n, "/%s", name);
    return *from == '\0' && rest > 0 && (size_t)rest < size - n;
}

#endif
