"""Tracking in closed loop (Table III): every law in every scheme, through the FMUs."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cosim.batch import Array
from cosim.closed_loop import Setting, system
from cosim.master import Master, Result
from cosim.studies.traces import Trace
from cosim.system import Value
from fmu_src.blocks.trajectory import start_values
from hesr_model import parallel
from hesr_model.files import sha256, written_whole
from hesr_model.progress import Progress, unheard
from hesr_model.trajectories import Trajectory


@dataclass(frozen=True, kw_only=True)
class Motion:
    """A motion as the FMUs take it.

    Attributes
    ----------
    parameters : of the Trajectory FMU.
    q0 : where the arm begins [rad].
    """

    parameters: Mapping[str, Value]
    q0: tuple[float, ...]

    @classmethod
    def of(cls, trajectory: Trajectory) -> "Motion":
        """Return a motion in closed form as one for the FMUs."""
        q0 = trajectory.sample(np.zeros(1))[0][0]
        return cls(parameters=start_values(trajectory), q0=tuple(map(float, q0)))


@dataclass(frozen=True, kw_only=True)
class Row:
    """One row of a table: a law in a scheme.

    Attributes
    ----------
    scheme : name of the scheme.
    law : name of the law, or what stands in its place.
    setting : the loop.
    """

    scheme: str
    law: str
    setting: Setting


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracked:
    """How well a row tracks.

    Attributes
    ----------
    scheme, law : of the row.
    rmse : (M, n) error of each motion and joint [rad]; NaN for a run that failed.
    last : (M, n) mean error over the last tenth of each run [rad], which shows drift.
    failures : why runs ended early.
    trace : the run along the first motion, where that was asked for; not part of the JSON data.
    """

    scheme: str
    law: str
    rmse: Array
    last: Array
    failures: tuple[str, ...] = ()
    trace: Trace | None = None

    @property
    def mean(self) -> Array:
        """Mean over the motions, (n,) [rad]."""
        return np.asarray(self.rmse.mean(axis=0))

    @property
    def spread(self) -> Array:
        """Standard deviation over the motions, (n,) [rad]."""
        return np.asarray(self.rmse.std(axis=0))

    def to_json(self) -> dict[str, Any]:
        """Return JSON data in rad; a run that failed has no numbers."""
        return {
            "scheme": self.scheme,
            "law": self.law,
            "rmse": _numbers(self.rmse),
            "last": _numbers(self.last),
            "failures": list(self.failures),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> "Tracked":
        """Rebuild what `to_json` returned."""
        return cls(
            scheme=data["scheme"],
            law=data["law"],
            rmse=np.array(data["rmse"], dtype=float),
            last=np.array(data["last"], dtype=float),
            failures=tuple(data["failures"]),
        )


def track(
    rows: Sequence[Row],
    motions: Sequence[Motion],
    *,
    duration: float,
    limits: Array,
    traced: bool = False,
    kept: Path | None = None,
    workers: int | None = None,
    progress: Progress = unheard,
) -> list[Tracked]:
    """Run every row along every motion.

    Parameters
    ----------
    rows : laws in schemes.
    motions : what is tracked.
    duration : of a run [s].
    limits : (n, 2) positions at which a run is stopped [rad].
    traced : keep the positions along the first motion.
    kept : folder in which finished rows are kept, so that an interrupted study can go on.
    workers : processes; one for each core where not given, none of its own for 1.
    progress : told how many rows are done and how many there are.

    Returns
    -------
    One result for each row, in their order; runs that failed are part of it.
    """
    done: dict[int, Tracked] = {}
    left: list[int] = []
    keys = _keys(rows, motions, duration, limits, traced) if kept else [""] * len(rows)
    for i, key in enumerate(keys):
        file = kept / f"{key}.json" if kept else None
        if file and file.is_file():
            done[i] = _restored(json.loads(file.read_text(encoding="utf-8")))
        else:
            left.append(i)

    def keep(i: int, result: Tracked) -> None:
        done[i] = result
        if kept:
            kept.mkdir(parents=True, exist_ok=True)
            with written_whole(kept / f"{keys[i]}.json") as temporary:
                temporary.write_text(json.dumps(_whole(result)), encoding="utf-8")
        progress(len(done), len(rows))

    progress(len(done), len(rows))
    jobs = [partial(_tracked, rows[i], motions, duration, limits, traced) for i in left]
    with parallel.begun(jobs, workers) as results:
        for i, result in zip(left, results, strict=True):
            keep(i, result())
    return [done[i] for i in range(len(rows))]


def _tracked(
    row: Row, motions: Sequence[Motion], duration: float, limits: Array, traced: bool
) -> Tracked:
    spec = system(row.setting, duration=duration, limits=limits)
    rmse, last, failures = [], [], []
    trace: Trace | None = None
    with Master(spec) as master:
        for motion in motions:
            result = master.run(start={"trajectory": motion.parameters, "arm": {"q0": motion.q0}})
            error = result.vector("trajectory.q") - result.vector("arm.q_true")
            if traced and trace is None:
                trace = _trace(result)
            if result.failure:
                failures.append(str(result.failure))
                error = np.full((1, len(limits)), np.nan)
            rmse.append(np.sqrt(np.mean(error**2, axis=0)))
            last.append(np.mean(error[-max(len(error) // 10, 1) :], axis=0))
    return Tracked(
        scheme=row.scheme,
        law=row.law,
        rmse=np.array(rmse),
        last=np.array(last),
        failures=tuple(failures),
        trace=trace,
    )


def _trace(result: Result) -> Trace:
    return Trace(t=result.t, q_d=result.vector("trajectory.q"), q=result.vector("arm.q_true"))


def _whole(tracked: Tracked) -> dict[str, Any]:
    """Return JSON data with the trace."""
    return tracked.to_json() | {"trace": tracked.trace.to_json() if tracked.trace else None}


def _restored(data: Mapping[str, Any]) -> Tracked:
    """Rebuild what `_whole` returned."""
    trace = Trace.from_json(data["trace"]) if data["trace"] else None
    return replace(Tracked.from_json(data), trace=trace)


def _keys(
    rows: Sequence[Row],
    motions: Sequence[Motion],
    duration: float,
    limits: Array,
    traced: bool,
) -> list[str]:
    """Return names of the rows' results, which change with anything that these depend on."""
    hashes: dict[Path, str] = {}  # rows share their FMUs
    moved = [asdict(motion) for motion in motions]
    keys = []
    for row in rows:
        setting = asdict(row.setting) | {"gains": row.setting.gains.model_dump()}
        paths = {name: path for name, path in setting["fmus"].items() if path}
        hashes |= {path: sha256(path) for path in paths.values() if path not in hashes}
        files = {name: hashes[path] for name, path in paths.items()}
        run = (moved, duration, limits.tolist(), traced)
        data = [row.scheme, row.law, setting | {"fmus": files}, *run]
        text = json.dumps(data, default=list, sort_keys=True)
        keys.append(hashlib.sha256(text.encode()).hexdigest()[:24])
    return keys


def _numbers(values: Array) -> list[list[float | None]]:
    return [[float(x) if np.isfinite(x) else None for x in row] for row in values]
