/* MuJoCo, kept from what its defaults do to a host: on a warning a file in the working directory,
 * on an error that and the end of the process.
 *
 * A handler of the calling thread takes what MuJoCo says, for as long as a call into it lasts, so
 * that neither other threads nor other users of the library notice. MuJoCo's own compiler and
 * bindings use this one, too. */
#ifndef GUARD_H
#define GUARD_H

#include <setjmp.h>
#include <stdbool.h>
#include <stdio.h>

#include "component.h"
#include "mujoco_library.h"

typedef struct {
    jmp_buf back;
    Message *why;
} Guard;

static __thread Guard *guard;

static void tell_of_mujoco(Message *why, const char *what) {
    char *text = why->text;
    snprintf(text, sizeof why->text, "MuJoCo: %.240s", what);
    for (; *text; text++) {
        if (*text == '%' || *text == '\n') {
            *text = ' '; /* hosts may take messages for formats */
        }
    }
}

/* Warnings are counted in the data, for those who want to know of them. */
static void take(const mjLogMessage *message) {
    if (message->level >= mjLOG_ERROR) {
        tell_of_mujoco(guard->why, message->subject);
        longjmp(guard->back, 1);
    }
}

/* What a piece of work returns, or false, and `why`, if an error in MuJoCo ended it. */
static bool guarded(bool (*work)(void *), void *argument, Message *why) {
    Guard own = {.why = why};
    Guard *const outer = guard;
    const mjfLogHandler before = _mjPRIVATE_setTlsLogHandler(take);
    guard = &own;
    const bool done = setjmp(own.back) == 0 && work(argument);
    guard = outer;
    _mjPRIVATE_setTlsLogHandler(before);
    return done;
}

#endif
