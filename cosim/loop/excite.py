"""Runs of the digital twin along motions, and their logs."""

import hashlib
import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cosim.loop.motions import Motions, MotionSpec, names_of, require_within
from cosim.loop.twin import ArmRun, TwinArm, loaded_arm
from fmu_src.arm.plant import Plant
from hesr_model.errors import ConfigError
from hesr_model.logs.noise import words
from hesr_model.logs.robot_log import Log
from hesr_model.logs.tables import write_table
from hesr_model.motions.trajectories import Trajectory
from hesr_model.support.arrays import Array
from hesr_model.support.files import written_whole

_log = logging.getLogger(__name__)

_MOST_SAMPLES = 10**8  # per log


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """Log and truth of one motion of the twin."""

    log: Log  # noisy; the velocity is a central difference over two samples
    truth: ArmRun  # truth at the times of the log
    desired: Array  # position (N, n) [rad]


def excite(
    motions: Motions,
    plant: Plant,
    folder: Path,
    *,
    seed: int | None = None,
    fmu: Path | None = None,
) -> dict[str, Path]:
    """Run the arm along every motion; return the CSV files of the logs by name.

    The true friction is written next to each log. Noise seed and FMU default to those of `plant`.
    """
    paths = {}
    for recording in recordings(motions, plant, seed=seed, fmu=fmu):
        path = folder / f"{recording.log.name}.csv"
        recording.log.write(path)
        columns = {"t": recording.log.t}
        columns |= {f"tau_f{k}": f for k, f in enumerate(recording.truth.tau_f_true.T, start=1)}
        with written_whole(truth_of(path)) as temporary:
            write_table(temporary, columns)
        paths[recording.log.name] = path
        worst = np.abs(recording.truth.q - recording.desired).max() * 1e3
        _log.info("%s: %d samples, at most %.0f mrad off", path, len(recording.log.t), worst)
    return paths


def recordings(
    motions: Motions, plant: Plant, *, seed: int | None = None, fmu: Path | None = None
) -> Iterator[Recording]:
    """Run the arm along every motion; see `excite`."""
    noise_seed = plant.noise.seed if seed is None else seed
    with loaded_arm(plant, fmu=fmu) as arm:
        for motion in motions.motions:
            yield from recorded(arm, motion, noise_seed)


def recorded(arm: TwinArm, motion: MotionSpec, seed: int) -> Iterator[Recording]:
    """Run the arm along a motion, and along its time-reversed counterpart if wanted."""
    forward = motion.trajectory()
    both = (forward, forward.time_reversed())
    for name, trajectory in zip(names_of(motion), both, strict=False):
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
    if not trajectory.duration * rate <= _MOST_SAMPLES:
        raise ConfigError(
            f"motion '{name}': lasts {trajectory.duration:g} s, which at {rate:g} Hz are "
            f"{trajectory.duration * rate:.3g} samples; at most {_MOST_SAMPLES:g} can be logged."
        )
    first, count = (round(t * rate) for t in (unlogged[0], trajectory.duration - unlogged[1]))
    if count - first < 2:
        raise ConfigError(
            f"motion '{name}': {sum(unlogged):g} of {trajectory.duration:g} s are not logged; at "
            f"least two samples at {rate:g} Hz must remain."
        )
    desired = trajectory.sample(np.arange(count + 1) / rate)[0]
    joints = arm.plant.joints
    if desired.shape[1] != len(joints):
        raise ConfigError(
            f"motion '{name}': is for {desired.shape[1]} joints; the arm has {len(joints)}."
        )
    require_within(arm.limits, desired, joints, f"motion '{name}':")
    commands = np.diff(desired, axis=0) * rate
    truth = arm.run(desired[0], commands, seed=_seed_of_log(seed, name), unlogged=first)
    log = Log(
        name=name,
        t=np.arange(count - first) / rate,
        q=truth.q_noisy,
        dq=np.gradient(truth.q_noisy, 1 / rate, axis=0),
        tau=truth.tau_noisy,
        dq_cmd=commands[first:count],
    )
    return Recording(log=log, truth=truth, desired=desired[first:count])


def truth_of(log: Path) -> Path:
    """Return the file of the true friction of a log: t, tau_f1.."""
    return log.parent / "truth" / log.name


def _seed_of_log(seed: int, name: str) -> int:
    stream = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")
    return int(words(seed, stream, 0))
