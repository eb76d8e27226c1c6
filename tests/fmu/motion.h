#ifndef MOTION_H
#define MOTION_H

/* What a host sets in step k: a bent triangle with rests at its ends, from -1 to 1. It is made by
 * additions and multiplications only, so it is the same to the last digit on every processor. */
static inline double bent_triangle(int k, int joint) {
    const int place = (k + 37 * joint) % 400;
    const double up = place < 200 ? place : 400 - place;
    const double shape = up / 100.0 - 1.0;
    return shape * (1.5 - 0.5 * shape * shape);
}

#endif
