"""Tracking in closed loop (Table III), through the FMUs."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cosim.loop.closed_loop import Law, Scheme, Setting, system
from cosim.loop.traces import Trace, Tracked
from cosim.systems.simulation import Master
from cosim.systems.system import Value
from fmu_src.blocks.trajectory import start_values
from fmu_src.run.fmu import POOL
from hesr_model.motions.trajectories import Trajectory
from hesr_model.support import parallel
from hesr_model.support.arrays import Array
from hesr_model.support.files import sha256, written_whole
from hesr_model.support.progress import Progress, silent
from hesr_model.support.typed_files import from_json, read_json, to_text


@dataclass(frozen=True, kw_only=True)
class LoopMotion:
    """A motion in the parameters of the FMUs."""

    parameters: Mapping[str, Value]  # Trajectory FMU
    q0: tuple[float, ...]  # [rad]

    @classmethod
    def of(cls, trajectory: Trajectory) -> "LoopMotion":
        """Convert a motion in closed form."""
        q0 = trajectory.sample(np.zeros(1))[0][0]
        return cls(parameters=start_values(trajectory), q0=tuple(map(float, q0)))


@dataclass(frozen=True, kw_only=True)
class LoopRow:
    """One row of a table: a law in a scheme."""

    scheme: Scheme
    law: Law
    setting: Setting


@dataclass(frozen=True, kw_only=True, eq=False)
class _Kept:
    tracked: Tracked
    trace: Trace | None


def track(
    rows: Sequence[LoopRow],
    motions: Sequence[LoopMotion],
    *,
    duration: float,
    limits: Array,
    traced: bool = False,
    kept: Path | None = None,
    workers: int | None = None,
    progress: Progress = silent,
) -> list[Tracked]:
    """Run every row along every motion for `duration` [s]; return one result per row.

    A run ends early outside `limits` (n, 2) [rad]. `traced` keeps the first motion's positions.
    """
    about = ([asdict(motion) for motion in motions], duration, limits.tolist(), traced)
    files = [kept / f"{key}.json" for key in _keys(rows, about)] if kept else []
    done: dict[int, Tracked] = {}
    for i, file in enumerate(files):
        if file.is_file():
            found = from_json(_Kept, read_json(file), file, "a finished row")
            done[i] = replace(found.tracked, trace=found.trace)
    left = [i for i in range(len(rows)) if i not in done]
    progress(len(done), len(rows))
    jobs = [partial(_tracked, rows[i], motions, duration, limits, traced) for i in left]
    try:
        names = [f"{rows[i].law}, {rows[i].scheme}" for i in left]
        with parallel.results_of(jobs, workers, names=names) as results:
            for i, result in zip(left, results, strict=True):
                done[i] = result
                if kept:
                    row = _Kept(tracked=result, trace=result.trace)
                    with written_whole(files[i]) as temporary:
                        temporary.write_text(to_text(row), encoding="utf-8")
                progress(len(done), len(rows))
    finally:
        POOL.clear()  # for runs in this process
    return [done[i] for i in range(len(rows))]


def _tracked(
    row: LoopRow, motions: Sequence[LoopMotion], duration: float, limits: Array, traced: bool
) -> Tracked:
    spec = system(row.setting, duration=duration, limits=limits)
    rmse, last, failures = [], [], []
    trace: Trace | None = None
    with Master(spec, loaded=POOL) as master:
        for motion in motions:
            result = master.run(start={"trajectory": motion.parameters, "arm": {"q0": motion.q0}})
            q_d, q = (result.vector(name) for name in ("trajectory.q", "arm.q_true"))
            error = q_d - q
            if traced and trace is None:
                trace = Trace(t=result.t, q_d=q_d, q=q)
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


def _keys(rows: Sequence[LoopRow], about: Sequence[Any]) -> list[str]:
    hashes: dict[Path, str] = {}  # by FMU; rows share them
    keys = []
    for row in rows:
        setting = asdict(row.setting) | {"gains": row.setting.gains.model_dump()}
        paths = {name: path for name, path in setting["fmus"].items() if path}
        hashes |= {path: sha256(path) for path in paths.values() if path not in hashes}
        files = {name: hashes[path] for name, path in paths.items()}
        data = [row.scheme.name, row.law, setting | {"fmus": files}, *about]
        text = json.dumps(data, default=list, sort_keys=True)
        keys.append(hashlib.sha256(text.encode()).hexdigest()[:24])
    return keys
