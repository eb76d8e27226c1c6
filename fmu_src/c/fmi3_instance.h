/* Instance of FMI 3.0: one of FMI 2.0 with additions. */
#ifndef FMI3_INSTANCE_H
#define FMI3_INSTANCE_H

#include "fmi2_instance.h"
#include "fmi3.h"

typedef struct {
    Instance *inner;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    bool events; /* whether the host enabled event mode */
    bool early;  /* whether steps may end early */
} Outer;

#define INNER(c) ((c) ? ((Outer *)(c))->inner : NULL)
#define STATUS(call) ((fmi3Status)(call))

/* Functions that only call one of FMI 2.0. */
#define FMI3_FORWARD(name, inner, parameters, ...)                                                 \
    FMI3_STATUS(name) parameters {                                                                 \
        return STATUS(inner(INNER(c), __VA_ARGS__));                                               \
    }
#define FMI3_FORWARD_ALONE(name, inner)                                                            \
    FMI3_STATUS(name)(fmi3Instance c) {                                                            \
        return STATUS(inner(INNER(c)));                                                            \
    }

static Memory *memory_of(fmi3Instance c) {
    return &((Outer *)c)->inner->memory;
}

/* Functions of FMI 2.0 with other names in FMI 3.0, then the prefix of all others. */
static const char *const renamed[][2] = {
    {"fmi2SetReal", "fmi3SetFloat64"},
    {"fmi2GetReal", "fmi3GetFloat64"},
    {"fmi2SetInteger", "fmi3SetInt32"},
    {"fmi2GetInteger", "fmi3GetInt32"},
    {"fmi2SetupExperiment", "fmi3EnterInitializationMode"},
    {"fmi2NewDiscreteStates", "fmi3UpdateDiscreteStates"},
    {"fmi2GetDerivatives", "fmi3GetContinuousStateDerivatives"},
    {"fmi2GetFMUstate", "fmi3GetFMUState"},
    {"fmi2SetFMUstate", "fmi3SetFMUState"},
    {"fmi2FreeFMUstate", "fmi3FreeFMUState"},
    {"fmi2SerializedFMUstateSize", "fmi3SerializedFMUStateSize"},
    {"fmi2SerializeFMUstate", "fmi3SerializeFMUState"},
    {"fmi2DeSerializeFMUstate", "fmi3DeserializeFMUState"},
    {"fmi2", "fmi3"},
};

/* Forward a message of the inner instance, renaming the function that it starts with. */
static void pass_on(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                    fmi2String category, fmi2String message, ...) {
    const Outer *outer = (const Outer *)environment;
    char text[sizeof(Message) + 512];
    (void)name;
    for (size_t i = 0; i < sizeof renamed / sizeof renamed[0]; i++) {
        const size_t length = strlen(renamed[i][0]);
        if (strncmp(message, renamed[i][0], length) == 0) {
            snprintf(text, sizeof text, "%s%s", renamed[i][1], message + length);
            message = text;
            break;
        }
    }
    outer->log(outer->environment, (fmi3Status)status, category, message);
}

#endif
