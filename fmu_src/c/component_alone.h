/* For components without a workspace. */
#ifndef COMPONENT_ALONE_H
#define COMPONENT_ALONE_H

#include "component.h"

static void *component_open(const char *resources, Message *why) {
    static char nothing;
    (void)resources, (void)why;
    return &nothing;
}

static void component_close(void *workspace) {
    (void)workspace;
}

#endif
