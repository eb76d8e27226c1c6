/* Protection from MuJoCo's defaults: a file in the working directory on a warning, and the end of
 * the process on an error.
 *
 * During a call, a log handler of its thread receives MuJoCo's messages, as in MuJoCo's own
 * compiler and bindings; other threads and users of the library are unaffected. */
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
            *text = ' '; /* hosts may interpret messages as formats */
        }
    }
}

/* Warnings are counted in the data. */
static void take(const mjLogMessage *message) {
    if (message->level >= mjLOG_ERROR) {
        tell_of_mujoco(guard->why, message->subject);
        longjmp(guard->back, 1);
    }
}

/* Return the result of `work`, or false and `why` if an error in MuJoCo ended it. */
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
