"""Arm of the digital twin: plant, signals, and runs of its FMU."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from cosim.loop.closed_loop import ARM
from cosim.study.study import Twin
from fmu_src.arm.native import export_mjcf
from fmu_src.arm.plant import Plant, joint_limits, servo_signals
from fmu_src.arm.table import ArmSignals, SignalTable
from fmu_src.arm.truth import write_truth
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import through
from fmu_src.run.variables import Value
from hesr_model.errors import ConfigError
from hesr_model.support.arrays import Array
from hesr_model.support.files import scratch_folder

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
        known = ", ".join(plant.truths) or "none"
        raise ConfigError(
            f"{study}: truth '{twin.truth}' is unknown; those of {twin.plant} are: {known}."
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

    def __init__(self, component: FmuInstance, plant: Plant) -> None:
        self.plant = plant
        self.limits = joint_limits(plant)  # (n, 2) [rad]
        self._component = component

    def run(self, q0: ArrayLike, commands: Array, *, seed: int, unlogged: int = 0) -> ArmRun:
        """Start at rest at `q0` (n,) [rad], hold each command (N, n) [rad/s] for a sample, and log.

        Returns the arm at the start of each command, without the first `unlogged` ones. The servo's
        integral holds gravity and ripple at `q0`.
        """
        fmu, noise = self._component, self.plant.noise
        if fmu.used:
            fmu.reset()
        start: dict[str, Value] = {
            "q0": tuple(np.asarray(q0, dtype=float).tolist()),
            "q_noise": noise.encoder,
            "tau_meas_noise": noise.torque,
            "noise_seed": (seed & 0xFFFFFFFF, seed >> 32),
        }
        fmu.initialise(start=fmu.variables.expanded(start))
        joints = range(1, len(self.plant.joints) + 1)
        inputs = fmu.buffer([f"dq_cmd[{i}]" for i in joints])
        outputs = fmu.buffer([f"{name}[{i}]" for name in _OUTPUTS.values() for i in joints])
        step = 1.0 / self.plant.sample_rate
        times = step * np.arange(len(commands) - 1, dtype=float)
        first = outputs.read().copy()
        rows = through(fmu, inputs, outputs, times, np.full(len(times), step), commands[:-1])
        values = np.vstack([first, rows])[unlogged:].reshape(-1, len(_OUTPUTS), len(joints))
        return ArmRun(**{name: values[:, k] for k, name in enumerate(_OUTPUTS)})


@contextmanager
def loaded_arm(
    plant: Plant, *, fmu: Path | None = None, signals: ArmSignals | None = None
) -> Iterator[TwinArm]:
    """Load the FMU of the arm, exported with `signals` by default."""
    with ExitStack() as cleanup:
        if fmu is None:
            fmu = export_twin(plant, cleanup.enter_context(scratch_folder()), signals)
        yield TwinArm(cleanup.enter_context(FmuInstance(fmu, name="arm")), plant)
