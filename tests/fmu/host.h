/* Shared by the hosts of the tests: load a binary on any platform and begin a simulation. */
#ifndef HOST_H
#define HOST_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmi2.h"
#include "motion.h"

#ifdef _WIN32
#include <windows.h>
static void *load(const char *path) {
    return (void *)LoadLibraryA(path);
}
static void *find(void *library, const char *name) {
    FARPROC f = GetProcAddress((HMODULE)library, name);
    void *p = NULL;
    memcpy(&p, &f, sizeof p);
    return p;
}
#else
#include <dlfcn.h>
static void *load(const char *path) {
    return dlopen(path, RTLD_NOW | RTLD_LOCAL);
}
static void *find(void *library, const char *name) {
    return dlsym(library, name);
}
#endif

#define STEP 0.005 /* s */

static void fail(const char *what) {
    fprintf(stderr, "%s\n", what);
    exit(1);
}

static void logger(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                   fmi2String category, fmi2String message, ...) {
    (void)environment, (void)instance, (void)status, (void)category;
    fprintf(stderr, "%s\n", message);
}

/* A function of the library, as one of its declared type. */
#define FUNCTION(name)                                                                             \
    __typeof__(&name) name##_ = NULL;                                                              \
    {                                                                                              \
        void *found = find(library, #name);                                                        \
        if (!found) {                                                                              \
            fail(#name " is missing");                                                             \
        }                                                                                          \
        memcpy(&name##_, &found, sizeof found);                                                    \
    }

#define DO(call)                                                                                   \
    if ((call) != fmi2OK) {                                                                        \
        fail(#call);                                                                               \
    }

/* Declare the functions of a simulation as variables, found in `library`. */
#define FUNCTIONS                                                                                  \
    FUNCTION(fmi2Instantiate)                                                                      \
    FUNCTION(fmi2FreeInstance)                                                                     \
    FUNCTION(fmi2SetupExperiment)                                                                  \
    FUNCTION(fmi2EnterInitializationMode)                                                          \
    FUNCTION(fmi2ExitInitializationMode)                                                           \
    FUNCTION(fmi2SetReal)                                                                          \
    FUNCTION(fmi2GetReal)                                                                          \
    FUNCTION(fmi2DoStep)

/* Declare an instance `c` and initialise it at time 0. */
#define BEGIN(guid, resources)                                                                     \
    static const fmi2CallbackFunctions host = {logger, NULL, NULL, NULL, NULL};                    \
    fmi2Component c =                                                                              \
        fmi2Instantiate_("host", fmi2CoSimulation, guid, resources, &host, fmi2False, fmi2False);  \
    if (!c) {                                                                                      \
        fail("no instance");                                                                       \
    }                                                                                              \
    DO(fmi2SetupExperiment_(c, fmi2False, 0.0, 0.0, fmi2False, 0.0))                               \
    DO(fmi2EnterInitializationMode_(c))                                                            \
    DO(fmi2ExitInitializationMode_(c))

#endif
