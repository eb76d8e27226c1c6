"""Measurement noise as a pure function of seed, stream and counter.

Without hidden state, repeated steps, restored states and parallel arms draw the same numbers, in C
as in Python. All integers are unsigned 64 bit and wrap::

    finish(z):  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9
                z = (z ^ (z >> 27)) * 0x94D049BB133111EB
                return z ^ (z >> 31)
    gamma   = 0x9E3779B97F4A7C15
    base    = finish((finish(seed + gamma) ^ stream) + gamma)
    word(i) = finish(base + (i + 1) * gamma)

This is the splitmix64 sequence (Steele, Lea, Flood 2014) from `base`. Normal number c is the cosine
branch of Box-Muller over two successive words::

    u = ((word(2c) >> 11) + 1) * 2^-53        in (0, 1]
    w = (word(2c + 1) >> 11) * 2^-53          in [0, 1)
    normal(c) = sqrt(-2 ln u) cos(2 pi w)

Test vectors; normals agree to 1e-14, because ln and cos depend on the library::

    seed      stream  c        word(c)             normal(c)
    0         0       0        0x238275BC38FCBE91  1.9549744116420429
    1         0       0        0xB18A02F46D8D86C3  0.84212792483929511
    1         2       3        0x2A38BBE987FDF051  0.96852403952840393
    2^64 - 1  5       1000000  0xA62A18996EB1CC37  2.7082296607715115
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hesr_model.support.arrays import Array

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_MASK = 2**64 - 1
_TO_UNIT = 2.0**-53


def words(seed: int, stream: ArrayLike, index: ArrayLike) -> NDArray[np.uint64]:
    """Return random 64-bit words number `index` of `stream`, which broadcast."""
    streams, indices = np.broadcast_arrays(
        np.asarray(stream, dtype=np.uint64), np.asarray(index, dtype=np.uint64)
    )
    # Scalars warn of overflow, arrays wrap silently.
    flat, places = streams.reshape(-1), indices.reshape(-1)
    seeds = np.full(flat.shape, seed & _MASK, dtype=np.uint64)
    base = _finish((_finish(seeds + _GAMMA) ^ flat) + _GAMMA)
    return _finish(base + (places + np.uint64(1)) * _GAMMA).reshape(streams.shape)


def standard_normal(seed: int, stream: ArrayLike, counter: ArrayLike) -> Array:
    """Return standard normal numbers, `counter` (< 2^63) of `stream`, which broadcast."""
    first = np.asarray(counter, dtype=np.uint64) * np.uint64(2)
    u = (words(seed, stream, first) >> np.uint64(11)).astype(np.float64)
    w = (words(seed, stream, first + np.uint64(1)) >> np.uint64(11)).astype(np.float64)
    normal: Array = np.sqrt(-2.0 * np.log((u + 1.0) * _TO_UNIT)) * np.cos(
        2.0 * np.pi * (w * _TO_UNIT)
    )
    return normal


def _finish(z: NDArray[np.uint64]) -> NDArray[np.uint64]:
    z = (z ^ (z >> np.uint64(30))) * _FIRST
    z = (z ^ (z >> np.uint64(27))) * _SECOND
    return z ^ (z >> np.uint64(31))
