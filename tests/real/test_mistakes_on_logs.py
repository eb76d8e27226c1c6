"""Typical mistakes in measured logs and logs of the twin: each is detected by name."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cosim.loop.excite import record_motions
from cosim.loop.motions import Motions
from fmu_src.arm.plant import Plant
from hesr_model.health.examine import examine
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

HERE = Path(__file__).parent
DATA = HERE.parents[1] / ".." / "shared" / "data"
Array = NDArray[np.float64]
Shared = Callable[[str, Callable[[Path], object]], Path]
Spoilt = tuple[Log, Robot]
Mistake = Callable[[Log, Robot], Spoilt]


@cache
def model_of(robot: Path) -> Robot:
    return Robot(RobotDescription.read(robot))


def measured(robot: str, log: str) -> Spoilt:
    path = DATA / log
    if not path.is_file():
        pytest.skip(f"the measured log is not next to the repository, at {path}")
    model = model_of(HERE / robot)
    return Log.read(path, model.description), model


def in_log(spoil: Callable[[Log], Log]) -> Mistake:
    return lambda log, model: (spoil(log), model)


def one(values: Array | None, joint: int, factor: float) -> Array:
    assert values is not None
    changed = values.copy()
    changed[:, joint] *= factor
    return changed


def swapped(values: Array | None) -> Array:
    """Swap the columns of the second and third joints."""
    assert values is not None
    order = list(range(values.shape[1]))
    order[1], order[2] = 2, 1
    return values[:, order]


def scaled(values: Array | None, factor: float) -> Array | None:
    return None if values is None else values * factor


def late(log: Log, by: float) -> Array:
    return np.column_stack([np.interp(log.t - by, log.t, column) for column in log.tau.T])


def mounted(log: Log, model: Robot, gravity: tuple[float, float, float]) -> Spoilt:
    return log, Robot(model.description.model_copy(update={"gravity": gravity}))


def weightless(log: Log, model: Robot) -> Spoilt:
    nothing = np.zeros_like(log.q)
    gravity = model.torque(model.nominal_parameters, log.q, nothing, nothing)
    return replace(log, tau=log.tau - gravity), model


def stuck(log: Log) -> Log:
    q, rows = log.q.copy(), slice(len(log.t) // 2, len(log.t) * 7 // 10)
    q[rows, 1] = q[rows.start, 1]
    return replace(log, q=q)


def held(log: Log) -> Log:
    rows = np.repeat(np.arange(0, len(log.t), 5), 5)[: len(log.t)]
    return replace(log, q=log.q[rows], dq=None, tau=log.tau[rows])


def uf850(name: str) -> Path:
    return models_folder() / "uf850" / name


TURN = 180.0 / np.pi
MISTAKES: dict[str, tuple[Mistake, str, tuple[int, ...]]] = {
    # The first eight of the project.
    "degrees": (
        in_log(lambda log: replace(log, q=log.q * TURN, dq=scaled(log.dq, TURN))), "limits", (1,)
    ),
    "one torque's sign": (
        in_log(lambda log: replace(log, tau=one(log.tau, 1, -1.0))), "torque-sign", (1,)
    ),
    "a hundredth": (
        in_log(lambda log: replace(log, tau=one(log.tau, 1, 0.01))), "torque-scale", (1,)
    ),
    "upside down": (lambda log, model: mounted(log, model, (0.0, 0.0, 9.81)), "gravity", ()),
    "torques swapped": (
        in_log(lambda log: replace(log, tau=swapped(log.tau))), "torque-columns", (1,)
    ),
    "velocities swapped": (
        in_log(lambda log: replace(log, dq=swapped(log.dq))), "velocity-columns", (1, 2)
    ),
    "rpm": (
        in_log(lambda log: replace(log, dq=scaled(log.dq, 30.0 / np.pi))), "velocity-scale", (0, 1)
    ),
    "another sample rate": (
        in_log(lambda log: replace(log, t=0.5 * log.t)), "velocity-scale", (0, 1)
    ),
    # Further mistakes.
    "another sample rate, without velocity": (
        in_log(lambda log: replace(log, t=0.5 * log.t, dq=None)), "time-scale", ()
    ),
    "late torques": (in_log(lambda log: replace(log, tau=late(log, 0.15))), "torque-lag", (1, 2)),
    "milliamperes": (
        in_log(lambda log: replace(log, tau=1e3 * log.tau / 12.0)), "torque-scale", (1, 2)
    ),
    "amperes": (in_log(lambda log: replace(log, tau=log.tau / 12.0)), "torque-scale", (1, 2)),
    "from tip to base": (
        in_log(lambda log: replace(
            log, q=log.q[:, ::-1], dq=None if log.dq is None else log.dq[:, ::-1],
            tau=log.tau[:, ::-1],
        )), "joint-order", (),
    ),
    "a joint counted backwards": (
        in_log(lambda log: replace(
            log, q=one(log.q, 1, -1.0), dq=None if log.dq is None else one(log.dq, 1, -1.0),
            tau=one(log.tau, 1, -1.0),
        )), "position-sign", (1,),
    ),
    "a stuck encoder": (in_log(stuck), "spikes", (1,)),
    "held samples": (in_log(held), "held-samples", ()),
    "rounded": (in_log(lambda log: replace(log, q=np.round(log.q, 2))), "coarse", (1,)),
    "gravity taken out": (weightless, "torque-scale", (1,)),
}  # fmt: skip
UR10E = "ur10e/id_fourier_30s_12harm.csv"
AT_ONCE = ("upside down", "torques swapped", "late torques", "milliamperes", "from tip to base",
           "another sample rate, without velocity", "gravity taken out")  # fmt: skip


def assert_told(what: str, log: Log, model: Robot) -> None:
    spoil, check, joints = MISTAKES[what]
    log, model = spoil(log, model)
    found = examine([log], model.description, model).findings
    names = {model.description.joints[j] for j in joints}
    told = {name for finding in found if finding.check == check for name in finding.joints}
    assert check in {finding.check for finding in found}, [f.sentence for f in found]
    assert names <= told, [f.sentence for f in found]


@pytest.mark.parametrize(
    "what", [w if w in AT_ONCE else pytest.param(w, marks=pytest.mark.soak) for w in MISTAKES]
)
def test_mistakes_are_detected_in_a_log_of_a_ur10e(what: str) -> None:
    assert_told(what, *measured("ur10e.toml", UR10E))


SILENT = {
    ("test_ptp_10_points", "from tip to base"),  # the consistent order is that of two joints
}


@pytest.mark.soak
@pytest.mark.parametrize("what", MISTAKES)
@pytest.mark.parametrize(
    "log",
    [
        "id_fourier_50s_12harm",
        "id_fourier_20s_5harm",
        "test_fourier_40s_12harm",
        "test_fourier_20s_7harm",
        "test_fourier_20s_8harm",
        "test_ptp_10_points",
    ],
)
def test_mistakes_are_detected_in_other_logs_of_a_ur10e(log: str, what: str) -> None:
    if (log, what) in SILENT:
        pytest.xfail("told by other words")
    assert_told(what, *measured("ur10e.toml", f"ur10e/{log}.csv"))


@pytest.fixture(scope="module")
def twin(shared: Shared) -> Path:
    """Logs of the motions of the default study."""

    def run(folder: Path) -> None:
        plant = Plant.read(uf850("plant.toml"))
        motions = Motions.read(models_folder() / "studies" / "uf850_motions.toml")
        for made in record_motions(motions, plant):
            made.log.write(folder / f"{made.log.name}.csv")

    return shared("twin_of_the_study", run)


@pytest.mark.parametrize("what", MISTAKES)
def test_mistakes_are_detected_in_a_log_of_the_twin(what: str, twin: Path) -> None:
    model = model_of(uf850("robot.toml"))
    assert_told(what, Log.read(twin / "excitation.csv", model.description), model)


def test_logs_of_the_twin_are_sound(twin: Path) -> None:
    model = model_of(uf850("robot.toml"))
    logs = [Log.read(log, model.description) for log in sorted(twin.glob("*.csv"))]
    assert len(logs) == 13
    for log in logs:
        assert examine([log], model.description, model).findings == ()
        bare = examine([replace(log, dq=None)], model.description, model)
        assert bare.findings == ()
    assert examine(logs, model.description, model).findings == ()


@pytest.mark.parametrize(
    ("robot", "log", "what", "check", "joint"),
    [
        ("tiago.toml", "tiago_arm/tiago_excitation.csv", "late torques", "torque-lag", 3),
        # Only its lift is near the speed limit of the model.
        ("tiago.toml", "tiago_arm/tiago_excitation.csv", "another sample rate", "speed-limit", 0),
        ("tx40.toml", "tx40/tx40_first.csv", "another sample rate", "speed-limit", 1),
        ("tx40.toml", "tx40/tx40_first.csv", "another sample rate", "time-scale", None),
        ("tx40.toml", "tx40/tx40_first.csv", "upside down", "gravity-sign", 1),
        ("panda.toml", "panda/panda_first.csv", "late torques", "torque-lag", 3),
    ],
)
def test_mistakes_are_detected_in_logs_of_other_robots(
    robot: str, log: str, what: str, check: str, joint: int | None
) -> None:
    spoilt, model = MISTAKES[what][0](*measured(robot, log))
    found = examine([spoilt], model.description, model).findings
    told = {name for finding in found if finding.check == check for name in finding.joints}
    assert check in {finding.check for finding in found}
    assert joint is None or model.description.joints[joint] in told
