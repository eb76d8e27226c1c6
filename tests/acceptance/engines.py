"""Engines that run an artefact at one start: FMPy under traps, libcosim, and compilers of C."""

import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from zipfile import ZipFile

import numpy as np
from acceptance.artefacts import STEP
from floating_point import without_exceptions
from fmpy import read_model_description
from fmpy.model_description import ModelDescription, ScalarVariable
from fmpy.validation import validate_fmu
from fmu_variables import is_integer, is_real

from fmu_src.run.fmu import FmuInstance
from hesr_model.errors import SimulationError
from hesr_model.support.arrays import Array

REST, STEPS = 10, 40
"""Steps with all inputs at 0, and all steps."""

_WARNINGS = ("-Wall", "-Wextra", "-pedantic", "-Werror", "-ffp-contract=off", "-fPIC", "-shared")
_COMPILERS = {
    "gcc": ("gcc", "-std=c99"),
    "clang": ("clang", "-std=c99"),
    "g++": ("g++", "-std=c++17", "-x", "c++"),
    "clang++": ("clang++", "-std=c++17", "-x", "c++"),
}

# --- start values and inputs ----------------------------------------------------------------------

Starts = Mapping[str, float]


def is_number(variable: ScalarVariable) -> bool:
    return is_real(variable) or is_integer(variable) or variable.type == "Enumeration"


def start_variables(about: ModelDescription) -> list[ScalarVariable]:
    """Return fixed parameters and start values of a description."""
    return [
        variable
        for variable in about.modelVariables
        if is_number(variable)
        and variable.causality != "input"
        and (variable.variability == "fixed" or variable.initial == "exact")
        and variable.variability not in ("tunable", "constant")
        and variable.start is not None
    ]


def corner_value(variable: ScalarVariable, corner: str) -> float | None:
    """Return the value of a start variable in a corner, or None if it has none there."""
    least = None if variable.min is None else float(variable.min)
    largest = None if variable.max is None else float(variable.max)
    if corner == "minimum":
        return least
    if corner == "maximum":
        return largest
    is_allowed = (least is None or least <= 0.0) and (largest is None or largest >= 0.0)
    return 0.0 if corner == "zero" and is_allowed else None


def corner_of(about: ModelDescription, corner: str) -> dict[str, float]:
    """Return the start values in a corner, without those that it leaves as declared."""
    values = {v.name: corner_value(v, corner) for v in start_variables(about)}
    return {name: value for name, value in values.items() if value is not None}


def postures_of(about: ModelDescription) -> list[dict[str, float]]:
    """Return positions at rest of an FMU with start positions: all or one at 0, and others."""
    names = [v.name for v in start_variables(about) if v.name.startswith("q_start[")]
    rng = np.random.default_rng(5)
    if not names:
        return []
    postures = [np.zeros(len(names)), *rng.uniform(-1.2, 1.2, (4, len(names)))]
    for posture in postures[1:3]:
        posture[rng.integers(len(posture))] = 0.0
    return [dict(zip(names, map(float, posture), strict=True)) for posture in postures]


def moving_inputs(about: ModelDescription) -> list[str]:
    return [v.name for v in about.modelVariables if v.causality == "input" and is_real(v)]


def output_names(about: ModelDescription) -> list[str]:
    return [v.name for v in about.modelVariables if v.causality == "output" and is_real(v)]


def input_rows(size: int) -> Array:
    """Return inputs (STEPS, size): at rest, then waves with reversals."""
    t = STEP * np.arange(STEPS)[:, None]
    rows = 0.3 * np.sin(30.0 * t + 0.5 * np.arange(size))
    rows[:REST] = 0.0
    return np.asarray(rows)


# --- FMPy, and libcosim ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Run:
    """Outputs (STEPS, outputs) of a run, or the sentence of its refusal."""

    outputs: Array | None
    refusal: str = ""


def run_in_fmpy(component: FmuInstance, starts: Starts) -> Run:
    """Reset an FMU and run it from these starts; no call may raise a floating-point exception."""
    found = []
    inputs = moving_inputs(component.description)
    target = component.buffer(inputs)
    source = component.buffer(output_names(component.description))
    try:
        component.reset()
        with without_exceptions("initialisation"):
            component.initialise(start=dict(starts))
        for k, row in enumerate(input_rows(len(inputs))):
            target.values[:] = row
            with without_exceptions(f"step {k}"):
                target.write()
                component.step(k * STEP, STEP)
            with without_exceptions(f"outputs of step {k}"):
                found.append(source.read().copy())
    except SimulationError as error:
        return Run(None, str(error))
    return Run(np.array(found))


def run_in_libcosim(fmu: Path, starts: Starts) -> Array:
    """Run an FMU of FMI 2.0 in the Open Simulation Platform, and return its outputs."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimManipulator import CosimManipulator
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    about = read_model_description(fmu, validate=False)
    reference = {v.name: v.valueReference for v in about.modelVariables}
    types = {v.name: v.type for v in about.modelVariables}
    execution = CosimExecution.from_step_size(round(STEP * 1e9))
    slave = execution.add_local_slave(CosimLocalSlave(fmu_path=str(fmu), instance_name="unit"))
    for name, value in starts.items():
        if types[name] == "Real":
            assert execution.real_initial_value(slave, reference[name], value)
        else:
            assert execution.integer_initial_value(slave, reference[name], round(value))
    manipulator, observer = CosimManipulator.create_override(), CosimObserver.create_last_value()
    assert execution.add_manipulator(manipulator)
    assert execution.add_observer(observer)
    inputs = [reference[name] for name in moving_inputs(about)]
    outputs = [reference[name] for name in output_names(about)]
    found = []
    for row in input_rows(len(inputs)):
        assert manipulator.slave_real_values(slave, inputs, row.tolist())
        assert execution.step()
        found.append(observer.last_real_values(slave, outputs))
    return np.array(found)


# --- compilers ------------------------------------------------------------------------------------


def compile_sources(fmu: Path, compilers: Sequence[str], folder: Path) -> list[str]:
    """Compile the sources of an FMU with every warning as an error.

    Returns the compilers that are installed.
    """
    with ZipFile(fmu) as archive:
        archive.extractall(folder)
    installed = [name for name in compilers if shutil.which(name)]
    for name in installed:
        command = [*_COMPILERS[name], *_WARNINGS, "all.c", "-o", f"{name}.so"]
        if name in ("gcc", "clang"):
            command.append("-lm")
        answer = subprocess.run(
            command, cwd=folder / "sources", capture_output=True, text=True, check=False
        )
        assert answer.returncode == 0, answer.stderr
    return installed


def require_valid(fmu: Path) -> None:
    """Assert that FMPy finds no problem in an FMU."""
    assert validate_fmu(str(fmu)) == []
