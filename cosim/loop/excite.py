"""Digital twin: its arm, runs along motions, and their logs."""

import hashlib
import logging
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from cosim.loop.closed_loop import ARM
from cosim.loop.motions import Motions, MotionSpec, list_log_names, require_within
from cosim.study.study import Twin
from fmu_src.arm.native import export_mjcf
from fmu_src.arm.plant import Plant, joint_limits, servo_signals
from fmu_src.arm.table import ArmSignals, SignalTable, seed_halves
from fmu_src.arm.truth import write_truth
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import step_rows
from fmu_src.run.variables import Value
from hesr_model.errors import ConfigError
from hesr_model.logs.noise import words
from hesr_model.logs.robot_log import Log
from hesr_model.logs.tables import number_columns, write_table
from hesr_model.motions.trajectories import Trajectory
from hesr_model.support.arrays import Array
from hesr_model.support.files import scratch_folder, written_whole

# of the FMU, by the fields of `ArmRun`
_OUTPUTS = {
    "q": "q_true",
    "dq": "dq_true",
    "tau_meas": "tau_true",
    "tau_f_true": "tau_f_true",
    "q_noisy": "q",
    "tau_noisy": "tau_meas",
}


def twin_plant(twin: Twin, study: Path, folder: Path) -> tuple[Plant, SignalTable | None]:
    """Return plant and table of signals of a twin with the friction of its study.

    `study` is for messages; `folder` receives the MJCF of an alternative plant.
    """
    plant = Plant.read(twin.plant)
    signals = SignalTable.read(twin.signals) if twin.signals else None
    if twin.truth is None or signals is None:
        return plant, signals
    if twin.truth not in plant.truths:
        truth_names = ", ".join(plant.truths) or "none"
        raise ConfigError(
            f"{study}: truth '{twin.truth}' is unknown; those of {twin.plant} are: {truth_names}."
        )
    mjcf = folder / "arm.xml"
    signals = write_truth(plant.truths[twin.truth], plant.model, plant.joints, signals, mjcf)
    return plant.model_copy(update={"model": mjcf}), signals


def export_twin(
    plant: Plant, folder: Path, signals: SignalTable | ArmSignals | None = None
) -> Path:
    """Write the arm as an FMU in `folder`; signals are those of the servo by default."""
    folder.mkdir(parents=True, exist_ok=True)
    return export_mjcf(plant.model, folder / ARM, table=signals or servo_signals(plant))


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmRun:
    """Motion and torques of an arm, (N, n) at N instants."""

    q: Array  # true [rad]
    dq: Array  # true [rad/s]
    tau_meas: Array  # true servo torque [N.m]: rigid body plus friction
    tau_f_true: Array  # [N.m] positive if it opposes positive velocity
    q_noisy: Array  # measured [rad]
    tau_noisy: Array  # measured [N.m]


class TwinArm:
    """An arm under velocity command, run as an FMU with the signals of models/uf850/arm.toml."""

    def __init__(self, instance: FmuInstance, plant: Plant) -> None:
        self.plant = plant
        self.limits = joint_limits(plant)  # (n, 2) [rad]
        self._component = instance

    def run(self, q0: ArrayLike, commands: Array, *, seed: int, unlogged: int = 0) -> ArmRun:
        """Start at rest at `q0` (n,) [rad], hold each command (N, n) [rad/s] for a sample, and log.

        Returns the arm at the start of each command, without the first `unlogged` ones. The servo's
        integral holds gravity and ripple at `q0`.
        """
        instance = self._component
        noise = self.plant.noise
        if instance.used:
            instance.reset()
        start: dict[str, Value] = {
            "q0": tuple(np.asarray(q0, dtype=float).tolist()),
            "q_noise": noise.encoder,
            "tau_meas_noise": noise.torque,
            "noise_seed": seed_halves(seed),
        }
        instance.initialise(start=instance.variables.expand_values(start))
        numbers = range(1, len(self.plant.joints) + 1)
        inputs = instance.buffer([f"dq_cmd[{number}]" for number in numbers])
        output_names: list[str] = []
        for name in _OUTPUTS.values():
            output_names += [f"{name}[{number}]" for number in numbers]
        outputs = instance.buffer(output_names)
        period = 1.0 / self.plant.sample_rate
        times = period * np.arange(len(commands) - 1, dtype=float)
        first_outputs = outputs.read().copy()
        step_sizes = np.full(len(times), period)
        later_outputs = step_rows(instance, inputs, outputs, times, step_sizes, commands[:-1])
        rows = np.vstack([first_outputs, later_outputs])[unlogged:]
        values = rows.reshape(-1, len(_OUTPUTS), len(numbers))
        return ArmRun(**{name: values[:, k] for k, name in enumerate(_OUTPUTS)})


@contextmanager
def load_arm(
    plant: Plant, *, fmu: Path | None = None, signals: ArmSignals | None = None
) -> Iterator[TwinArm]:
    """Load the FMU of the arm, exported with `signals` by default."""
    with ExitStack() as cleanup:
        if fmu is None:
            fmu = export_twin(plant, cleanup.enter_context(scratch_folder()), signals)
        yield TwinArm(cleanup.enter_context(FmuInstance(fmu, name="arm")), plant)


_log = logging.getLogger(__name__)

_MAX_SAMPLES = 10**8  # per log


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """Log and truth of one motion of the twin."""

    log: Log  # noisy; the velocity is a central difference over two samples
    truth: ArmRun  # truth at the times of the log
    desired: Array  # position (N, n) [rad]


def excite(
    motions: Motions, plant: Plant, folder: Path, *, fmu: Path | None = None
) -> dict[str, Path]:
    """Run the arm along every motion; return the CSV files of the logs by name.

    The true friction is written next to each log. The FMU is by default that of `plant`.
    """
    paths = {}
    for recording in record_motions(motions, plant, fmu=fmu):
        paths[recording.log.name] = path = folder / f"{recording.log.name}.csv"
        recording.log.write(path)
        with written_whole(truth_path(path)) as temporary:
            write_table(
                temporary, {"t": recording.log.t} | number_columns(tau_f=recording.truth.tau_f_true)
            )
        largest_deviation = np.abs(recording.truth.q - recording.desired).max() * 1e3
        _log.info(
            "%s: %d samples, at most %.0f mrad off", path, len(recording.log.t), largest_deviation
        )
    return paths


def record_motions(
    motions: Motions, plant: Plant, *, fmu: Path | None = None
) -> Iterator[Recording]:
    """Run the arm along every motion; see `excite`."""
    with load_arm(plant, fmu=fmu) as arm:
        for motion in motions.motions:
            yield from record_directions(arm, motion, plant.noise.seed)


def record_directions(arm: TwinArm, motion: MotionSpec, seed: int) -> Iterator[Recording]:
    """Run the arm along a motion, and along its time-reversed counterpart if wanted."""
    forward = motion.trajectory()
    trajectories = (forward, forward.reverse_time())
    for name, trajectory in zip(list_log_names(motion), trajectories, strict=False):
        yield record(arm, trajectory, seed, name=name, unlogged=motion.unlogged)


def record(
    arm: TwinArm,
    trajectory: Trajectory,
    seed: int,
    *,
    name: str,
    unlogged: tuple[float, float] = (0.0, 0.0),
) -> Recording:
    """Run the arm along a motion from rest and log it, but for times at its start and end [s].

    The command is the mean desired velocity over each sample period, whose integral is the desired
    position without drift. The noise of a log depends on `seed` and `name` only.
    """
    rate = arm.plant.sample_rate
    if not trajectory.duration * rate <= _MAX_SAMPLES:
        raise ConfigError(
            f"motion '{name}': lasts {trajectory.duration:g} s, which at {rate:g} Hz are "
            f"{trajectory.duration * rate:.3g} samples; at most {_MAX_SAMPLES:g} can be logged."
        )
    first_row, end_row = (round(t * rate) for t in (unlogged[0], trajectory.duration - unlogged[1]))
    if end_row - first_row < 2:
        raise ConfigError(
            f"motion '{name}': {sum(unlogged):g} of {trajectory.duration:g} s are not logged; at "
            f"least two samples at {rate:g} Hz must remain."
        )
    desired = trajectory.sample(np.arange(end_row + 1) / rate)[0]
    joints = arm.plant.joints
    if desired.shape[1] != len(joints):
        raise ConfigError(
            f"motion '{name}': is for {desired.shape[1]} joints; the arm has {len(joints)}."
        )
    require_within(arm.limits, desired, joints, f"motion '{name}':")
    commands = np.diff(desired, axis=0) * rate
    stream = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")
    truth = arm.run(desired[0], commands, seed=int(words(seed, stream, 0)), unlogged=first_row)
    log = Log(
        name=name,
        t=np.arange(end_row - first_row) / rate,
        q=truth.q_noisy,
        dq=np.gradient(truth.q_noisy, 1 / rate, axis=0),
        tau=truth.tau_noisy,
        dq_cmd=commands[first_row:end_row],
    )
    return Recording(log=log, truth=truth, desired=desired[first_row:end_row])


def truth_path(log: Path) -> Path:
    """Return the file of the true friction of a log: t, tau_f1.."""
    return log.parent / "truth" / log.name
