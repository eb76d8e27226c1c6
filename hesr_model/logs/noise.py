"""Measurement noise as a pure function of seed, stream and counter.

Words of splitmix64 (Steele, Lea, Flood 2014) from a base by seed and stream, and the cosine branch
of Box-Muller over two successive words. `tests/unit/test_noise.py` has test vectors.
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
    """Return 64-bit words number `index` of `stream`, which broadcast."""
    streams, indices = np.broadcast_arrays(
        np.asarray(stream, dtype=np.uint64), np.asarray(index, dtype=np.uint64)
    )
    # Scalars warn of overflow, arrays wrap silently.
    flat_streams = streams.reshape(-1)
    flat_indices = indices.reshape(-1)
    seeds = np.full(flat_streams.shape, seed & _MASK, dtype=np.uint64)
    base = _finish((_finish(seeds + _GAMMA) ^ flat_streams) + _GAMMA)
    return _finish(base + (flat_indices + np.uint64(1)) * _GAMMA).reshape(streams.shape)


def standard_normal(seed: int, stream: ArrayLike, counter: ArrayLike) -> Array:
    """Return normal numbers, `counter` (< 2^63) of `stream`, which broadcast."""
    first = np.asarray(counter, dtype=np.uint64) * np.uint64(2)
    u = (words(seed, stream, first) >> np.uint64(11)).astype(np.float64)
    w = (words(seed, stream, first + np.uint64(1)) >> np.uint64(11)).astype(np.float64)
    radius = np.sqrt(-2.0 * np.log((u + 1.0) * _TO_UNIT))
    return np.asarray(radius * np.cos(2.0 * np.pi * (w * _TO_UNIT)))


def _finish(z: NDArray[np.uint64]) -> NDArray[np.uint64]:
    z = (z ^ (z >> np.uint64(30))) * _FIRST
    z = (z ^ (z >> np.uint64(27))) * _SECOND
    return z ^ (z >> np.uint64(31))
