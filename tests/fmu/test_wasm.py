"""The replacement for a C library in WebAssembly, compiled for this machine under other names."""

import struct
from ctypes import CDLL, c_char_p, c_double, c_int, c_size_t, c_uint, c_ulong, c_void_p
from ctypes import create_string_buffer as room_for
from typing import Any

import numpy as np
import pytest
from pure_c import compiled

VISIBLE = '__attribute__((visibility("default")))'
NAMES = ("calloc", "free", "strcmp", "snprintf", "vsnprintf")


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> CDLL:
    source = "".join(f"#include <{name}.h>\n" for name in ("math", "stdio", "stdlib", "string"))
    for name in NAMES:  # declared as in the library, implemented separately
        source += f"extern __typeof({name}) own_{name} {VISIBLE};\n#define {name} own_{name}\n"
    folder = tmp_path_factory.mktemp("wasm")
    return compiled(folder, source + '#include "wasm.c"\n', "wasm.c")


def written(library: CDLL, form: str, *values: Any, size: int = 400) -> str:
    room = room_for(b"x" * size)
    length = library.own_snprintf(room, c_size_t(size), form.encode(), *values)
    text = room.value.decode()
    assert len(text) == min(length, size - 1)
    return text


@pytest.mark.parametrize("form", ["%g", "%.1g", "%.9g", "%.17g"])
def test_numbers_are_formatted_as_by_libc(library: CDLL, form: str) -> None:
    """Of all magnitudes, including subnormal numbers and ties of the last digit."""
    rng = np.random.default_rng(17)
    values = [struct.unpack("d", rng.bytes(8))[0] for _ in range(3000)]
    values += list(rng.normal(size=500)) + [10.0**k for k in range(-30, 31)]
    values += [0.0, -0.0, 0.5, 2.5, 0.25, 35.0, 45.0, 9.5, 99.9999995, 999999.5, 1000000.5, 9e-5]
    values += [5e-324, 2.2250738585072014e-308, 1.7976931348623157e308, 2.0**53, 1e22, 1e23]
    values += [float("inf"), -float("inf")]
    for value in values:
        if not np.isnan(value):
            assert written(library, form, c_double(value)) == form % value
    assert written(library, form, c_double(float("nan"))) == "nan"


def test_strings_and_integers_are_formatted(library: CDLL) -> None:
    found = written(
        library,
        "%s: %d to %d, %u of %lu%s",
        c_char_p(b"fmi2SetReal"),
        c_int(-2147483648),
        c_int(0),
        c_uint(4294967295),
        c_ulong(2**64 - 1),
        c_char_p(b""),
    )
    assert found == "fmi2SetReal: -2147483648 to 0, 4294967295 of 18446744073709551615"


@pytest.mark.parametrize("size", [1, 2, 7, 12, 13])
def test_overlong_text_is_truncated(library: CDLL, size: int) -> None:
    text = "tau is 2e-07"
    assert written(library, "tau is %g", c_double(2e-7), size=size) == text[: size - 1]


def test_strings_are_compared(library: CDLL) -> None:
    pairs = [(b"", b""), (b"a", b""), (b"", b"a"), (b"ab", b"ac"), (b"ab", b"ab"), (b"\xff", b"a")]
    found = [library.own_strcmp(*(c_char_p(p) for p in pair)) for pair in pairs]
    assert [np.sign(f) for f in found] == [(a > b) - (a < b) for a, b in pairs]


def test_memory_is_zeroed_distinct_and_limited(library: CDLL) -> None:
    library.own_calloc.restype = c_void_p
    first, second = (library.own_calloc(c_size_t(3), c_size_t(7)) for _ in range(2))
    assert second - first == 24
    assert first % 8 == 0
    assert library.own_calloc(c_size_t(1), c_size_t(2**20)) is None
    assert library.own_calloc(c_size_t(1), c_size_t(2**19)) is not None
    library.own_free(c_void_p(first))
