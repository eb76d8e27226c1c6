"""Reference results in an SSP for each exchange scheme, as the standard defines none."""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from cosim.systems.simulation import Master
from cosim.systems.system import SystemSpec
from fmu_src.run.archive import Archive
from fmu_src.run.master import ExchangeScheme
from fmu_src.run.reference_results import (
    ROWS,
    ExperimentFiles,
    ReferenceExperiment,
    Verified,
    experiments,
    judge_experiment,
    manifest_files,
    table,
)
from fmu_src.run.trust import is_trusted
from hesr.extras.ssp.contents import SystemContents
from hesr.extras.ssp.ssp_reader import open_ssp
from hesr_model.errors import HesrError, SimulationError

TOLERANCE = 1e-9
"""Tolerance relative to the largest value of a signal: round-off that a loop amplifies."""

_SCHEMES: Mapping[str, tuple[Literal["none", "shown", "all"], str]] = {
    "hold": ("none", "all FMUs step with the inputs of the step's beginning"),
    "shown": ("shown", "the same, outputs shown once the inputs of the next step are set"),
    "refreshed": ("all", "the same, outputs passed on once the inputs of the next step are set"),
}
"""Refreshed outputs and description by exchange scheme."""
_STEM = "extra/results/system"
_README = """\
Reference results of the system, in files that the manifest of FMI-LS-REF in
org.fmi-standard.fmi-ls-ref/ names: each row is the state after a step of {step:.9g} s from the
start on, in SI units, named component.variable. Engines pass values on in different ways, so
there are results for each:

{ways}
"""


def result_files(contents: SystemContents) -> dict[str, bytes]:
    """Return the members of an SSP's folder `extra/`.

    It is empty without outputs, if an FMU is not trusted or has its own step, or a run fails.
    """
    system = contents.system
    signals = [f"{component}.{output}" for component, output in contents.used_outputs]
    is_multirate = any(system.find_step_multiple(c) > 1 for c in system.components)
    if (
        is_multirate
        or not signals
        or not all(is_trusted(component.fmu) for component in system.components)
    ):
        return {}
    t = np.round(system.step * np.arange(min(ROWS, system.steps) + 1), 12)
    try:
        signals_by_scheme = {name: _run_scheme(system, signals, t, name) for name in _SCHEMES}
    except HesrError:
        return {}
    scheme_lines = "\n".join(
        f"    {_STEM}_{name}.csv: {text}" for name, (_, text) in _SCHEMES.items()
    )
    files = {"extra/README.txt": _README.format(step=system.step, ways=scheme_lines).encode()}
    files[f"{_STEM}_in.csv"] = table({"time": t}, 12)
    files |= {
        f"{_STEM}_{name}.csv": table({"time": t, **signal_values}, 14)
        for name, signal_values in signals_by_scheme.items()
    }
    experiment_files = ExperimentFiles(
        runs=[(name, text, name) for name, (_, text) in _SCHEMES.items()],
        t=t,
        step=system.step,
        tolerance=TOLERANCE,
        stem=_STEM,
    )
    return files | manifest_files([experiment_files], files)


def verify_ssp(path: Path) -> Verified:
    """Run the experiments in an SSP and compare with its reference results."""
    verified = Verified()
    with Archive(path, "SSP") as archive:
        stored_experiments = experiments(archive, verified)
    if stored_experiments:
        with open_ssp(path, {}, {}) as system:
            for experiment in stored_experiments:
                _judge(system, experiment, verified)
    return verified


def _judge(system: SystemSpec, experiment: ReferenceExperiment, verified: Verified) -> None:
    experiment_name = experiment.name
    t = experiment.t
    signals = list(experiment.outputs)

    def play_experiment(scheme_name: str) -> np.ndarray:
        rows = _run_scheme(system, signals, t, scheme_name)
        return np.column_stack([rows[name] for name in signals])

    if len(t) < 2 or np.any(np.abs(t - system.step * np.arange(len(t))) > 1e-9 * system.step):
        verified.skipped.append(
            f"Experiment '{experiment_name}': its rows are not at the system's steps."
        )
        return
    judge_experiment(experiment, _SCHEMES, play_experiment, verified)


def _run_scheme(
    system: SystemSpec, signals: list[str], t: np.ndarray, scheme_name: str
) -> dict[str, np.ndarray]:
    changes = {"stop": system.step * (len(t) - 1), "observe": tuple(signals), "limits": {}}
    scheme = ExchangeScheme(order="jacobi", refreshed=_SCHEMES[scheme_name][0])
    with Master(system.model_copy(update=changes), scheme=scheme) as master:
        signal_values = master.run().require_success().signals
    for signal in signals:
        if signal not in signal_values:
            raise SimulationError(f"'{signal}' is a vector; reference results are scalars.")
    return signal_values
