/* The speed at which the torques on a motor balance: a root of the residual of balance.h.
 *
 * March outwards from the old speed, in the direction in which the residual falls, until its sign
 * changes; then Newton's steps in the bracket, halves where they fail. The first root on this way
 * is where the motion goes in ever smaller steps, so it is the one to take where there are several.
 */
#ifndef ROOT_H
#define ROOT_H

#include <float.h>
#include <stdio.h>

#include "balance.h"

/* Stands for zero seen from one side, where laws may jump. */
#define BESIDE_ZERO 1e-200

enum { MOST_TRIALS = 200, PIECES = 16 };

/* Share of the residual by which a stride may miss the straight line along which it went. */
#define STRAIGHT 0.1

/* Whether a trial is as near to a root as rounding lets see. */
static bool balanced(const Trial *trial) {
    const double grain = 4.0 * DBL_EPSILON * trial->size;
    const double step = 2.0 * DBL_EPSILON * fabs(trial->v);
    return fabs(trial->residual) <= fmax(grain, step * fabs(trial->slope));
}

/* Where a root is looked for: outwards from `near`, where the residual still has the sign that it
 * had at the start, up to `far`, where it has the other, or NaN as long as that is not known. */
typedef struct {
    double near, far;
    double outward; /* 1 or -1 */
    double stride;  /* longest stride where Newton's is of no use */
    double before;  /* size of the residual before the last trial */
} Search;

/* A stride from `near` outwards stops before and behind zero, so that jumps there are seen. */
static double seeing_zero(const Search *search, double next) {
    const double from = search->outward * search->near, to = search->outward * next;
    if (from < -BESIDE_ZERO && to > -BESIDE_ZERO) {
        return -search->outward * BESIDE_ZERO;
    }
    return fabs(from) <= BESIDE_ZERO && from < BESIDE_ZERO ? search->outward * BESIDE_ZERO : next;
}

/* The next speed to try: Newton's where it stays within what is known and gets on, else one half
 * way, or a stride outwards. */
static double next_speed(Search *search, const Trial *trial, bool jumps) {
    const double newton = trial->v - trial->residual / trial->slope;
    if (!isnan(search->far)) {
        const bool inside = (newton - search->near) * (newton - search->far) < 0.0;
        const bool slow = fabs(trial->residual) > 0.5 * search->before;
        return inside && !slow ? newton : 0.5 * (search->near + search->far);
    }
    const double most = search->near + search->outward * search->stride;
    double next = newton;
    if (!(trial->slope > 0.0) || search->outward * (newton - most) > 0.0) {
        next = most;
        search->stride *= 2.0;
    }
    return jumps ? seeing_zero(search, next) : next;
}

/* Friction that can hold a speed against the other torques does: its own is what balances them. */
static bool hold(const Step *step, const Motion *from, double v, Trial *trial) {
    const double inert = step->inertia / step->h * (v - from->dq);
    trial->v = v;
    trial->tau_f = (step->tau_motor - inert) / step->gear - trial->tau_link;
    return true;
}

static bool refused(const char *name, double h, const char *what, Message *why) {
    snprintf(
        why->text, sizeof why->text,
        "%s: %s in a step of %g s; it keeps its last value. Take a smaller substep, or look at "
        "the torque and the coefficients.",
        name, what, h);
    return false;
}

/* Whether a stride went where the residual bends or falls, so that it may have passed a root. */
static bool bent(const Trial *start, const Trial *end) {
    const double straight = start->residual + start->slope * (end->v - start->v);
    return fabs(end->v - start->v) > 2.0 * BESIDE_ZERO &&
           (!(end->slope > 0.0) ||
            fabs(end->residual - straight) > STRAIGHT * fabs(start->residual));
}

/* Go from `start` to `end` again, in pieces, and stop behind the first root; between two pieces the
 * residual may touch zero where its slope changes sign. */
static void retrace(const Step *step, const Motion *from, Search *search, Trial start, Trial *end) {
    const double to = end->v, piece = (to - start.v) / PIECES, outward = search->outward;
    for (int n = 1; n <= PIECES; n++) {
        balance(step, from, n < PIECES ? to - (PIECES - n) * piece : to, end);
        if (outward * end->residual > 0.0) {
            return;
        }
        if (start.slope > 0.0 && end->slope < 0.0) {
            const Trial behind = *end;
            const double share = start.slope / (start.slope - behind.slope);
            balance(step, from, start.v + share * (behind.v - start.v), end);
            if (outward * end->residual > 0.0) {
                return;
            }
            *end = behind;
        }
        search->near = end->v;
        start = *end;
    }
}

/* Find the speed that balances the torques; false, with the reason, if there is none. */
static bool solve(const Step *step, const Motion *from, Trial *trial, const char *name,
                  Message *why) {
    const bool jumps = step->joint->switches_of_joint > 0;
    balance(step, from, from->dq, trial);
    Search search = {
        .near = from->dq,
        .far = NAN,
        .outward = trial->residual > 0.0 ? -1.0 : 1.0,
        .stride = step->h / step->inertia * fabs(trial->residual),
        .before = INFINITY,
    };
    for (int n = 0; n < MOST_TRIALS && isfinite(trial->size); n++) {
        if (balanced(trial)) {
            trial->v = fabs(trial->v) <= BESIDE_ZERO ? 0.0 : trial->v;
            return true;
        }
        const double next = next_speed(&search, trial, jumps);
        if (next == search.near || next == search.far) {
            return hold(step, from, next, trial); /* the law jumps here */
        }
        const Trial last = *trial;
        search.before = fabs(trial->residual);
        balance(step, from, next, trial);
        if (isnan(search.far) && bent(&last, trial)) {
            retrace(step, from, &search, last, trial);
        }
        if (search.outward * trial->residual > 0.0) {
            search.far = trial->v;
        } else {
            search.near = trial->v;
        }
        if (fabs(search.near) <= BESIDE_ZERO && fabs(search.far) <= BESIDE_ZERO) {
            return hold(step, from, 0.0, trial);
        }
    }
    return refused(name, step->h,
                   isfinite(trial->size) ? "no speed was found that balances the torques"
                                         : "the torques are not finite",
                   why);
}

#endif
