/* Speed of a motor with balanced torques: a root of the residual of balance.h.
 *
 * The search marches outwards from the old speed, towards falling residuals, until the sign
 * changes; Newton steps in the bracket follow, with bisection as a fallback. The first root on this
 * path is the right one of several, because the motion converges to it as the step shrinks. */
#ifndef ROOT_H
#define ROOT_H

#include <float.h>

#include "balance.h"

/* Zero approached from one side, where laws may jump. */
#define BESIDE_ZERO 1e-200

enum { MOST_TRIALS = 200, PIECES = 16 };

/* Largest relative deviation of the residual from a straight line over a stride. */
#define STRAIGHT 0.1

/* Whether a residual is nothing but the rounding of its terms or of the speed. */
static bool balanced(const Trial *trial) {
    const double grain = 4.0 * DBL_EPSILON * trial->size;
    const double step = 2.0 * DBL_EPSILON * fabs(trial->v);
    return fabs(trial->residual) <= fmax(grain, step * fabs(trial->slope));
}

/* Bracket of the root: `near` has the sign of the residual at the start, `far` the opposite, or is
 * NaN. */
typedef struct {
    double near;
    double far;
    double outward; /* 1 or -1 */
    double stride;  /* longest stride if Newton's is unusable */
    double before;  /* size of the residual at the previous trial */
} Search;

/* A stride outwards stops just before and just after zero, to detect jumps there. */
static double seeing_zero(const Search *search, double next) {
    const double from = search->outward * search->near;
    const double to = search->outward * next;
    if (from < -BESIDE_ZERO && to > -BESIDE_ZERO) {
        return -search->outward * BESIDE_ZERO;
    }
    if (fabs(from) <= BESIDE_ZERO && from < BESIDE_ZERO) {
        return search->outward * BESIDE_ZERO;
    }
    return next;
}

/* Newton's next speed if it stays in the bracket and makes progress, else a bisection or a
 * stride. */
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

/* If friction can hold this speed, set it to the balancing torque. */
static bool hold(const Step *step, const Motion *from, double v, Trial *trial) {
    const double inert = step->inertia / step->h * (v - from->dq);
    trial->v = v;
    trial->tau_f = (step->tau_motor - inert) / step->gear - trial->tau_link;
    return true;
}

/* Whether the residual bends or falls within a stride, which may then have passed a root. */
static bool bent(const Trial *start, const Trial *end) {
    const double straight = start->residual + start->slope * (end->v - start->v);
    return fabs(end->v - start->v) > 2.0 * BESIDE_ZERO &&
           (!(end->slope > 0.0) ||
            fabs(end->residual - straight) > STRAIGHT * fabs(start->residual));
}

/* Repeat the way from `start` to `end` in pieces up to the first root. Between pieces the residual
 * may touch zero where its slope changes sign. */
static void retrace(const Step *step, const Motion *from, Search *search, Trial start, Trial *end) {
    const double to = end->v;
    const double piece = (to - start.v) / PIECES;
    const double outward = search->outward;
    for (int n = 1; n <= PIECES; n++) {
        const double speed = n < PIECES ? to - (PIECES - n) * piece : to;
        balance(step, from, speed, end);
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

/* Find the balance at the end of a step from a motion; `name` is that of the speed's variable. */
static bool solve(const Step *step, const Motion *from, Trial *trial, const char *name,
                  Message *why) {
    const bool jumps = step->joint->switches_of_joint > 0;
    balance(step, from, from->dq, trial);
    Search search;
    search.near = from->dq;
    search.far = NAN;
    search.outward = trial->residual > 0.0 ? -1.0 : 1.0;
    search.stride = step->h / step->inertia * fabs(trial->residual);
    search.before = INFINITY;
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
    return deny(why,
                "%s: %s in a step of %g s; it keeps its last value. Take a smaller substep, or "
                "look at the torque and the coefficients.",
                name,
                isfinite(trial->size) ? "no speed was found that balances the torques"
                                      : "the torques are not finite",
                step->h);
}

#endif
