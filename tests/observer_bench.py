"""Bench of the observer: the digital twin in free motion, and pushed at its joints.

Torques of three further actuators push the joints of the arm; measured torques do not contain them.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from cosim.loop.closed_loop import ARM
from cosim.loop.excite import record_motions, twin_plant
from cosim.loop.motions import Motions
from cosim.study.study import Twin
from fmu_src.arm.native import export_mjcf
from fmu_src.arm.plant import Plant
from fmu_src.arm.table import InputTable, SignalTable
from fmu_src.plant.plant_fmu import PlantBody
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import step_rows
from hesr_model.fitting.fit import fit
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.motions.trajectories import random_fourier
from hesr_model.rigid_body.identification import RigidBody, identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array

MODELS = Path(__file__).parents[1] / "models"
TRUTHS = (None, "strain_wave", "rate_and_state")
STEP = 0.005  # [s]
PERIOD, REST = 24.0, 6.0  # of each motion, and the rest after it [s]


@dataclass(frozen=True)
class Bench:
    """An arm that can be pushed, with the robot's model, its identified body and a fitted law."""

    fmu: Path
    robot: Robot
    body: RigidBody
    law: FrictionModel
    logs: Mapping[str, Log]  # of the identification and the fit

    @property
    def plant(self) -> PlantBody:
        return PlantBody.from_robot(self.robot, self.body)


def pushed_arm(folder: Path, truth: str | None) -> tuple[Plant, Path]:
    """Write the FMU of an arm whose joints can be pushed."""
    uf850 = MODELS / "uf850"
    twin = Twin(
        plant=uf850 / "plant.toml",
        signals=uf850 / "arm.toml",
        motions=MODELS / "studies" / "uf850_motions.toml",
        truth=truth,
    )
    plant, signals = twin_plant(twin, uf850 / "study.toml", folder)
    assert isinstance(signals, SignalTable)
    tree = ElementTree.parse(plant.model)
    names = {joint.get("name") for joint in tree.getroot().iterfind(".//joint")}
    pushes = []
    for joint in plant.joints:
        link = f"{joint}_link" if f"{joint}_link" in names else joint
        push = {"name": f"{joint}_push", "joint": link}
        ElementTree.SubElement(tree.getroot().find("actuator"), "motor", push)
        read = {"name": f"{joint}_push", "actuator": f"{joint}_push"}
        ElementTree.SubElement(tree.getroot().find("sensor"), "actuatorfrc", read)
        pushes.append((f"{joint}_push",))
    model = folder / "pushed.xml"
    tree.write(model)
    outputs = dict(signals.outputs)
    for name in ("tau_meas", "tau_true"):
        rows = tuple(
            {**row, push: -1.0} for row, [push] in zip(outputs[name].sensors, pushes, strict=True)
        )
        outputs[name] = outputs[name].model_copy(update={"sensors": rows})
    pushed = InputTable(unit="N.m", actuators=tuple(pushes))
    signals = signals.model_copy(
        update={"outputs": outputs, "inputs": {**signals.inputs, "push": pushed}}
    )
    return plant.model_copy(update={"model": model}), export_mjcf(
        model, folder / ARM, table=signals
    )


def bench(folder: Path, truth: str | None, law: str) -> Bench:
    """Identify and fit on the motions of the default study."""
    folder.mkdir(parents=True, exist_ok=True)
    plant, fmu = pushed_arm(folder, truth)
    motions = Motions.read(MODELS / "studies" / "uf850_motions.toml")
    wanted = tuple(m for m in motions.motions if m.name in ("excitation", "sweep"))
    logs = {
        one.log.name: one.log
        for one in record_motions(motions.model_copy(update={"motions": wanted}), plant, fmu=fmu)
    }
    robot = Robot(MODELS / "uf850" / "robot.toml")
    body = identify([logs["excitation"]], robot, reversed_logs=[logs["excitation_reversed"]])
    records = [friction_records(logs["sweep"], robot, body)]
    return Bench(fmu, robot, body, fit(law, *records, robot=robot.name), logs)


def motion(seed: int) -> Array:
    """Return the commands (N, 3) [rad/s] of a random motion and a rest."""
    peak = np.random.default_rng(seed).uniform(0.3, 1.0) * np.array([1.2, 1.0, 1.2])
    path = random_fourier(
        seed=seed, harmonics=6, period=PERIOD, peak_velocity=peak, offset=np.array([0.0, 0.3, -1.9])
    )
    desired = path.sample(STEP * np.arange(round(PERIOD / STEP) + 1))[0]
    rest = np.repeat(desired[-1:], round(REST / STEP), axis=0)
    return np.vstack([desired, rest])


@contextmanager
def arm(own: Bench) -> Iterator[FmuInstance]:
    """Yield the arm."""
    with FmuInstance(own.fmu, name="arm") as fmu:
        yield fmu


def moved(
    fmu: FmuInstance,
    seed: int,
    push: Array | None = None,
    *,
    payload: float = 0.0,
    noise: float = 1.0,
) -> tuple[Log, Array]:
    """Run the arm along a motion under `push` (N, 3) [N.m]; return its log, and the true speeds.

    With a `payload` [kg], and `noise` of torques relative to the usual one.
    """
    desired = motion(seed)
    commands = np.diff(desired, axis=0) / STEP
    push = np.zeros_like(commands) if push is None else push
    if fmu.used:
        fmu.reset()
    torque_noise = tuple(noise * x for x in (1.5, 1.5, 0.6))
    start = {"q0": tuple(desired[0]), "noise_seed": (seed, 0), "payload": payload}
    start |= {"tau_meas_noise": torque_noise}
    fmu.initialise(start=fmu.variables.expand_values(start))
    joints = (1, 2, 3)
    inputs = fmu.buffer([f"{name}[{i}]" for name in ("dq_cmd", "push") for i in joints])
    outputs = fmu.buffer([f"{n}[{i}]" for n in ("q", "tau_meas", "dq_true") for i in joints])
    first = outputs.read().copy()
    times = STEP * np.arange(len(commands))
    rows = step_rows(
        fmu, inputs, outputs, times, np.full(len(times), STEP), np.hstack([commands, push])
    )
    q, tau, dq = np.split(np.vstack([first, rows]), 3, axis=1)
    return Log(
        name=f"motion{seed}", t=np.append(times, times[-1] + STEP), q=q, dq=None, tau=tau
    ), dq


def within(own: Bench, seed: int) -> bool:
    """Whether a motion keeps within the limits of the joints."""
    low, high, _ = own.robot.limits
    desired = motion(seed)
    return bool(np.all((desired > low) & (desired < high)))


def seeds_within(own: Bench, first: int, count: int) -> list[int]:
    """Return the first `count` seeds from `first` whose motions keep within the limits."""
    found = (seed for seed in range(first, first + 20 * count) if within(own, seed))
    return [seed for seed, _ in zip(found, range(count), strict=False)]


@dataclass(frozen=True)
class Push:
    """A push of a joint from a row on [N.m], for `LENGTH`."""

    kind: str
    joint: int
    row: int
    size: float


LENGTH, LATE = 0.3, 0.02  # duration of a push, and the time in which it must be found [s]
EDGE = 0.002  # speed below which the arm rests [rad/s]


def pushes(rng: np.random.Generator, dq: Array, threshold: Array) -> list[Push]:
    """Draw pushes of twice the threshold in motion, at rest and at reversals, 1.5 s apart."""
    found, long = [], round(1.5 / STEP)
    turned = np.argwhere(np.sign(dq[1:]) != np.sign(dq[:-1]))
    moving = np.any(np.abs(dq) > 0.05, axis=1)
    resting = np.flatnonzero(np.abs(dq).max(axis=1) < EDGE)
    for at in range(200, len(dq) - long, long):
        rows = np.arange(at, at + long - 80)
        kind = ("motion", "rest", "reversal")[int(rng.integers(3))]
        j = int(rng.integers(3))
        reversals = turned[(turned[:, 0] >= rows[0]) & (turned[:, 0] <= rows[-1])]
        reversals = reversals[moving[reversals[:, 0]]]
        rest = np.intersect1d(rows, resting)
        if kind == "reversal" and len(reversals):
            row, j = (int(x) for x in reversals[int(rng.integers(len(reversals)))])
        elif kind == "rest" and len(rest):
            row = int(rng.choice(rest))
        elif kind == "motion":
            row = int(rng.choice(rows))
            kind = "motion" if abs(dq[row, j]) > 0.05 else "slow"
        else:
            continue
        size = float(rng.choice((-2.0, 2.0)) * threshold[row, j])
        found.append(Push(kind, j, row, size))
    return found


def pushed(events: list[Push], count: int) -> Array:
    """Return the pushing torques (count, 3) of events."""
    found = np.zeros((count, 3))
    for one in events:
        found[one.row : one.row + round(LENGTH / STEP), one.joint] = one.size
    return found
