"""Plan and design of a sweep, checked against the system, and sensitivities of its outputs."""

import hashlib
import json
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import product
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtri

from cosim.systems.simulation import Master
from cosim.systems.system import SystemSpec, Value
from fmu_src.run.fmu import POOL
from hesr.extras.sweep.study import MOST_RUNS, Correlated, SweepInput, SweepStudy
from hesr.extras.sweep.work import Task, VariedVariable
from hesr_model.errors import ConfigError
from hesr_model.support.arrays import Array
from hesr_model.support.files import sha256


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensitivity:
    """Shares of the variance of an output by input (d,), 95 % bootstrap intervals (2, d, 2)."""

    output: str
    first: Array
    total: Array
    intervals: Array


def sensitivities(outputs: Array, study: SweepStudy) -> list[Sensitivity]:
    """Return the indices of outputs (runs, m) that vary and never failed, for a "sobol" design."""
    if study.design != "sobol" or study.runs is None:
        return []
    from scipy.stats import bootstrap  # slow to import

    found = []
    for one, values in zip(study.outputs, outputs.T, strict=True):
        if not np.isfinite(values).all() or np.ptp(values) == 0.0:
            continue
        blocks = values.reshape(len(study.names) + 2, study.runs)
        blocks = blocks - blocks[:2].mean()  # reduces the error of the estimates
        # The bootstrap of scipy's `sobol_indices` takes no seed.
        spread = bootstrap(
            [np.arange(study.runs)],
            lambda chosen, of=blocks: _shares(of[:, chosen]),
            vectorized=False,
            confidence_level=0.95,
            n_resamples=499,
            rng=np.random.default_rng(study.seed),
        )
        first, total = _shares(blocks)
        intervals = np.stack(spread.confidence_interval, axis=-1)
        found.append(Sensitivity(output=one.name, first=first, total=total, intervals=intervals))
    return found


def _shares(blocks: Array) -> Array:
    """Return (2, d) indices by Saltelli et al. (2010)."""
    a = blocks[0]
    b = blocks[1]
    mixed = blocks[2:]
    first = np.mean(b * (mixed - a), axis=1)
    total = 0.5 * np.mean((a - mixed) ** 2, axis=1)
    return np.asarray(np.stack([first, total]) / np.var(blocks[:2]))


_EDGE = 2.0**-53  # smallest distance to 0 and 1 of the quantiles of a normal distribution


def chosen(study: SweepStudy) -> Array:
    """Return the values of all inputs, (runs, d)."""
    unit = _unit(study)
    columns = [_values(one, unit[:, k]) for k, one in enumerate(study.inputs)]
    at = len(columns)
    for group in study.correlated:
        n = len(group.variables)
        columns += list(_correlated(group, unit[:, at : at + n]).T)
        at += n
    return np.column_stack(columns)


def _unit(study: SweepStudy) -> Array:
    d = len(study.names)
    runs = study.runs or 0
    if study.design == "grid":
        return _grid(study)
    if study.design == "monte_carlo":
        return np.random.default_rng(study.seed).random((runs, d))
    from scipy.stats import qmc  # slow to import

    rng = np.random.default_rng(study.seed)
    if study.design == "latin_hypercube":
        return np.asarray(qmc.LatinHypercube(d, rng=rng).random(runs))
    # Saltelli's blocks A, B and, for each input, A with this input from B (Comput. Phys. Commun.
    # 181 (2010) 259-270, table 2, radial form)
    both = np.asarray(qmc.Sobol(2 * d, rng=rng).random(runs))
    a = both[:, :d]
    b = both[:, d:]
    mixed = [np.where(np.arange(d) == k, b, a) for k in range(d)]
    return np.concatenate([a, b, *mixed])


def _grid(study: SweepStudy) -> Array:
    places = []
    for one in study.inputs:
        n = len(one.values)
        places.append((np.arange(n) + 0.5) / n if n else np.linspace(0.0, 1.0, one.levels))
    count = prod(map(len, places))
    if count > MOST_RUNS:
        raise ConfigError(
            f"the grid of '{study.name}' has {count:.3g} runs; at most {MOST_RUNS}.",
            code="sweep.most_runs",
            key="inputs",
        )
    return np.array(list(product(*places)))


def _values(one: SweepInput, unit: Array) -> Array:
    if one.values:
        listed: Array = np.array(one.values)
        return listed.take((unit * len(listed)).astype(int), mode="clip")
    if one.low is not None and one.high is not None:
        if one.integer:
            low = np.ceil(one.low)
            high = np.floor(one.high)
            return np.asarray(np.minimum(low + np.floor(unit * (high - low + 1.0)), high))
        return one.low + unit * (one.high - one.low)
    drawn: Array = (one.mean or 0.0) + (one.std or 0.0) * _normal(unit)
    return np.round(drawn) if one.integer else drawn


def _correlated(group: Correlated, unit: Array) -> Array:
    sizes, axes = np.linalg.eigh(np.array(group.covariance))
    root = (axes * np.sqrt(np.maximum(sizes, 0.0))) @ axes.T
    return np.asarray(np.array(group.mean) + _normal(unit) @ root)


def _normal(unit: Array) -> Array:
    return np.asarray(ndtri(np.clip(unit, _EDGE, 1.0 - _EDGE)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """A sweep: varied `values` (runs, d), and SHA-256 of the FMUs."""

    study: SweepStudy
    task: Task
    values: Array
    digests: dict[Path, str]

    @property
    def firsts(self) -> list[int]:
        """First run of each chunk."""
        return list(range(0, len(self.values), self.study.chunk))

    def chunk(self, first: int) -> Array:
        """Return the values (n, d) of the chunk from a run."""
        return self.values[first : first + self.study.chunk]

    def about(self) -> dict[str, Any]:
        """Return the description of the results."""
        study = self.study.model_dump(mode="json", exclude={"system"})
        return {"key": self.task.key, "runs": len(self.values), "study": study}


def planned(path: Path) -> Plan:
    """Read a sweep file and check it against its system."""
    study = SweepStudy.read(path)
    system = SystemSpec.read(study.system)
    signals = [s for o in study.outputs for s in (o.signal, o.reference) if s is not None]
    system = system.model_copy(update={"observe": tuple(dict.fromkeys(signals))})
    for output in study.outputs:
        if output.start > system.stop:
            raise ConfigError(
                f"{path}: output '{output.name}' starts at {output.start:g} s, but a run ends "
                f"at {system.stop:g} s.",
                code="sweep.start",
                where=path,
                key="outputs",
            )
    targets = tuple(_targets(study, system, path))
    values = chosen(study)
    digests = {
        fmu: sha256(fmu)
        for fmu in {component.fmu for component in system.components}
        if fmu.is_file()
    }
    task = Task(key="", spec=system, targets=targets, outputs=study.outputs)
    with Master(system, study.system, loaded=POOL) as master:
        master.require_start(task.start(values[0]), path)
        for output in study.outputs:
            if output.reference:
                master.require_alike(output.signal, output.reference, path)
    task = replace(task, key=_key(study, system, digests))
    return Plan(study=study, task=task, values=values, digests=digests)


def _targets(study: SweepStudy, system: SystemSpec, path: Path) -> list[VariedVariable]:
    found = []
    for column, one in enumerate(study.inputs):
        for name in one.variables:
            component, _, variable = name.partition(".")
            base = _base(system, component, variable, path) if one.factor else None
            whole = bool(one.values) and all(float(value).is_integer() for value in one.values)
            found.append(
                VariedVariable(
                    component=component,
                    variable=variable,
                    column=column,
                    base=base,
                    integer=one.integer or whole,
                )
            )
    for column in range(len(study.inputs), len(study.names)):
        component, _, variable = study.names[column].partition(".")
        found.append(VariedVariable(component=component, variable=variable, column=column))
    return found


def _base(system: SystemSpec, component: str, variable: str, path: Path) -> tuple[float, ...]:
    starts = {c.name: c.start for c in system.components}
    value: Value | None = starts.get(component, {}).get(variable)
    if value is None or isinstance(value, str | bool):
        raise ConfigError(
            f"{path}: '{component}.{variable}' is varied by a factor; give it a numeric start "
            "value.",
            code="sweep.factor",
            where=path,
            key="inputs",
        )
    return tuple(map(float, value)) if isinstance(value, tuple) else (float(value),)


def _key(study: SweepStudy, system: SystemSpec, digests: dict[Path, str]) -> str:
    data = {
        "study": study.model_dump(mode="json", exclude={"system"}),
        "system": system.model_dump(mode="json", exclude={"components"}),
        "components": [
            component.model_dump(mode="json", exclude={"fmu"}) | {"fmu": digests.get(component.fmu)}
            for component in system.components
        ],
        "version": version("hesr"),
        "numpy": np.__version__,
    }
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()
