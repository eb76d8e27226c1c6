"""Results of the closed loop: tracking errors, positions over time, and its files."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from cosim.loop.closed_loop import Law, NamedScheme, Scheme
from cosim.systems.system import SystemSpec, write_system
from hesr_model.errors import ArtifactError, LogError
from hesr_model.findings import Finding
from hesr_model.logs.readers.arrays import load_arrays
from hesr_model.logs.tables import import_arrow, number_columns, write_table
from hesr_model.support import plugins
from hesr_model.support.arrays import Array
from hesr_model.support.files import models_folder, written_whole
from hesr_model.support.result_folder import folder_written_whole
from hesr_model.support.typed_files import Numbers, NumbersWithGaps

_LOOP_FILES = ("closed_loop.toml", "plant_loop.toml")
_SCRIPT = "simulate.py"


def complete_loops(folder: Path) -> None:
    """Write the script that runs the loops in a folder, and their SSPs if that is possible."""
    ssp = plugins.load("hesr.exports.system").get("ssp")
    for path in _find_loops(folder):
        if ssp:
            ssp.load().write(path, path.with_suffix(".ssp"))
        shutil.copyfile(models_folder() / "loop" / _SCRIPT, folder / _SCRIPT)


def _find_loops(folder: Path) -> list[Path]:
    return [path for name in _LOOP_FILES if (path := folder / name).is_file()]


def copy_loops(results: Path, output: Path) -> Path:
    """Copy the loops of results with all their FMUs into a folder that needs nothing else."""
    loops = _find_loops(results)
    if not loops:
        raise ArtifactError(
            f"{results}: has no {_LOOP_FILES[0]}; 'hesr run' writes it for a study with [twin] and "
            "[tracking]."
        )
    with folder_written_whole(output) as folder:
        (folder / "fmus").mkdir()
        for path in loops:
            system = SystemSpec.read(path)
            for fmu in (
                *(component.fmu for component in system.components),
                *results.glob("fmus/Velocity.fmu"),
            ):
                shutil.copyfile(fmu, folder / "fmus" / fmu.name)
            copied_components = tuple(
                component.model_copy(update={"fmu": folder / "fmus" / component.fmu.name})
                for component in system.components
            )
            write_system(
                system.model_copy(update={"components": copied_components}), folder / path.name
            )
        complete_loops(folder)
    return output


TRACES = "closed_loop.npz"
FOLLOWING = "following.json"
_Errors = tuple[float, ...]  # by joint


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """One run of the closed loop."""

    t: Numbers  # (N,) [s]
    q_d: Numbers  # desired (N, n) [rad]
    q: Numbers  # true (N, n) [rad]


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracked:
    """Tracking errors of a row."""

    scheme: NamedScheme
    law: Law
    rmse: NumbersWithGaps  # (M, n) by motion and joint [rad]; NaN if failed
    last: NumbersWithGaps  # (M, n) mean error over the last tenth [rad]
    failures: tuple[str, ...] = ()
    trace: Annotated[Trace | None, Field(exclude=True)] = None  # not in JSON

    @property
    def mean(self) -> Array:
        """Mean over the motions, (n,) [rad]."""
        return np.asarray(self.rmse.mean(axis=0))

    @property
    def spread(self) -> Array:
        """Standard deviation over the motions, (n,) [rad]."""
        return np.asarray(self.rmse.std(axis=0))


@dataclass(frozen=True, kw_only=True)
class FollowingError:
    """Following error under one command: RMS by joint and its interval [rad; m]."""

    command: str
    error: _Errors
    low: _Errors
    high: _Errors


@dataclass(frozen=True, kw_only=True)
class Following:
    """Following errors of the user's robot."""

    missing: str = ""  # reason if they are unknown
    log: str = ""
    latency: float = 0.0  # [s]
    kv: _Errors = ()  # [N.m.s/rad]
    ki: _Errors = ()  # [N.m/rad]
    kp: _Errors = ()  # [1/s]
    rows: tuple[FollowingError, ...] = ()  # first: commands as logged; last: recommended law


@dataclass(frozen=True, kw_only=True)
class Overcompensation:
    """Lowest factor on the friction torque that makes an arm at rest cycle."""

    law: str
    scheme: NamedScheme
    factor: float | None  # None if the arm rests at all `FACTORS`


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopOutcome:
    """Results of the closed loop of a study."""

    tracking: Sequence[Tracked]  # all laws, schemes and motions
    long: Sequence[Tracked]  # selected rows, one long motion
    sweeps: Sequence[Tracked]  # selected rows, changed arm or controller
    overcompensation: Sequence[Overcompensation]
    findings: Annotated[Sequence[Finding], Field(exclude=True)] = ()  # not in JSON


def write_traces(path: Path, runs: Sequence[tuple[Scheme, str, Trace]]) -> None:
    """Write traces of (scheme, law) as long NumPy columns: ``scheme, law, t, q_d1.., q1..``."""
    rows = [len(trace.t) for _, _, trace in runs]
    columns = {
        "scheme": np.repeat([scheme.name for scheme, _, _ in runs], rows),
        "law": np.repeat([law_name for _, law_name, _ in runs], rows),
        "t": np.concatenate([trace.t for _, _, trace in runs]),
        **number_columns(
            q_d=np.concatenate([trace.q_d for _, _, trace in runs]),
            q=np.concatenate([trace.q for _, _, trace in runs]),
        ),
    }
    with written_whole(path) as temporary:
        write_table(temporary, columns)


def read_traces(path: Path) -> dict[tuple[Scheme, str], Trace]:
    """Return the traces of a file, or of the Parquet file of an older result, by (scheme, law)."""
    older_path = path.with_suffix(".parquet")
    if not path.is_file() and not older_path.is_file():
        raise ArtifactError(
            f"{path}: no such file; 'hesr run' writes it for a study with [tracking]."
        )
    is_older = not path.is_file()
    if is_older:
        arrow = import_arrow()  # if it is missing, the file is not to blame
    try:
        if is_older:
            return _split_traces(arrow.parquet.read_table(older_path).to_pydict())
        return _split_traces(load_arrays(path))
    except (LogError, OSError, KeyError, IndexError, TypeError, ValueError) as error:
        raise ArtifactError(f"{path}: is not a file of closed-loop traces.") from error


def _split_traces(columns: Mapping[str, Any]) -> dict[tuple[Scheme, str], Trace]:
    """Return the traces of the columns of `write_traces`."""
    numbers = range(1, len(columns) + 1)  # more than there are joints
    desired_names = [f"q_d{number}" for number in numbers if f"q_d{number}" in columns]
    names = [f"q{number}" for number in numbers if f"q{number}" in columns]
    values = np.column_stack(
        [np.asarray(columns[name], dtype=float) for name in ("t", *desired_names, *names)]
    )
    runs = list(zip(map(str, columns["scheme"]), map(str, columns["law"]), strict=True))
    run_numbers = {run: k for k, run in enumerate(dict.fromkeys(runs))}
    number_of_row = np.array([run_numbers[run] for run in runs])
    joint_count = len(desired_names)
    traces = {}
    for (scheme, law_name), k in run_numbers.items():
        run_values = values[number_of_row == k]
        traces[Scheme.from_name(scheme), law_name] = Trace(
            t=run_values[:, 0],
            q_d=run_values[:, 1 : 1 + joint_count],
            q=run_values[:, 1 + joint_count :],
        )
    return traces
