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

from fmu_src.run.fmu import FmuInstance
from hesr_model.errors import SimulationError
from hesr_model.support.arrays import Array

FMI_SIM = Path(__file__).parents[2] / ".tools/interop/bin/fmi-sim"
"""An engine in Rust, if `make interop` has installed it."""

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


def is_real(variable: ScalarVariable) -> bool:
    return variable.type in ("Real", "Float64")


def is_number(variable: ScalarVariable) -> bool:
    return is_real(variable) or variable.type in ("Integer", "Int32", "Enumeration")


def start_variables(about: ModelDescription) -> list[ScalarVariable]:
    """Return fixed parameters and start values of a description."""
    return [
        variable
        for variable in about.modelVariables
        if is_number(variable)
        and variable.causality != "input"
        and (variable.variability == "fixed" or variable.initial == "exact")
        and variable.variability != "tunable"
        and variable.variability != "constant"
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


def corner_of(fmu: Path, corner: str) -> dict[str, float]:
    """Return the start values of an FMU in a corner, as far as they differ from declared ones."""
    with FmuInstance(fmu) as component:
        variables = start_variables(component.description)
    values = {v.name: corner_value(v, corner) for v in variables}
    return {name: value for name, value in values.items() if value is not None}


def postures_of(fmu: Path) -> list[dict[str, float]]:
    """Return positions at rest of an FMU with start positions: all or one at 0, and others."""
    with FmuInstance(fmu) as component:
        variables = start_variables(component.description)
    names = [v.name for v in variables if v.name.startswith("q_start[")]
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


def run_in_fmpy(fmu: Path, starts: Starts) -> Run:
    """Run an FMU from these starts; no call may raise a floating-point exception."""
    found = []
    with FmuInstance(fmu) as component:
        inputs = moving_inputs(component.description)
        names = output_names(component.description)
        try:
            with without_exceptions("initialisation"):
                component.initialise(start=dict(starts))
            target = component.buffer(inputs)
            source = component.buffer(names)
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


def run_in_fmi_sim(fmu: Path) -> None:
    """Run an FMU of FMI 3.0 in fmi-sim, which asks for outputs of one element, at its defaults."""
    command = [FMI_SIM, "--model", fmu, "-o", "out.csv", "-q", "co-simulation"]
    command += ["--output-interval", str(STEP), "-f", str(STEP * STEPS)]
    answer = subprocess.run(command, cwd=fmu.parent, capture_output=True, text=True, check=False)
    assert (answer.returncode, answer.stderr) == (0, "")
    assert len((fmu.parent / "out.csv").read_text(encoding="utf-8").splitlines()) >= STEPS


# --- compilers ------------------------------------------------------------------------------------


def compile_sources(fmu: Path, compilers: Sequence[str], folder: Path) -> None:
    """Compile the sources of an FMU with every warning as an error."""
    with ZipFile(fmu) as archive:
        archive.extractall(folder)
    for name in compilers:
        if shutil.which(name) is None:
            continue
        command = [*_COMPILERS[name], *_WARNINGS, "all.c", "-o", f"{name}.so"]
        if name in ("gcc", "clang"):
            command.append("-lm")
        answer = subprocess.run(
            command, cwd=folder / "sources", capture_output=True, text=True, check=False
        )
        assert answer.returncode == 0, answer.stderr


def require_valid(fmu: Path) -> None:
    """Assert that FMPy finds no problem in an FMU."""
    assert validate_fmu(str(fmu)) == []
