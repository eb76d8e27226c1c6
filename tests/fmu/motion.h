#ifndef MOTION_H
#define MOTION_H

/* Input of a host in step k: a bent triangle with rests at its ends, from -1 to 1. Additions and
 * multiplications only make it bitwise equal on every processor. */
static inline double bent_triangle(int k, int joint) {
    const int place = (k + 37 * joint) % 400;
    const double up = place < 200 ? place : 400 - place;
    const double shape = up / 100.0 - 1.0;
    return shape * (1.5 - 0.5 * shape * shape);
}

#endif
