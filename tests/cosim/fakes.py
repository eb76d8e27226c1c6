"""Python slaves that replace FMUs: they log the calls of a master and fail on demand."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cosim.systems.system import SystemSpec
from fmu_src.run.variables import Variables
from hesr_model.errors import SimulationError


def variable(name: str, causality: str, **more: Any) -> SimpleNamespace:
    """A variable as FMPy describes it."""
    data = {"type": "Real", "unit": None, "declaredType": None, "valueReference": 0} | more
    return SimpleNamespace(name=name, causality=causality, **data)


def description(
    *variables: SimpleNamespace,
    feedthrough: Mapping[str, Sequence[str] | None] | None = None,
    units: Mapping[str, Any] | None = None,
    exchange: bool = False,
) -> SimpleNamespace:
    """FMPy's view of a description; outputs missing from `feedthrough` depend on no input."""
    named = {v.name: v for v in variables}
    needed = dict.fromkeys((v.name for v in variables if v.causality == "output"), ())
    needed |= feedthrough or {}
    outputs = [
        SimpleNamespace(
            variable=named[name],
            dependencies=None if names is None else [named[n] for n in names],
        )
        for name, names in needed.items()
    ]
    return SimpleNamespace(
        modelVariables=list(variables),
        unitDefinitions=[
            SimpleNamespace(name=name, baseUnit=base) for name, base in (units or {}).items()
        ],
        outputs=outputs,
        derivatives=[],
        modelExchange=SimpleNamespace() if exchange else None,
    )


class Fake:
    """A slave with inputs u[1], u[2] and outputs y[1], y[2]: y' = u by Euler, from y = y0."""

    about = description(
        *(variable(f"u[{i}]", "input") for i in (1, 2)),
        *(variable(f"y[{i}]", "output") for i in (1, 2)),
        variable("y0", "parameter"),
    )
    calls: list[tuple[Any, ...]]
    alive: set[str]

    def __init__(self, fmu: Path, *, name: str) -> None:
        self.fmu, self.name, self.used = fmu, name, False
        self.variables = Variables(fmu, self.about)

    def __enter__(self) -> "Fake":
        self.alive.add(self.name)
        return self

    def __exit__(self, *_: object) -> None:
        self.alive.remove(self.name)

    def reset(self) -> None:
        self.used = False

    def enter_initialisation(self, *, time: float, stop: float, start: Mapping[str, Any]) -> None:
        assert not self.used
        self.used = True
        self.v = dict.fromkeys((v.name for v in self.about.modelVariables), 0.0)
        self.set(start)
        self.begin()

    def exit_initialisation(self) -> None:
        self.calls.append((self.name, "start"))

    def set(self, values: Mapping[str, Any]) -> None:
        for name, value in values.items():
            if not math.isfinite(value):
                raise SimulationError(f"{self.name}: {name} is {value}.")
            self.v[name] = value
        self.refresh()

    def get(self, names: Sequence[str]) -> np.ndarray:
        return np.array([self.v[name] for name in names])

    def buffer(self, names: Sequence[str], values: np.ndarray | None = None) -> "FakeBuffer":
        return FakeBuffer(self, names, np.zeros(len(names)) if values is None else values)

    def step(self, time: float, step: float) -> None:
        self.calls.append((self.name, time, step))
        self.move(time, step)
        self.refresh()

    def begin(self) -> None:
        self.v["y[1]"] = self.v["y[2]"] = self.v["y0"]

    def move(self, time: float, step: float) -> None:
        for i in (1, 2):
            self.v[f"y[{i}]"] += step * self.v[f"u[{i}]"]

    def refresh(self) -> None:
        pass


class FakeBuffer:
    def __init__(self, slave: Fake, names: Sequence[str], values: np.ndarray) -> None:
        self.slave, self.names, self.values = slave, names, values

    def write(self) -> None:
        self.slave.set(dict(zip(self.names, self.values.tolist(), strict=True)))

    def read(self) -> np.ndarray:
        self.values[:] = self.slave.get(self.names)
        return self.values


class Gain(Fake):
    """y = 2 u, with direct feedthrough."""

    about = description(
        variable("u", "input"), variable("y", "output"), feedthrough={"y": ["u"]}, exchange=True
    )

    def begin(self) -> None:
        self.refresh()

    def move(self, time: float, step: float) -> None:
        pass

    def refresh(self) -> None:
        self.v["y"] = 2.0 * self.v["u"]


class Hidden(Gain):
    """A gain that declares no dependency, which is allowed to hold only after initialisation."""

    about = description(variable("u", "input"), variable("y", "output"))


class Pair(Gain):
    """Two gains in one slave, b = 2 a and d = 2 c."""

    about = description(
        *(variable(name, "input") for name in "ac"),
        *(variable(name, "output") for name in "bd"),
        feedthrough={"b": ["a"], "d": ["c"]},
        exchange=True,
    )

    def refresh(self) -> None:
        self.v["b"], self.v["d"] = 2.0 * self.v["a"], 2.0 * self.v["c"]


class Clock(Fake):
    """y = t."""

    about = description(variable("y", "output"))

    def begin(self) -> None:
        pass

    def move(self, time: float, step: float) -> None:
        self.v["y"] = time + step


class Failing(Clock):
    """A clock that cannot step past 0.3 s."""

    def move(self, time: float, step: float) -> None:
        if time > 0.25:
            raise SimulationError(f"'{self.name}' at t = {time:.9g} s: too late.")
        super().move(time, step)


class Broken(Clock):
    """A clock that returns NaN from 0.3 s without reporting an error."""

    def move(self, time: float, step: float) -> None:
        self.v["y"] = math.nan if time > 0.15 else time + step


KINDS = {kind.__name__.lower(): kind for kind in (Fake, Gain, Hidden, Pair, Clock, Failing, Broken)}


def install(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make masters create fakes, selected by file name, instead of loading FMUs."""
    Fake.calls, Fake.alive = [], set()
    monkeypatch.setattr(
        "cosim.systems.simulation.FmuInstance",
        lambda fmu, *, name, **_: KINDS[fmu.stem](fmu, name=name),
    )


def system(
    components: Mapping[str, str | Mapping[str, Any]],
    connections: Mapping[str, str] | None = None,
    **more: Any,
) -> SystemSpec:
    """Return a system of fakes from the kind (or more) of each named component."""
    given = {n: {"fmu": c} if isinstance(c, str) else c for n, c in components.items()}
    data = {
        "step": 0.1,
        "stop": 1.0,
        "components": [{**c, "name": n, "fmu": f"{c['fmu']}.fmu"} for n, c in given.items()],
        "connections": connections or {},
    }
    return SystemSpec.model_validate(data | more)
