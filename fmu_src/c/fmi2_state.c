/* FMI 2.0: saving and restoring the whole state of an instance. */
#include "fmi2_instance.h"

/* A serialised state carries the GUID, so that it cannot be read into another model. */
typedef struct {
    char guid[sizeof MODEL_GUID];
    Memory memory;
} Saved;

FMI2_STATUS(fmi2GetFMUstate)(fmi2Component c, fmi2FMUstate *state) {
    Instance *instance = entered_with(c, MAY_COPY_STATE, "fmi2GetFMUstate", state);
    if (!instance) {
        return fmi2Error;
    }
    Saved *saved = *state ? *state : calloc(1, sizeof *saved);
    if (!saved) {
        complain(instance, "fmi2GetFMUstate: out of memory.");
        return fmi2Error;
    }
    memcpy(saved->guid, MODEL_GUID, sizeof saved->guid);
    memcpy(&saved->memory, &instance->memory, sizeof saved->memory);
    *state = saved;
    return fmi2OK;
}

FMI2_STATUS(fmi2SetFMUstate)(fmi2Component c, fmi2FMUstate state) {
    static const char function[] = "fmi2SetFMUstate";
    Instance *instance = entered_with(c, MAY_COPY_STATE, function, state);
    const Saved *saved = state;
    if (!instance) {
        return fmi2Error;
    }
    if (saved->memory.type != instance->memory.type) {
        complain(instance, "%s: the state is one of the FMU's other type.", function);
        return fmi2Error;
    }
    memcpy(&instance->memory, &saved->memory, sizeof instance->memory);
    return fmi2OK;
}

FMI2_STATUS(fmi2FreeFMUstate)(fmi2Component c, fmi2FMUstate *state) {
    if (!entered(c, MAY_COPY_STATE, "fmi2FreeFMUstate")) {
        return fmi2Error;
    }
    if (state) {
        free(*state);
        *state = NULL;
    }
    return fmi2OK;
}

FMI2_STATUS(fmi2SerializedFMUstateSize)(fmi2Component c, fmi2FMUstate state, size_t *size) {
    static const char function[] = "fmi2SerializedFMUstateSize";
    if (!entered_with(c, MAY_COPY_STATE, function, state && size ? size : NULL)) {
        return fmi2Error;
    }
    *size = sizeof(Saved);
    return fmi2OK;
}

FMI2_STATUS(fmi2SerializeFMUstate)
(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    static const char function[] = "fmi2SerializeFMUstate";
    Instance *instance = entered_with(c, MAY_COPY_STATE, function, state ? bytes : NULL);
    if (!instance) {
        return fmi2Error;
    }
    if (size < sizeof(Saved)) {
        complain(instance, "%s: %lu bytes for a state of %lu.", function, (unsigned long)size,
                 (unsigned long)sizeof(Saved));
        return fmi2Error;
    }
    memcpy(bytes, state, sizeof(Saved));
    return fmi2OK;
}

FMI2_STATUS(fmi2DeSerializeFMUstate)
(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    static const char function[] = "fmi2DeSerializeFMUstate";
    Instance *instance = entered_with(c, MAY_COPY_STATE, function, state ? bytes : NULL);
    if (!instance) {
        return fmi2Error;
    }
    if (size != sizeof(Saved) || memcmp(bytes, MODEL_GUID, sizeof MODEL_GUID) != 0) {
        complain(instance, "%s: the %lu bytes are not a state of this model.", function,
                 (unsigned long)size);
        return fmi2Error;
    }
    Saved *saved = *state ? *state : calloc(1, sizeof *saved);
    if (!saved) {
        complain(instance, "%s: out of memory.", function);
        return fmi2Error;
    }
    memcpy(saved, bytes, sizeof *saved);
    *state = saved;
    return fmi2OK;
}
