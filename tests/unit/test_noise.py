"""Counter-based noise: its statistics, and a reference in Python integers."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kstest

from hesr_model.logs.noise import standard_normal, words

MASK = 2**64 - 1
GAMMA = 0x9E3779B97F4A7C15
WORD = st.integers(0, MASK)


def finish(z):
    z &= MASK
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    return z ^ (z >> 31)


def reference(seed, stream, index):
    base = finish((finish(seed + GAMMA) ^ stream) + GAMMA)
    return finish(base + (index + 1) * GAMMA)


def test_the_reference_finisher_is_splitmix64():
    # First outputs of the published generator started at 0 and at 1234567.
    assert finish(GAMMA) == 0xE220A8397B1DCDAF
    assert finish(1234567 + GAMMA) == 6457827717110365317


@pytest.mark.parametrize(
    ("seed", "stream", "counter", "word", "normal"),
    [
        (0, 0, 0, 0x238275BC38FCBE91, 1.9549744116420429),
        (1, 0, 0, 0xB18A02F46D8D86C3, 0.84212792483929511),
        (1, 2, 3, 0x2A38BBE987FDF051, 0.96852403952840393),
        (2**64 - 1, 5, 1000000, 0xA62A18996EB1CC37, 2.7082296607715115),
    ],
)
def test_vectors_of_the_docstring(seed, stream, counter, word, normal):
    assert words(seed, stream, counter) == word
    assert standard_normal(seed, stream, counter) == pytest.approx(normal, rel=1e-14, abs=0.0)


@given(seed=WORD, stream=WORD, index=WORD)
def test_words_equal_the_reference(seed, stream, index):
    assert int(words(seed, stream, index)) == reference(seed, stream, index)


@given(seed=WORD, stream=WORD, counter=st.integers(0, 2**63 - 1))
def test_normals_equal_the_reference(seed, stream, counter):
    u = ((reference(seed, stream, 2 * counter) >> 11) + 1) * 2.0**-53
    w = (reference(seed, stream, 2 * counter + 1) >> 11) * 2.0**-53
    expected = math.sqrt(-2 * math.log(u)) * math.cos(2 * math.pi * w)
    assert float(standard_normal(seed, stream, counter)) == pytest.approx(
        expected, rel=1e-13, abs=1e-15
    )


def test_the_seed_is_taken_modulo_a_word():
    assert words(-1, 0, 0) == words(MASK, 0, 0)
    assert words(2**64 + 7, 0, 0) == words(7, 0, 0)


def test_order_and_shape_of_the_arguments_do_not_matter():
    table = standard_normal(3, np.arange(4), np.arange(50)[:, None])
    assert table.shape == (50, 4)
    for counter, stream in ((0, 0), (17, 3), (49, 1)):
        assert standard_normal(3, stream, counter) == pytest.approx(
            table[counter, stream], rel=1e-14, abs=0.0
        )
    assert np.array_equal(standard_normal(3, 2, np.arange(50)[::-1])[::-1], table[:, 2])


def test_the_same_call_gives_the_same_bits():
    assert np.array_equal(standard_normal(9, 1, np.arange(999)), standard_normal(9, 1, range(999)))


def test_numbers_are_normal():
    x = standard_normal(11, 0, np.arange(100_000))
    assert abs(x.mean()) < 4 / math.sqrt(len(x))
    assert abs(x.std() - 1) < 4 / math.sqrt(2 * len(x))
    assert kstest(x, "norm").pvalue > 1e-3


@pytest.mark.parametrize("shift", [1, 2, 7])
def test_successive_numbers_are_uncorrelated(shift):
    x = standard_normal(12, 0, np.arange(100_000))
    assert abs(np.mean(x[shift:] * x[:-shift])) < 4 / math.sqrt(len(x))


@pytest.mark.parametrize(("seed", "stream"), [(13, 1), (14, 0), (13, 2**63)])
def test_streams_and_seeds_are_uncorrelated(seed, stream):
    counter = np.arange(100_000)
    x, y = standard_normal(13, 0, counter), standard_normal(seed, stream, counter)
    assert not np.array_equal(x, y)
    assert abs(np.mean(x * y)) < 4 / math.sqrt(len(x))
