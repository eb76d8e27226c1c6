/* A host that runs thousands of random lives of an FMU's instances. Most calls are allowed by the
 * standard and have valid arguments. A sanitizer fails on memory errors, the host on forbidden
 * results, such as non-finite outputs.
 *
 *     fuzz [LIVES [FAIL_EVERY [RESOURCES [NAME=VALUE ..]]]]
 *
 * Every so many allocations of the FMU fail, where it is linked with --wrap=malloc,--wrap=calloc.
 */
#include <string.h>

#include "given.h"
#include "chance.h"

enum { LONGEST = 120, CROWD = 1000, SAME = 0 };

#if FMI == 3
#include "calls3.h"
#else
#include "calls2.h"
#endif

static Byte room[1 << 20], *bytes = room;
static size_t size_of_state;
static Text resources;

LOGGER {
    messages += message[0] != 0;
}

static Status exit_initialisation(Host *h) {
    const Status status = CALL(ExitInitializationMode)(h->c);
    h->mode = status == OK ? after_initialisation(h) : h->mode;
    return status;
}

/* Instances without events rarely try. */
static Status enter_event(Host *h) {
    const int mode = after_initialisation(h);
    if (mode == STEPS && below(50)) {
        return OK;
    }
    const Status status = CALL(EnterEventMode)(h->c);
    h->mode = status == OK ? mode : h->mode;
    return status;
}

static Status reset(Host *h) {
    h->time = 0.0;
    const Status status = CALL(Reset)(h->c);
    start(h->c);
    return status;
}

static Status set_logging(Host *h) {
    return CALL(SetDebugLogging)(h->c, (Bool)below(2), n, OR_NULL(string));
}

static Status set_inputs(Host *h) {
    choose_inputs();
    return set_real(h);
}

static Status get_state(Host *h) {
    h->mode_of_state = h->mode;
    return CALL(GetFMUstate)(h->c, OR_NULL(&h->state));
}

static Status set_state(Host *h) {
    if (!h->state && below(99)) {
        return get_state(h);
    }
    const Status status = CALL(SetFMUstate)(h->c, h->state);
    if (status == OK) {
        h->mode = h->mode_of_state;
        restored++;
    }
    return status;
}

static Status free_state(Host *h) {
    return CALL(FreeFMUstate)(h->c, OR_NULL(&h->state));
}

static Status serialise(Host *h) {
    if (!h->state && below(99)) {
        return get_state(h);
    }
    CALL(SerializedFMUstateSize)(h->c, h->state, OR_NULL(&size_of_state));
    if (size_of_state > sizeof room) {
        wrong("size of a state", (double)size_of_state);
    }
    bytes = room + sizeof room - size_of_state;
    return CALL(SerializeFMUstate)(h->c, h->state, OR_NULL(bytes), size_of_state - !below(99));
}

/* Bytes of an earlier life, perhaps of the other type or damaged; used in few lives. */
static Status deserialise(Host *h) {
    if (below(20)) {
        return get_state(h);
    }
    const size_t size = size_of_state - !below(9);
    Byte *place = size == size_of_state && size > 0 && below(2) ? bytes + below(size) : NULL;
    const int flipped = 1 << below(8);
    h->mode_of_state = START;
    if (place) {
        *place = (Byte)(*place ^ flipped);
    }
    const Status status = CALL(DeSerializeFMUstate)(h->c, OR_NULL(bytes), size, &h->state);
    if (place) {
        *place = (Byte)(*place ^ flipped);
    }
    if (place && status == OK) {
        wrong("a byte that was damaged and taken", (double)(place - bytes));
    }
    return status;
}

static Status complete(Host *h) {
    Bool event = 0, end;
    const Status status = CALL(CompletedIntegratorStep)(h->c, 1, OR_NULL(&event), OR_NULL(&end));
    crossings += status == OK && event;
    return status;
}

static Status set_time(Host *h) {
    return CALL(SetTime)(h->c, number());
}

static Status exchange_states(Host *h) {
    double array[STATES + INDICATORS + 2];
    const size_t states_of = below(100) ? STATES : below(STATES + 2);
    const size_t indicators_of = below(100) ? INDICATORS : below(INDICATORS + 2);
    for (int i = 0; i < STATES + INDICATORS + 2; i++) {
        array[i] = 0.1 * number();
    }
    switch (below(5)) {
    case 0:
        return CALL(GetContinuousStates)(h->c, OR_NULL(array), states_of);
    case 1:
        return CALL(GetDerivatives)(h->c, OR_NULL(array), states_of);
    case 2:
        return CALL(GetNominalsOfContinuousStates)(h->c, OR_NULL(array), states_of);
    case 3:
        return CALL(GetEventIndicators)(h->c, OR_NULL(array), indicators_of);
    default:
        return h->mode == CONTINUOUS ? CALL(SetContinuousStates)(h->c, OR_NULL(array), states_of)
                                     : OK;
    }
}

/* States that allow each call, its frequency, and the state after it. */
static const struct {
    Status (*call)(Host *);
    Status (*plain)(Fmu);
    int modes, often, next;
} actions[] = {{enter_initialisation, NULL, START, 5, INITIAL},
               {exit_initialisation, NULL, INITIAL, 9, SAME},
               {NULL, CALL(Terminate), STEPS | EVENT | CONTINUOUS | PAUSED, 1, END},
               {reset, NULL, STEPS | EVENT | CONTINUOUS | PAUSED, 1, START},
               {reset, NULL, END | FAILED, 9, START},
               {set_logging, NULL, ALWAYS, 2, SAME},
               {get_real, NULL, RUNNING | END | FAILED, 8, SAME},
               {set_inputs, NULL, START | RUNNING, 8, SAME},
               {set_real, NULL, START, 1, SAME},
               {get_or_set_others, NULL, INITIAL | STEPS | EVENT | PAUSED, 1, SAME},
               {get_state, NULL, ALWAYS & ~FAILED, 2, SAME},
               {set_state, NULL, ALWAYS, 2, SAME},
               {free_state, NULL, ALWAYS, 1, SAME},
               {serialise, NULL, ALWAYS, 2, SAME},
               {deserialise, NULL, ALWAYS, 2, SAME},
               {derive, NULL, RUNNING | END | FAILED, 4, SAME},
               {step, NULL, STEPS, 20, SAME},
               {enter_event, NULL, STEPS | CONTINUOUS, 6, SAME},
               {new_discrete_states, NULL, EVENT | PAUSED, 6, SAME},
               {NULL, CALL(EnterContinuousTimeMode), EVENT, 6, CONTINUOUS},
               {complete, NULL, CONTINUOUS, 8, SAME},
               {set_time, NULL, EVENT | CONTINUOUS, 4, SAME},
               {exchange_states, NULL, EVENT | CONTINUOUS, 8, SAME},
               OWN_ACTIONS};

static void act(Host *h) {
    size_t i;
    do {
        i = below(sizeof actions / sizeof *actions);
    } while (below(20) >= (unsigned)actions[i].often ||
             (!(actions[i].modes & h->mode) && below(1000)));
    choose_arguments();
    const Status status = actions[i].call ? actions[i].call(h) : actions[i].plain(h->c);
    calls++;
    by_status[status]++;
    steps += status == OK && actions[i].call == step;
    derived += status == OK && actions[i].call == derive;
    if (status == ERROR) {
        h->mode = FAILED;
    } else if (status == OK && actions[i].next != SAME) {
        h->mode = actions[i].next;
    }
}

static void live(void) {
    Host h = {.type = below(MODEL_EXCHANGE ? 2 : 20) ? COUPLED_STEPS : EXCHANGE,
              .options = (int)below(4),
              .mode = START};
    h.c = made(OR_NULL("host"), below(300) ? h.type : OTHER_TYPE, below(300) ? MODEL_GUID : "{}",
               resources, below(300) > 0, (int)below(2), h.options);
    start(h.c);
    for (unsigned left = below(LONGEST); left > 0; left--) {
        act(&h);
    }
    CALL(FreeFMUstate)(h.c, &h.state);
    CALL(FreeInstance)(h.c);
}

/* Many instances at the same time. */
static void live_together(int many) {
    Fmu crowd[CROWD];
    for (int i = 0; i < many; i++) {
        crowd[i] = made("one of many", COUPLED_STEPS, MODEL_GUID, resources, 1, 0, 0);
        start(crowd[i]);
        begin(crowd[i]);
    }
    for (int k = 0; k < 5; k++) {
        for (int i = 0; i < many; i++) {
            steps += advance(crowd[i], 1e-3 * k, 1e-3) == OK;
        }
    }
    for (int i = 0; i < many; i++) {
        CALL(FreeInstance)(crowd[i]);
    }
}

int main(int count, char **arguments) {
    const long lives = count > 1 ? atol(arguments[1]) : 10000;
    fail_every = count > 2 ? strtoul(arguments[2], NULL, 10) : 0;
    resources = count > 3 ? arguments[3] : NULL;
    given = count > 4 ? arguments + 4 : NULL;
    live_together(lives < CROWD ? (int)lives : CROWD);
    for (long i = 0; i < lives; i++) {
        live();
    }
    /* Lets the test check that enough has happened. */
    printf("{\"calls\": %lu, \"steps\": %lu, \"derivatives\": %lu, \"events\": %lu, "
           "\"restored\": %lu, \"refusals\": %lu, \"errors\": %lu, \"messages\": %lu, "
           "\"failed_allocations\": %lu}\n",
           calls, steps, derived, crossings, restored, by_status[DISCARD], by_status[ERROR],
           messages, failed_allocations);
    return by_status[FATAL] > 0;
}
