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
from hesr.extras.sweep.study import MAX_RUNS, Correlated, SweepInput, SweepStudy
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


def compute_sensitivities(outputs: Array, study: SweepStudy) -> list[Sensitivity]:
    """Return the indices of outputs (runs, m) that vary and never failed, for a "sobol" design."""
    if study.design != "sobol" or study.runs is None:
        return []
    from scipy.stats import bootstrap  # slow to import

    sensitivities = []
    for output, values in zip(study.outputs, outputs.T, strict=True):
        if not np.isfinite(values).all() or np.ptp(values) == 0.0:
            continue
        blocks = values.reshape(len(study.names) + 2, study.runs)
        blocks = blocks - blocks[:2].mean()  # reduces the error of the estimates
        # The bootstrap of scipy's `sobol_indices` takes no seed.
        spread = bootstrap(
            [np.arange(study.runs)],
            lambda rows, blocks_of_output=blocks: _compute_shares(blocks_of_output[:, rows]),
            vectorized=False,
            confidence_level=0.95,
            n_resamples=499,
            rng=np.random.default_rng(study.seed),
        )
        first, total = _compute_shares(blocks)
        intervals = np.stack(spread.confidence_interval, axis=-1)
        sensitivities.append(
            Sensitivity(output=output.name, first=first, total=total, intervals=intervals)
        )
    return sensitivities


def _compute_shares(blocks: Array) -> Array:
    """Return (2, d) indices by Saltelli et al. (2010)."""
    a = blocks[0]
    b = blocks[1]
    mixed_blocks = blocks[2:]
    first = np.mean(b * (mixed_blocks - a), axis=1)
    total = 0.5 * np.mean((a - mixed_blocks) ** 2, axis=1)
    return np.asarray(np.stack([first, total]) / np.var(blocks[:2]))


_MIN_QUANTILE = 2.0**-53  # smallest distance to 0 and 1 of the quantiles of a normal distribution


def design_inputs(study: SweepStudy) -> Array:
    """Return the values of all inputs, (runs, d)."""
    unit_points = _design_unit_points(study)
    columns = [
        _map_to_values(sweep_input, unit_points[:, k]) for k, sweep_input in enumerate(study.inputs)
    ]
    column = len(columns)
    for group in study.correlated:
        count = len(group.variables)
        columns += list(_map_to_group(group, unit_points[:, column : column + count]).T)
        column += count
    return np.column_stack(columns)


def _design_unit_points(study: SweepStudy) -> Array:
    d = len(study.names)
    runs = study.runs or 0
    if study.design == "grid":
        return _build_grid(study)
    if study.design == "monte_carlo":
        return np.random.default_rng(study.seed).random((runs, d))
    from scipy.stats import qmc  # slow to import

    rng = np.random.default_rng(study.seed)
    if study.design == "latin_hypercube":
        return np.asarray(qmc.LatinHypercube(d, rng=rng).random(runs))
    # Saltelli's blocks A, B and, for each input, A with this input from B (Comput. Phys. Commun.
    # 181 (2010) 259-270, table 2, radial form)
    sobol_points = np.asarray(qmc.Sobol(2 * d, rng=rng).random(runs))
    a = sobol_points[:, :d]
    b = sobol_points[:, d:]
    mixed_blocks = [np.where(np.arange(d) == k, b, a) for k in range(d)]
    return np.concatenate([a, b, *mixed_blocks])


def _build_grid(study: SweepStudy) -> Array:
    levels = []
    for sweep_input in study.inputs:
        value_count = len(sweep_input.values)
        if value_count:
            levels.append((np.arange(value_count) + 0.5) / value_count)
        else:
            levels.append(np.linspace(0.0, 1.0, sweep_input.levels))
    run_count = prod(map(len, levels))
    if run_count > MAX_RUNS:
        raise ConfigError(
            f"the grid of '{study.name}' has {run_count:.3g} runs; at most {MAX_RUNS}.",
            code="sweep.most_runs",
            key="inputs",
        )
    return np.array(list(product(*levels)))


def _map_to_values(sweep_input: SweepInput, unit_points: Array) -> Array:
    if sweep_input.values:
        listed_values: Array = np.array(sweep_input.values)
        return listed_values.take((unit_points * len(listed_values)).astype(int), mode="clip")
    if sweep_input.low is not None and sweep_input.high is not None:
        if sweep_input.integer:
            lower = np.ceil(sweep_input.low)
            upper = np.floor(sweep_input.high)
            return np.asarray(
                np.minimum(lower + np.floor(unit_points * (upper - lower + 1.0)), upper)
            )
        return sweep_input.low + unit_points * (sweep_input.high - sweep_input.low)
    mean = sweep_input.mean or 0.0
    std = sweep_input.std or 0.0
    normal_values: Array = mean + std * _map_to_normal(unit_points)
    if sweep_input.integer:
        return np.round(normal_values)
    return normal_values


def _map_to_group(group: Correlated, unit_points: Array) -> Array:
    eigenvalues, eigenvectors = np.linalg.eigh(np.array(group.covariance))
    root = (eigenvectors * np.sqrt(np.maximum(eigenvalues, 0.0))) @ eigenvectors.T
    return np.asarray(np.array(group.mean) + _map_to_normal(unit_points) @ root)


def _map_to_normal(unit_points: Array) -> Array:
    return np.asarray(ndtri(np.clip(unit_points, _MIN_QUANTILE, 1.0 - _MIN_QUANTILE)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """A sweep: varied `values` (runs, d), and SHA-256 of the FMUs."""

    study: SweepStudy
    task: Task
    values: Array
    digests: dict[Path, str]

    @property
    def chunk_starts(self) -> list[int]:
        """First run of each chunk."""
        return list(range(0, len(self.values), self.study.chunk))

    def chunk(self, chunk_start: int) -> Array:
        """Return the values (n, d) of the chunk from a run."""
        return self.values[chunk_start : chunk_start + self.study.chunk]

    def describe_results(self) -> dict[str, Any]:
        """Return the description of the results."""
        study = self.study.model_dump(mode="json", exclude={"system"})
        return {"key": self.task.key, "runs": len(self.values), "study": study}


def read_plan(path: Path) -> Plan:
    """Read a sweep file and check it against its system."""
    study = SweepStudy.read(path)
    system = SystemSpec.read(study.system)
    signals = []
    for output in study.outputs:
        signals.append(output.signal)
        if output.reference is not None:
            signals.append(output.reference)
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
    targets = tuple(_find_targets(study, system, path))
    values = design_inputs(study)
    fmus = {component.fmu for component in system.components}
    digests = {fmu: sha256(fmu) for fmu in fmus if fmu.is_file()}
    task = Task(key="", system=system, targets=targets, outputs=study.outputs)
    with Master(system, study.system, loaded=POOL) as master:
        master.require_start(task.start(values[0]), path)
        for output in study.outputs:
            if output.reference:
                master.require_same_size(output.signal, output.reference, path)
    task = replace(task, key=_compute_key(study, system, digests))
    return Plan(study=study, task=task, values=values, digests=digests)


def _find_targets(study: SweepStudy, system: SystemSpec, path: Path) -> list[VariedVariable]:
    targets = []
    for column, sweep_input in enumerate(study.inputs):
        for name in sweep_input.variables:
            component, _, variable = name.partition(".")
            base = None
            if sweep_input.factor:
                base = _read_start(system, component, variable, path)
            has_integers = bool(sweep_input.values) and all(
                float(value).is_integer() for value in sweep_input.values
            )
            target = VariedVariable(
                component=component,
                variable=variable,
                column=column,
                base=base,
                integer=sweep_input.integer or has_integers,
            )
            targets.append(target)
    for column in range(len(study.inputs), len(study.names)):
        component, _, variable = study.names[column].partition(".")
        targets.append(VariedVariable(component=component, variable=variable, column=column))
    return targets


def _read_start(system: SystemSpec, component: str, variable: str, path: Path) -> tuple[float, ...]:
    start_values = {
        component_spec.name: component_spec.start for component_spec in system.components
    }
    value: Value | None = start_values.get(component, {}).get(variable)
    if value is None or isinstance(value, str | bool):
        raise ConfigError(
            f"{path}: '{component}.{variable}' is varied by a factor; give it a numeric start "
            "value.",
            code="sweep.factor",
            where=path,
            key="inputs",
        )
    if isinstance(value, tuple):
        return tuple(map(float, value))
    return (float(value),)


def _compute_key(study: SweepStudy, system: SystemSpec, digests: dict[Path, str]) -> str:
    # The content of FMUs counts, not their place.
    components = []
    for component in system.components:
        settings = component.model_dump(mode="json", exclude={"fmu"})
        components.append(settings | {"fmu": digests.get(component.fmu)})
    hashed_inputs = {
        "study": study.model_dump(mode="json", exclude={"system"}),
        "system": system.model_dump(mode="json", exclude={"components"}),
        "components": components,
        "version": version("hesr"),
        "numpy": np.__version__,
    }
    return hashlib.sha256(json.dumps(hashed_inputs, sort_keys=True).encode()).hexdigest()
