"""Data classes as JSON and back: exact numbers, and one sentence for each mistake."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ConfigDict

from hesr_model.errors import ArtifactError
from hesr_model.support.typed_files import Numbers, NumbersWithGaps, from_json, to_json


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    kind: Literal["a", "b"]
    values: Numbers
    gaps: NumbersWithGaps = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, kw_only=True, eq=False)
class Whole:
    __pydantic_config__: ClassVar = ConfigDict(extra="forbid")

    parts: tuple[Part, ...]
    x: float = 0.0
    free: Mapping[str, Any] = field(default_factory=dict)
    note: str | None = None


def back(data: Any) -> Whole:
    return from_json(Whole, data, Path("whole.json"), "a whole")


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False)), st.floats(allow_infinity=False))
def test_numbers_are_read_back_bit_for_bit(values: list[float], gap: float) -> None:
    part = Part(kind="a", values=np.array(values), gaps=np.array([[gap, np.inf]]))
    found = back(to_json(Whole(parts=(part,)))).parts[0]
    assert found.values.tobytes() == np.array(values).tobytes()
    assert found.gaps.shape == (1, 2)
    np.testing.assert_array_equal(found.gaps, [[gap, np.nan]])


def test_a_sparse_class_keeps_nested_none() -> None:
    whole = Whole(parts=(), free={"a": None, "b": {"c": None, "d": (1, 2)}})
    data = to_json(whole, sparse=True)
    assert data == {"parts": [], "x": 0.0, "free": {"a": None, "b": {"c": None, "d": [1, 2]}}}
    assert to_json(whole)["note"] is None


@pytest.mark.parametrize(
    "whole",
    [
        Whole(parts=(), x=float("nan")),
        Whole(parts=(), free={"deep": [float("inf")]}),
        Whole(parts=(Part(kind="a", values=np.array([np.nan])),)),
    ],
)
def test_non_finite_numbers_are_never_written(whole: Whole) -> None:
    with pytest.raises(ValueError, match="JSON compliant"):
        to_json(whole)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({}, "key 'parts' is missing."),
        ({"parts": [{"kind": "a"}]}, "key 'parts.0.values' is missing."),
        ({"parts": [], "y": 1}, "not a whole (unknown key 'y')."),
        ({"parts": [], "x": "far"}, "not a whole (key 'x': Input should be a valid number, unable"),
        ([], "not a whole (Input should be a dictionary or an instance of Whole)."),
        (
            {"parts": [{"kind": "c", "values": []}]},
            "not a whole (key 'parts.0.kind': Input should be 'a' or 'b').",
        ),
        (
            {"parts": [{"kind": "a", "values": [[1.0], [1.0, 2.0]]}]},
            "not a whole (key 'parts.0.values': setting an array element with a sequence",
        ),
        ({"parts": [{"kind": "a", "values": {}}]}, "not a whole (key 'parts.0.values': "),
    ],
)
def test_each_mistake_is_reported_in_one_sentence(data: Any, said: str) -> None:
    with pytest.raises(ArtifactError) as caught:
        back(data)
    assert str(caught.value).startswith(f"whole.json: {said}")
    assert str(caught.value).endswith(".")
    assert "\n" not in str(caught.value)
