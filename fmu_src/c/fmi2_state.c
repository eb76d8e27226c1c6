/* FMI 2.0: saving and restoring the state of an instance. */
#include <stddef.h>
#include <stdint.h>

#include "fmi2_instance.h"

enum { STATE_VERSION = 1 };

/* A serialised state carries the GUID, which identifies the model, and a checksum. */
typedef struct {
    char guid[sizeof numbers.guid];
    uint32_t version;
    uint64_t sum; /* zero except in the serialised bytes */
    Memory memory;
} Saved;

/* FNV-1a over words. Sums are folded, because a product leaves a word's sign bit in place and two
 * would cancel. States that differ in one word have different sums. */
static uint64_t sum_of(const Saved *saved) {
    const unsigned char *bytes = (const unsigned char *)saved;
    uint64_t sum = 14695981039346656037u;
    for (size_t i = 0; i + sizeof sum <= sizeof *saved; i += sizeof sum) {
        uint64_t word;
        memcpy(&word, bytes + i, sizeof word);
        sum = (sum ^ word) * 1099511628211u;
        sum ^= sum >> 32;
    }
    return sum;
}

static bool is_mode(int mode, int type) {
    const int own = type == fmi2ModelExchange ? AT_EVENT | CONTINUOUS : STEPPING;
    const int known = INSTANTIATED | INITIALISING | TERMINATED | FAILED | own;
    return mode > 0 && (mode & (mode - 1)) == 0 && (mode & known) != 0;
}

/* Whether host or solver could have set the current values. */
SELDOM static bool in_range(const Component *component, Message *why) {
    for (int i = 0; i < VARIABLES; i++) {
        const double value = component->v[i], slope = i < SLOPES ? component->slope[i] : 0.0;
        const int role = variables[i].role;
        const bool whole = value >= numbers.of[i].low && value <= numbers.of[i].high &&
                           (variables[i].type == REAL || value == floor(value));
        const bool set = role == INPUT || role == STATE || role == FIXED || role == TUNABLE;
        if (set && !(isfinite(value) && isfinite(slope) && whole)) {
            return deny(why, "%s is %g", variables[i].name, value);
        }
    }
    for (int i = 0; i < OWN; i++) {
        if (!isfinite(component->own[i])) {
            return deny(why, "a state in it is %g", component->own[i]);
        }
    }
    return true;
}

/* Whether a memory is valid for an instance; after a failure any values are. */
SELDOM static bool is_possible(const Memory *memory, Message *why) {
    const bool typed =
        memory->type == fmi2CoSimulation || (memory->type == fmi2ModelExchange && MODEL_EXCHANGE);
    if (!typed || !is_mode(memory->mode, memory->type) || memory->refusals < 0 ||
        memory->refusals > MOST_REFUSALS + 1 ||
        (memory->sloped | memory->stale | memory->paused) >> 1 != 0 || isnan(memory->stop) ||
        !isfinite(memory->refused) || !isfinite(memory->component.time)) {
        return deny(why, "no instance can have this state");
    }
    return memory->mode == FAILED ||
           (in_range(&memory->component, why) && (memory->stale || all_finite(memory, why)));
}

FMI2_STATUS(fmi2GetFMUstate)(fmi2Component c, fmi2FMUstate *state) {
    ENTER(entered_with(c, ANY, "fmi2GetFMUstate", state));
    Saved *saved = (Saved *)(*state ? *state : calloc(1, sizeof *saved));
    if (!saved) {
        return complain(instance, "fmi2GetFMUstate: out of memory.");
    }
    copy_guid(saved->guid);
    saved->version = STATE_VERSION;
    memcpy(&saved->memory, &instance->memory, sizeof saved->memory);
    *state = saved;
    return fmi2OK;
}

FMI2_STATUS(fmi2SetFMUstate)(fmi2Component c, fmi2FMUstate state) {
    static const char function[] = "fmi2SetFMUstate";
    const Saved *saved = (const Saved *)state;
    ENTER(entered_with(c, ANY, function, state));
    if (saved->memory.type != instance->memory.type) {
        return complain(instance, "%s: the state is one of the FMU's other type.", function);
    }
    memcpy(&instance->memory, &saved->memory, sizeof instance->memory);
    return fmi2OK;
}

FMI2_STATUS(fmi2FreeFMUstate)(fmi2Component c, fmi2FMUstate *state) {
    if (!entered(c, ANY, "fmi2FreeFMUstate")) {
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
    if (!entered_with(c, ANY, function, state && size ? size : NULL)) {
        return fmi2Error;
    }
    *size = sizeof(Saved);
    return fmi2OK;
}

FMI2_STATUS(fmi2SerializeFMUstate)
(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    static const char function[] = "fmi2SerializeFMUstate";
    ENTER(entered_with(c, ANY, function, state ? bytes : NULL));
    if (size < sizeof(Saved)) {
        return complain(instance, "%s: %lu bytes for a state of %lu.", function,
                        (unsigned long)size, (unsigned long)sizeof(Saved));
    }
    const uint64_t sum = sum_of((const Saved *)state);
    memcpy(bytes, state, sizeof(Saved));
    memcpy(bytes + offsetof(Saved, sum), &sum, sizeof sum);
    return fmi2OK;
}

/* Whether the bytes are a serialised state; removes the checksum. */
static bool is_sound(Saved *saved, Message *why) {
    const uint64_t sum = saved->sum;
    saved->sum = 0;
    if (saved->version != STATE_VERSION) {
        return deny(why, "it is of version %lu, expected %d", (unsigned long)saved->version,
                    STATE_VERSION);
    }
    if (sum != sum_of(saved)) {
        return deny(why, "its checksum is wrong");
    }
    return is_possible(&saved->memory, why);
}

FMI2_STATUS(fmi2DeSerializeFMUstate)
(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    static const char function[] = "fmi2DeSerializeFMUstate";
    Message why;
    char guid[sizeof numbers.guid];
    ENTER(entered_with(c, ANY, function, state ? bytes : NULL));
    copy_guid(guid);
    if (size != sizeof(Saved) || memcmp(bytes, guid, sizeof guid) != 0) {
        return complain(instance, "%s: the %lu bytes are not a state of this model.", function,
                        (unsigned long)size);
    }
    Saved *saved = (Saved *)malloc(sizeof *saved);
    if (!saved) {
        return complain(instance, "%s: out of memory.", function);
    }
    memcpy(saved, bytes, sizeof *saved);
    if (!is_sound(saved, &why)) {
        complain(instance, "%s: the state is refused: %s.", function, why.text);
        free(saved);
        return fmi2Error;
    }
    if (*state) {
        memcpy(*state, saved, sizeof *saved);
        free(saved);
    } else {
        *state = saved;
    }
    return fmi2OK;
}
