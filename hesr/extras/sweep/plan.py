"""Plan of a sweep, checked against the system."""

import hashlib
import json
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from cosim.systems.simulation import Master
from cosim.systems.system import SystemSpec, Value
from fmu_src.run.fmu import POOL
from hesr.extras.sweep.design import chosen
from hesr.extras.sweep.sensitivity import Sensitivity
from hesr.extras.sweep.store import RunTable
from hesr.extras.sweep.study import SweepStudy
from hesr.extras.sweep.work import Task, VariedVariable
from hesr_model.errors import ConfigError
from hesr_model.support.arrays import Array
from hesr_model.support.files import sha256


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


@dataclass(frozen=True, kw_only=True, eq=False)
class SweepRuns:
    """Runs of a sweep, `reused` of them from before; sensitivities only for ``"sobol"``."""

    plan: Plan
    table: RunTable
    sensitivities: list[Sensitivity]
    reused: int

    def worst(self, output: int, most: int = 5) -> list[int]:
        """Return runs with the largest magnitudes of an output, failed ones first."""
        values = np.abs(self.table.outputs[:, output])
        order = np.argsort(np.where(np.isnan(values), -np.inf, -values), kind="stable")
        return [int(run) for run in order[:most]]


def planned(path: Path) -> Plan:
    """Read a sweep file and check it against its system."""
    study = SweepStudy.read(path)
    spec = SystemSpec.read(study.system)
    signals = [s for o in study.outputs for s in (o.signal, o.reference) if s is not None]
    spec = spec.model_copy(update={"observe": tuple(dict.fromkeys(signals))})
    for output in study.outputs:
        if output.start > spec.stop:
            raise ConfigError(
                f"{path}: output '{output.name}' starts at {output.start:g} s, but a run ends "
                f"at {spec.stop:g} s."
            )
    targets = tuple(_targets(study, spec, path))
    values = chosen(study)
    digests = {fmu: sha256(fmu) for fmu in {c.fmu for c in spec.components} if fmu.is_file()}
    task = Task(key="", spec=spec, targets=targets, outputs=study.outputs)
    with Master(spec, study.system, loaded=POOL) as master:
        master.require_start(task.start(values[0]), path)
        for output in study.outputs:
            if output.reference:
                master.require_alike(output.signal, output.reference, path)
    task = replace(task, key=_key(study, spec, digests))
    return Plan(study=study, task=task, values=values, digests=digests)


def _targets(study: SweepStudy, spec: SystemSpec, path: Path) -> list[VariedVariable]:
    found = []
    for column, one in enumerate(study.inputs):
        for name in one.variables:
            component, _, variable = name.partition(".")
            base = _base(spec, component, variable, path) if one.factor else None
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


def _base(spec: SystemSpec, component: str, variable: str, path: Path) -> tuple[float, ...]:
    starts = {c.name: c.start for c in spec.components}
    value: Value | None = starts.get(component, {}).get(variable)
    if value is None or isinstance(value, str | bool):
        raise ConfigError(
            f"{path}: '{component}.{variable}' is varied by a factor; give it a numeric start "
            "value."
        )
    return tuple(map(float, value)) if isinstance(value, tuple) else (float(value),)


def _key(study: SweepStudy, spec: SystemSpec, digests: dict[Path, str]) -> str:
    system = spec.model_dump(mode="json", exclude={"components"})
    components = [
        c.model_dump(mode="json", exclude={"fmu"}) | {"fmu": digests.get(c.fmu)}
        for c in spec.components
    ]
    data = {
        "study": study.model_dump(mode="json", exclude={"system"}),
        "system": system,
        "components": components,
        "version": version("hesr"),
        "numpy": np.__version__,
    }
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()
