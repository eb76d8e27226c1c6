/* Normally distributed numbers as a function of seed, stream and counter, as in
 * hesr_model/logs/noise.py. */
#ifndef NOISE_H
#define NOISE_H

#include <math.h>
#include <stdint.h>

#define TWO_PI 6.283185307179586477

static const uint64_t gamma_of_words = 0x9E3779B97F4A7C15u;

/* splitmix64 */
static uint64_t mixed(uint64_t z) {
    z += gamma_of_words;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

static double standard_normal(uint64_t seed, uint64_t stream, uint64_t counter) {
    const uint64_t base = mixed(mixed(seed) ^ stream);
    const uint64_t first = mixed(base + 2 * counter * gamma_of_words);
    const uint64_t second = mixed(base + (2 * counter + 1) * gamma_of_words);
    const double u = (double)((first >> 11) + 1) * 0x1p-53;
    const double w = (double)(second >> 11) * 0x1p-53;
    return sqrt(-2.0 * log(u)) * cos(TWO_PI * w);
}

#endif
