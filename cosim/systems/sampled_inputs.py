"""Inputs of an FMU that are sampled over time, as a component of its system."""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from fmu_src.run.fmu import FmuInstance
from fmu_src.run.variables import Variables
from hesr_model.support.arrays import Array

SOURCE = "input"  # name of the component

_TIME_TOLERANCE = 1e-9  # relative distance of times that are equal but for round-off
_CONTINUOUS = ("Real", "Float32")


def is_linear(variable: Any) -> bool:
    """Return whether an input is linear between samples; others are held."""
    return variable.type in _CONTINUOUS and variable.variability not in ("discrete", "tunable")


def find_jumps(t: Array, columns: Mapping[str, Array], variables: Variables) -> Array:
    """Return the times [s] at which a held input changes or two samples have one time."""
    jumps = [t[:-1][np.diff(t) == 0.0]]
    for name, column in columns.items():
        if not is_linear(variables[name]):
            jumps.append(t[1:][np.diff(column) != 0.0])
    return np.unique(np.concatenate(jumps))


class SampledInputs:
    """A component whose outputs are the inputs of one FMU, sampled at times `t` [s].

    At a communication point they have their values after it: of samples with one time the last.
    For model exchange they also have slopes until the next point.
    """

    def __init__(
        self,
        target: str,
        variables: Variables,
        *,
        t: Array,
        columns: Mapping[str, Array],
        points: Array,
        exchange: bool,
    ) -> None:
        self.name = SOURCE
        self.time = float(points[0])
        self.variables = _declare_outputs(variables, columns)
        self._target = target
        self._exchange = exchange
        self._points = points
        self._names = list(columns)
        self._linear = [name for name in columns if is_linear(variables[name])]
        samples = {name: _sample(t, column, points) for name, column in columns.items()}
        slopes = {name: _compute_slopes(t, columns[name], points) for name in self._linear}
        for name in columns:
            if name not in self._linear:
                samples[name] = _hold(t, columns[name], points)
        self._samples = samples
        self._slopes = slopes
        self._set_slopes: Callable[[Array], None] | None = None
        self._k = 0

    def begin(self, slaves: Mapping[str, FmuInstance]) -> None:
        """Return to the first communication point."""
        self._k, self.time = 0, float(self._points[0])
        self._set_slopes = None
        if self._exchange and self._linear:
            self._set_slopes = slaves[self._target].slopes(self._linear)
            self._pass_slopes()

    def step(self, time: float, step_size: float) -> None:
        """Go to the next communication point; see `Slave`."""
        self._k = min(self._k + 1, len(self._points) - 1)
        self.time = time + step_size
        self._pass_slopes()

    def _pass_slopes(self) -> None:
        if self._set_slopes is not None:
            self._set_slopes(np.array([self._slopes[name][self._k] for name in self._linear]))

    def value(self, name: str) -> float:
        """Return the value of an output at the communication point."""
        return float(self._samples[name][self._k])

    def buffer(self, names: Sequence[str], values: Array) -> "SourceBuffer":
        """Return a buffer of outputs in `values` (n,)."""
        return SourceBuffer(self, tuple(names), values)


@dataclass(eq=False)
class SourceBuffer:
    """Outputs (n,) of a source; see `Buffer`."""

    source: SampledInputs
    names: tuple[str, ...]
    values: Array

    def write(self) -> None:
        """Do nothing: a source has no inputs."""

    def read(self) -> Array:
        """Read and return the outputs."""
        for i, name in enumerate(self.names):
            self.values[i] = self.source.value(name)
        return self.values


def _declare_outputs(variables: Variables, columns: Mapping[str, Array]) -> Variables:
    outputs = []
    for name in columns:
        output = copy(variables[name])
        output.causality = "output"
        outputs.append(output)
    description = SimpleNamespace(
        modelVariables=outputs, unitDefinitions=(), outputs=(), modelExchange=None
    )
    return Variables(Path(SOURCE), description)


def _find_last_sample(t: Array, points: Array) -> Any:
    """Return the index of the last sample until each point; -1 before the first one."""
    tolerance = _TIME_TOLERANCE * np.maximum(np.abs(points), np.finfo(float).tiny)
    return np.searchsorted(t, points + tolerance, side="right") - 1


def _hold(t: Array, column: Array, points: Array) -> Array:
    held_samples: Array = column[np.maximum(_find_last_sample(t, points), 0)]
    return held_samples


def _find_intervals(t: Array, points: Array) -> tuple[Any, Any]:
    """Return the sample before each point, and whether a longer time to the next one follows."""
    last = _find_last_sample(t, points)
    first = np.clip(last, 0, len(t) - 1)
    following = np.minimum(first + 1, len(t) - 1)
    return first, (last >= 0) & (t[following] > t[first])


def _sample(t: Array, column: Array, points: Array) -> Array:
    """Return a linear input at points [s]; the first and last values hold outside the samples."""
    first, is_inside = _find_intervals(t, points)
    following = np.minimum(first + 1, len(t) - 1)
    length = np.where(is_inside, t[following] - t[first], 1.0)
    weight = np.where(is_inside, (t[following] - points) / length, 1.0)
    weight = np.where(points <= t[first], 1.0, weight)  # not before the sample by round-off
    samples: Array = weight * column[first] + (1.0 - weight) * column[following]
    return samples


def _sample_left_limits(t: Array, column: Array, points: Array) -> Array:
    """Return a linear input immediately before points [s]: of samples with one time the first."""
    tolerance = _TIME_TOLERANCE * np.maximum(np.abs(points), np.finfo(float).tiny)
    following = np.searchsorted(t, points - tolerance, side="left")
    is_inside = (following > 0) & (following < len(t))
    following = np.minimum(following, len(t) - 1)
    first = np.maximum(following - 1, 0)
    length = np.where(is_inside, t[following] - t[first], 1.0)
    weight = np.where(is_inside, np.maximum(t[following] - points, 0.0) / length, 0.0)
    left_limits: Array = weight * column[first] + (1.0 - weight) * column[following]
    return left_limits


def _compute_slopes(t: Array, column: Array, points: Array) -> Array:
    """Return the mean slope of a linear input from each point to the next one; at last 0."""
    samples = _sample(t, column, points)
    left_limits = _sample_left_limits(t, column, points)
    return np.append((left_limits[1:] - samples[:-1]) / np.diff(points), 0.0)
