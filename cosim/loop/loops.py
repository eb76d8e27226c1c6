"""Rows, motions and FMUs of the closed-loop part of a study."""

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from cosim.loop import closed_loop
from cosim.loop.closed_loop import Compensation, Fmus, Law, Scheme, Setting, StandIn, Tracking
from cosim.loop.motions import require_within
from cosim.loop.traces import Trace, Tracked
from cosim.systems.simulation import Master
from cosim.systems.system import SystemSpec, Value
from fmu_src.arm.plant import Plant
from fmu_src.blocks.controller import controller, velocity
from fmu_src.blocks.inverse_dynamics import inverse_dynamics
from fmu_src.blocks.trajectory import start_values, trajectory
from fmu_src.export.package import Content, write_fmu
from fmu_src.export.toolchain import HOST
from fmu_src.friction.friction_fmu import export_bare
from fmu_src.run.fmu import POOL
from hesr_model.errors import ConfigError
from hesr_model.friction.model import FrictionModel
from hesr_model.motions.trajectories import Fourier, Trajectory, random_fourier
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot
from hesr_model.support import parallel
from hesr_model.support.arrays import Array
from hesr_model.support.files import sha256, written_whole
from hesr_model.support.progress import Stages, silent
from hesr_model.support.typed_files import from_json, read_json, to_text


@dataclass(frozen=True, kw_only=True)
class LoopMotion:
    """A motion in the parameters of the FMUs."""

    parameters: Mapping[str, Value]  # Trajectory FMU
    q0: tuple[float, ...]  # [rad]

    @classmethod
    def from_trajectory(cls, trajectory: Trajectory) -> "LoopMotion":
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
class _FinishedRow:
    """A row in its checkpoint; the trace is not part of the JSON of `Tracked`."""

    tracked: Tracked
    trace: Trace | None


def _track_row(
    row: LoopRow, motions: Sequence[LoopMotion], duration: float, limits: Array, traced: bool
) -> Tracked:
    system = closed_loop.build_system(row.setting, duration=duration, limits=limits)
    rmse = []
    final_errors = []
    failures = []
    trace: Trace | None = None
    with Master(system, loaded=POOL) as master:
        for motion in motions:
            signals = master.run(start={"trajectory": motion.parameters, "arm": {"q0": motion.q0}})
            q_d, q = (signals.vector(name) for name in ("trajectory.q", "arm.q_true"))
            error = q_d - q
            if traced and trace is None:
                trace = Trace(t=signals.t, q_d=q_d, q=q)
            if signals.failure:
                failures.append(str(signals.failure))
                error = np.full((1, len(limits)), np.nan)
            rmse.append(np.sqrt(np.mean(error**2, axis=0)))
            final_errors.append(np.mean(error[-max(len(error) // 10, 1) :], axis=0))
    return Tracked(
        scheme=row.scheme,
        law=row.law,
        rmse=np.array(rmse),
        last=np.array(final_errors),
        failures=tuple(failures),
        trace=trace,
    )


def _compute_keys(rows: Sequence[LoopRow], run_settings: Sequence[Any]) -> list[str]:
    hashes: dict[Path, str] = {}  # by FMU; rows share them
    keys = []
    for row in rows:
        setting = asdict(row.setting) | {"gains": row.setting.gains.model_dump()}
        paths = {name: path for name, path in setting["fmus"].items() if path}
        hashes |= {path: sha256(path) for path in paths.values() if path not in hashes}
        files = {name: hashes[path] for name, path in paths.items()}
        hashed_inputs = [row.scheme.name, row.law, setting | {"fmus": files}, *run_settings]
        text = json.dumps(hashed_inputs, default=list, sort_keys=True)
        keys.append(hashlib.sha256(text.encode()).hexdigest()[:24])
    return keys


_COMPENSATIONS: tuple[Compensation, ...] = ("torque_error", "servo_inversion")
_MEASURED_SOURCES: tuple[closed_loop.VelocitySource, ...] = ("measured", "filtered")
_MARGIN = 0.5  # [rad] beyond the joint limits, where a run has diverged


def motions(tracking: Tracking, periods: int = 1) -> list[LoopMotion]:
    """Return the motions of a study."""
    return [
        LoopMotion.from_trajectory(_build_fourier(tracking, seed, periods))
        for seed in tracking.seeds
    ]


def _build_fourier(tracking: Tracking, seed: int, periods: int = 1) -> Fourier:
    return random_fourier(
        seed=seed,
        harmonics=tracking.harmonics,
        period=tracking.duration,
        peak_velocity=np.array(tracking.peak_velocity),
        offset=np.array(tracking.offset),
        periods=periods,
    )


def require_reachable(tracking: Tracking, robot: Robot) -> None:
    """Raise ConfigError if a motion leaves the limits of the robot."""
    for key, entries in (("peak_velocity", tracking.peak_velocity), ("offset", tracking.offset)):
        if len(entries) != robot.n:
            raise ConfigError(
                f"tracking: key '{key}' has {len(entries)} entries; the robot has {robot.n} joints."
            )
    limits = np.column_stack(robot.limits[:2])
    t = np.linspace(0.0, tracking.duration, 2001)
    for seed in tracking.seeds:
        q = _build_fourier(tracking, seed).sample(t)[0]
        require_within(limits, q, robot.description.joints, f"tracking: the motion of seed {seed}")


@dataclass(frozen=True, kw_only=True)
class StudyLoop:
    """Common data of the rows of a study."""

    tracking: Tracking
    friction: Mapping[str, Path]  # by law
    oracle: Path  # true friction
    fmus: Fmus  # FMUs with the identified rigid body
    true_body: Path
    step: float  # [s]
    limits: Array  # (n, 2) [rad] where a run ends
    noise: tuple[float, ...] = ()  # standard deviation of tau_meas [N.m]
    checkpoints: Path | None = None  # finished rows of a resumed study
    progress: Stages = silent

    def setting(self, law_name: str, scheme: Scheme) -> Setting:
        """Return the loop of a law in a scheme."""
        fmus = self.fmus
        if law_name == StandIn.ORACLE:
            fmus = replace(fmus, friction=self.oracle, body=self.true_body)
        elif law_name in self.friction:
            fmus = replace(fmus, friction=self.friction[law_name])
        if law_name == StandIn.BODY_ONLY:
            scheme = replace(scheme, friction_gain=0.0)
        return Setting(
            fmus=fmus, scheme=scheme, gains=self.tracking.gains, step=self.step, noise=self.noise
        )

    def rows(self) -> Iterator[LoopRow]:
        """Yield the rows of the tables: every law in every scheme, and no law."""
        outer_gain = self.tracking.Kx
        for Kx in (0.0, outer_gain):
            yield self.row(StandIn.VELOCITY_ONLY, Scheme(compensation="none", Kx=Kx))
        for compensation, Kx in product(_COMPENSATIONS, (0.0, outer_gain)):
            for law_name in (StandIn.BODY_ONLY, *self.friction, StandIn.ORACLE):
                yield self.row(law_name, Scheme(compensation=compensation, Kx=Kx))
        for law_name, compensation, source in product(
            self.tracking.sources, _COMPENSATIONS, _MEASURED_SOURCES
        ):
            yield self.row(law_name, Scheme(compensation=compensation, source=source))

    def row(self, law_name: str, scheme: Scheme) -> LoopRow:
        """Return one row."""
        return LoopRow(scheme=scheme, law=law_name, setting=self.setting(law_name, scheme))

    def track(
        self,
        rows: Iterable[LoopRow],
        motions: Sequence[LoopMotion],
        duration: float,
        stage: str,
        *,
        traced: bool = False,
        workers: int | None = None,
    ) -> list[Tracked]:
        """Run every row along every motion for `duration` [s]; return one result per row.

        A run ends early outside `limits`. `traced` keeps the first motion's positions.
        """
        rows = list(rows)
        limits = self.limits
        progress = partial(self.progress, stage)
        run_settings = ([asdict(motion) for motion in motions], duration, limits.tolist(), traced)
        files = []
        if self.checkpoints:
            files = [self.checkpoints / f"{key}.json" for key in _compute_keys(rows, run_settings)]
        tracked_by_row: dict[int, Tracked] = {}
        for i, file in enumerate(files):
            if file.is_file():
                finished_row = from_json(_FinishedRow, read_json(file), file, "a finished row")
                tracked_by_row[i] = replace(finished_row.tracked, trace=finished_row.trace)
        open_rows = [i for i in range(len(rows)) if i not in tracked_by_row]
        progress(len(tracked_by_row), len(rows))
        jobs = [partial(_track_row, rows[i], motions, duration, limits, traced) for i in open_rows]
        try:
            names = [f"{rows[i].law}, {rows[i].scheme}" for i in open_rows]
            with parallel.results_of(jobs, workers, names=names) as results:
                for i, tracked_row in zip(open_rows, results, strict=True):
                    tracked_by_row[i] = tracked_row
                    if files:
                        finished_row = _FinishedRow(tracked=tracked_row, trace=tracked_row.trace)
                        with written_whole(files[i]) as temporary:
                            temporary.write_text(to_text(finished_row), encoding="utf-8")
                    progress(len(tracked_by_row), len(rows))
        finally:
            POOL.clear()  # for runs in this process
        return [tracked_by_row[i] for i in range(len(rows))]


def build(
    folder: Path,
    robot: Robot,
    body: RigidBody,
    plant: Plant,
    *,
    true_model: FrictionModel,
    platforms: Sequence[str] = HOST,
) -> None:
    """Write the FMUs of a loop, without arm and laws, for the true friction `true_model`."""
    step_size = 1.0 / plant.sample_rate
    dynamics = partial(inverse_dynamics, robot, step=step_size)
    contents: dict[str, Callable[[], Content]] = {
        "Trajectory": partial(trajectory, robot.n, step=step_size),
        "Controller": partial(controller, robot.n, step=step_size),
        "Velocity": partial(velocity, robot.n, step=step_size),
        "InverseDynamics": partial(dynamics, body.parameters),
        "TrueInverseDynamics": partial(dynamics, robot.nominal_parameters),
    }
    jobs = [
        partial(export_bare, true_model, folder / f"{true_model.law}.fmu"),
        *(
            partial(_write_block, make, folder / f"{name}.fmu", platforms)
            for name, make in contents.items()
        ),
    ]
    with parallel.results_of(jobs) as written_files:
        list(written_files)


def _write_block(content: Callable[[], Content], path: Path, platforms: Sequence[str]) -> Path:
    return write_fmu(content(), path, platforms=platforms)


def assemble(
    folder: Path,
    robot: Robot,
    *,
    tracking: Tracking,
    friction: Mapping[str, Path],
    plant: Plant,
    checkpoints: Path | None = None,
    progress: Stages = silent,
) -> StudyLoop:
    """Return the loop of the FMUs that `build` has written, and of friction laws."""
    lower, upper, _ = robot.limits
    return StudyLoop(
        tracking=tracking,
        friction=friction,
        oracle=folder / "true_friction.fmu",
        fmus=Fmus(
            arm=folder / closed_loop.ARM,
            trajectory=folder / "Trajectory.fmu",
            body=folder / "InverseDynamics.fmu",
            friction=next(iter(friction.values())),
            controller=folder / "Controller.fmu",
            velocity=folder / "Velocity.fmu",
        ),
        true_body=folder / "TrueInverseDynamics.fmu",
        step=1.0 / plant.sample_rate,
        limits=np.column_stack([lower - _MARGIN, upper + _MARGIN]),
        noise=plant.noise.torque,
        checkpoints=checkpoints,
        progress=progress,
    )


def build_example(
    loop: StudyLoop,
    *,
    compensation: Compensation = "servo_inversion",
    duration: float | None = None,
) -> SystemSpec:
    """Return a loop of `duration` [s]: the last of the study's `sources` on its first motion."""
    tracking = loop.tracking
    law_name = (tracking.sources or tuple(loop.friction))[-1]
    scheme = Scheme(compensation=compensation, Kx=tracking.Kx)
    setting = loop.setting(law_name, scheme)
    motion = motions(tracking)[0]
    return closed_loop.build_system(
        replace(setting, arm={**setting.arm, "q0": motion.q0}),
        duration=duration or tracking.duration,
        limits=loop.limits,
        motion=motion.parameters,
    )


def run_tracking(loop: StudyLoop, *, quick: bool = False) -> tuple[list[Tracked], list[Tracked]]:
    """Run all rows on all motions, and selected ones on a long motion unless `quick`."""
    tracking = loop.tracking
    rows = loop.rows()
    if quick:  # only rows of the desired velocity without outer loop
        rows = (row for row in rows if row.scheme.source == "desired" and not row.scheme.Kx)
    tracked = loop.track(rows, motions(tracking), tracking.duration, "tracking", traced=True)
    if quick:
        return tracked, []
    long_motions = motions(tracking, int(np.ceil(tracking.drift / tracking.duration)))[:1]
    return tracked, loop.track(
        _choose_long_rows(loop), long_motions, tracking.drift, "tracking for long"
    )


def _choose_long_rows(loop: StudyLoop) -> Iterator[LoopRow]:
    law_names: Sequence[str] = (*loop.tracking.sources, StandIn.ORACLE)
    yield loop.row(StandIn.VELOCITY_ONLY, Scheme(compensation="none"))
    for law_name in (StandIn.BODY_ONLY, *law_names):
        yield loop.row(law_name, Scheme(compensation="torque_error"))
    for law_name in law_names:
        yield loop.row(law_name, Scheme(compensation="servo_inversion"))
        yield loop.row(law_name, Scheme(compensation="servo_inversion", Kx=loop.tracking.Kx))
