"""Thresholds and messages of the checks of velocity against position."""

from dataclasses import replace

import numpy as np
import pytest
from limits_found import TWO, as_part, edge, said, two_joints
from pytest_regressions.data_regression import DataRegressionFixture
from unchanged import Unchanged

from hesr_model.health.examine import of_log
from hesr_model.health.velocity import _lag, check_velocity, match
from hesr_model.robots.robot import RobotDescription

ROWS = 1200


def wave(
    rate: float = 3.0, late: float = 0.0, rows: int = ROWS, period: float = 0.01
) -> np.ndarray:
    """Velocity of two joints with several harmonics each."""
    t = period * np.arange(rows) - late
    a = np.sin(rate * t) + 0.5 * np.sin(2.3 * rate * t + 1.0)
    b = np.cos(1.3 * rate * t) - 0.4 * np.sin(2.9 * rate * t + 2.0)
    return np.column_stack([a, b])


V = wave()


def robot(**log: object) -> RobotDescription:
    data = TWO.model_dump()
    gears = log.pop("gear_ratio", None)
    data["log"] |= {"units": data["log"]["units"] | log}
    return RobotDescription.model_validate(data | {"gear_ratio": gears})


def told(
    dq: np.ndarray,
    check: str = "",
    *,
    v: np.ndarray = V,
    own: RobotDescription = TWO,
    without: tuple[str, ...] = (),
    travel: float = 1.0,
    period: float = 0.01,
) -> list[str]:
    log = two_joints(len(v), period)
    part = replace(as_part(log, v=v, dq=dq), q=travel * log.q)
    return said(of_log(part.log, check_velocity(part, own, without)), check)


def noisy(size: float, scale: float = 1.0) -> np.ndarray:
    return np.asarray(scale * V + size * np.random.default_rng(3).normal(size=V.shape))


def sized(noise: float, scale: float) -> np.ndarray:
    """Noise added to a velocity, keeping the given overall size."""
    dq = noisy(noise)
    return np.asarray(scale * dq / dq.std(axis=0) * V.std(axis=0))


@pytest.mark.ci
def test_velocities_of_a_wrong_scale(
    unchanged: Unchanged, data_regression: DataRegressionFixture
) -> None:
    def warned(scale: float) -> bool:
        return any("warning" in x for x in told(scale * V, "velocity-scale"))

    def says(words: str, scale: float, **more: object) -> bool:
        dq = V * more.pop("by", 1.0) * scale
        return any(words in x for x in told(dq, "velocity-scale", **more))

    one = np.array([1.0, 0.0]) + 1e-9
    geared, turns = robot(gear_ratio=(7.0, 11.0)), robot(q="deg", dq="rev/s")
    unchanged(
        {
            "odd, less": edge(lambda x: told(x * V), 0.9, 1.0),
            "odd, more": edge(lambda x: told(x * V), 1.0, 1.09),
            "wrong, less": edge(warned, 0.8, 0.95),
            "wrong, more": edge(warned, 1.05, 1.2),
            "sure": edge(lambda x: told(sized(x, 1.05), "velocity-scale"), 0.0, 0.36),
            "sure of less": edge(lambda x: told(sized(x, 0.95), "velocity-scale"), 0.0, 0.36),
            "rpm": edge(lambda x: says("rpm", x), 7.0, 30 / np.pi),
            "rpm at most": edge(lambda x: says("rpm", x), 30 / np.pi, 12.0),
            "motor": edge(
                lambda x: says("dq belongs to the motor", x, own=geared, by=[1.0, 2.0]), 6.0, 7.0
            ),
            "motor at most": edge(
                lambda x: says("dq belongs to the motor", x, own=geared, by=[1.0, 2.0]), 7.0, 8.0
            ),
            "q of motor": edge(
                lambda x: says(" q belongs to the motor", x, own=geared), 1 / 8, 1 / 7
            ),
            "q of motor at most": edge(
                lambda x: says(" q belongs to the motor", x, own=geared), 1 / 7, 0.2
            ),
            "ms": edge(lambda x: says("time is in ms", x), 9e2, 1e3),
            "ms at most": edge(lambda x: says("time is in ms", x), 1e3, 1.2e3),
            "alike": edge(lambda x: says("all joints agree", 2.0, by=[1.0, x]), 0.8, 1.0),
            "alike at most": edge(lambda x: says("all joints agree", 2.0, by=[1.0, x]), 1.0, 1.2),
            "far": edge(lambda x: says("| q is in", 360.0, travel=x, own=turns), 1.0, 12.0),
        },
        rtol=1e-4,
    )
    degrees, rpm = np.pi / 180, 30 / np.pi
    data_regression.check(
        {
            "faster": told(0.5 * V),
            "slower": told(1.07 * V),
            "rpm": told(rpm * V),
            "rpm of one": told(V * [1.0, rpm]),
            "rpm of one, listed": told(V * [rpm, 1.0], own=robot(dq=("rad/s", "rpm"))),
            "degrees of q": told(degrees * V, travel=60.0),
            "degrees of q, not far": told(degrees * V),
            "degrees per second": told(V / degrees),
            "degrees where degrees were said": told(V / degrees, own=robot(dq="deg/s", q="deg")),
            "q of one joint": told(V * [1.0, degrees], travel=60.0),
            "both of other units": told(V * [degrees, rpm], travel=60.0),
            "backwards": told(rpm * V, own=robot(dq="-rad/s")),
            "a number": told(rpm * V, own=robot(dq=2.0)),
            "motor": told(V * [7.0, 11.0], own=geared),
            "motor of one": told(V * [1.0, 11.0], own=geared),
            "motor, joint's motion": told(V / [7.0, 11.0], own=geared),
            "stamps": told(2.0 * V),
            "stamps in ms": told(1e3 * V),
            "stamps in ms of s": told(V / 1e3, own=robot(t="ms")),
            "stamps of another unit": told(3.0 * V, own=robot(t="ms")),
            "stamps of a factor": told(3.0 * V, own=robot(t=0.5)),
            "nothing known": told(V * [3.0, 1.0]),
            "one joint alone": told(rpm * V, without=("b",)),
            "one joint of no unit": told(3.0 * V, without=("b",)),
            "none": told(V),
            "without both": told(3.0 * V, without=("a", "b")),
            "of one": told(one * V),
        }
    )


def test_velocities_of_another_signal(
    unchanged: Unchanged, data_regression: DataRegressionFixture
) -> None:
    def late(rows: int, period: float) -> list[str]:
        v = wave(rate=2.0, period=period)
        dq = wave(rate=2.0, late=rows * period, period=period)
        return told(dq, "velocity-lag", v=v, period=period)

    def mixed(share: float) -> np.ndarray:
        """The second joint's velocity contains part of the first one's."""
        return np.column_stack([V[:, 0], share * V[:, 0] + (1.0 - share) * V[:, 1]])

    def also_late(rows: int) -> bool:
        """Noise hides most of the signal, but not its lag."""
        v = wave(rate=5.0, period=1 / 256)
        noise = np.random.default_rng(4).normal(size=v.shape)
        dq = wave(rate=5.0, late=rows / 256, period=1 / 256) + noise
        return any("ms late" in x for x in told(dq, "velocity-match", v=v, period=1 / 256))

    unchanged(
        {
            "unlike": edge(lambda x: told(noisy(x), "velocity-match"), 0.1, 2.0),
            "mixed": edge(lambda x: told(mixed(x), "velocity-match"), 0.0, 0.6),
            "columns": edge(lambda x: told(noisy(x)[:, ::-1], "velocity-columns"), 0.1, 2.0),
            "late at 256 Hz": [n for n in range(-8, 9) if late(n, 1 / 256)],
            "late at 64 Hz": [n for n in range(-5, 6) if late(n, 1 / 64)],
            "also late": [n for n in range(-8, 9) if also_late(n)],
        },
        rtol=1e-4,
    )
    rng = np.random.default_rng(1)
    turned = robot(dq=("rad/s", "-rad/s"))
    data_regression.check(
        {
            "swapped": told(V[:, ::-1]),
            "another": told(rng.normal(size=V.shape)),
            "another, late": told(wave(rate=17.0, late=0.05), v=wave(rate=17.0)),
            "another, early": told(wave(rate=17.0, late=-0.05), v=wave(rate=17.0)),
            "late": told(wave(late=0.08)),
            "early": told(wave(late=-0.08)),
            "constant": told(1e-12 * V + 2.0),
            "constant, one": told(V * [1.0, 0.0]),
            "almost constant": told(1e-10 * V),
            "backwards": told(-V),
            "one backwards, one another": told(np.column_stack([-V[:, 0], V[:, 0]])),
            "one backwards": told(V * [1.0, -1.0]),
            "one backwards, as said": told(V * [1.0, -1.0], own=turned),
            "both backwards, one said": told(-V, own=turned),
            "backwards and of another scale": told(-2.0 * V, own=robot(dq=3.0)),
            "one backwards of numbers": told(V * [1.0, -1.0], own=robot(dq=(1.0, 2.0))),
            "weakly backwards": told(-noisy(0.3) * [0.0, 1.0] + V * [1.0, 0.0]),
            "a log without": said(check_velocity(as_part(two_joints(), dq=None), TWO)),
        }
    )


def test_velocity_matches(unchanged: Unchanged) -> None:
    v = V[:, 0]
    noise = np.random.default_rng(5).normal(size=len(v))
    unchanged(
        {
            "alike": match(v, v, 0.01),
            "noisy": match(v, 1.3 * v + 0.2 * noise, 0.01),
            "backwards": match(v, -0.7 * v + 0.2 * noise, 0.01),
            "offset": match(v + 1.0, 0.7 * v + 0.2 * noise - 2.0, 0.01),
            "tiny": match(1e-11 * v, 3e-11 * v, 0.01),
            "least": match(2e-12 * v, 2e-12 * v, 0.01),
            "less": match(5e-13 * v, v, 0.01),
            "lags": [
                _lag(v, wave(late=x)[:, 0], 0.01)
                for x in (-0.4, -0.29, -0.05, 0.0, 0.1, 0.29, 0.33)
            ],
            "short": [_lag(v[:n], wave(late=0.02)[:n, 0], 0.01) for n in (3, 4, 8, 12, 40, 80)],
            "slow": [_lag(v, v, period) for period in (0.1, 0.2, 0.3, 0.5)],
            "slow and late": [_lag(v[1:], v[:-1], period) for period in (0.1, 0.29, 0.31)],
            "resting": [_lag(0.0 * v, v, 0.01), _lag(v, 0.0 * v, 0.01)],
        },
        rtol=1e-5,
    )
