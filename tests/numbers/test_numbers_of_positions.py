"""Thresholds and messages of the checks of stamps, positions and columns."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from limits_found import TWO, as_part, at, edge, said, two_joints
from pytest_regressions.data_regression import DataRegressionFixture
from unchanged import Unchanged

from hesr_model.health.examine import of_log
from hesr_model.health.positions import (
    check_columns,
    check_jumps,
    check_limits,
    check_steps,
    check_time,
    share_of_long_steps,
)
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription

MJCF = """
<mujoco model="lift"><compiler angle="radian"/><worldbody><body name="arm">
  <inertial pos="0 0 0.1" mass="2" diaginertia="0.02 0.03 0.02"/>
  <joint name="turn" axis="0 1 0" range="-2 2"/>
  <body name="tip"><inertial pos="0 0 0.1" mass="1" diaginertia="0.02 0.03 0.02"/>
    <joint name="lift" type="slide" axis="0 0 1" range="-0.5 1.5"/></body>
</body></worldbody></mujoco>
"""


@pytest.fixture
def lift(tmp_path: Path) -> Robot:
    """A revolute and a sliding joint."""
    path = tmp_path / "lift.xml"
    path.write_text(MJCF, encoding="utf-8")
    return Robot(RobotDescription(name="lift", model=path, joints=("turn", "lift")))


def in_unit(robot: RobotDescription, **units: object) -> RobotDescription:
    own = robot.log.units.model_copy(update=units)
    return robot.model_copy(update={"log": robot.log.model_copy(update={"units": own})})


def cut(*, breaks: tuple[int, ...], by: float = 0.5, rows: int = 1000) -> Log:
    """A log with gaps before some rows."""
    log = two_joints(rows)
    later = sum((np.arange(rows) >= row for row in breaks), np.zeros(rows))
    return replace(log, t=log.t + by * later)


def lossy(long: int, *, by: float = 2.0) -> Log:
    """A log with some of its 1000 steps longer."""
    log = two_joints(1001)
    steps = np.full(1000, 0.01)
    steps[np.arange(long) * 1000 // max(long, 1)] *= by
    return replace(log, t=np.concatenate([[0.0], np.cumsum(steps)]))


def test_stamps(unchanged: Unchanged, data_regression: DataRegressionFixture) -> None:
    def told(log: Log, check: str = "", unit: str | float = "s") -> list[str]:
        return said(of_log(log, check_time(log, in_unit(TWO, t=unit))), check)

    def every(period: float) -> Log:
        return two_joints(50, period)

    unchanged(
        {
            "fast": edge(lambda x: told(every(x), "time-unit"), 1e-5, 1e-3),
            "slow": edge(lambda x: told(every(x), "time-unit"), 0.1, 2.0),
            "longer": edge(lambda x: told(lossy(80, by=x), "missing-rows"), 1.1, 2.0),
            "losses": [n for n in range(44, 56) if told(lossy(n), "missing-rows")],
            "share": share_of_long_steps(lossy(80)),
            "share beside a gap": share_of_long_steps(cut(breaks=(500,))),
            "gap": edge(lambda x: told(cut(breaks=(500,), by=x), "gaps"), 0.01, 0.5),
        },
        rtol=1e-5,
    )
    data_regression.check(
        {
            **{
                f"{period:g} in {unit}": told(every(period), unit=unit)
                for period in (1e-9, 2e-7, 1e-5, 1.5, 120.0, 200.0, 900.0, 3e4, 5e6, 1e10)
                for unit in ("s", "ms")
            },
            "one gap": told(cut(breaks=(500,))),
            "two gaps": told(cut(breaks=(300, 700), by=0.7)),
            "three gaps": told(cut(breaks=(300, 500, 700), by=1.0)),
            "one part left": told(cut(breaks=(950,))),
            "losses": told(lossy(80)),
            "many losses": told(lossy(496)),
            "one dropped": told(replace(every(0.01), dropped=1)),
            "dropped": told(replace(every(0.01), dropped=7)),
            "none": told(every(0.01)),
        }
    )


def test_leaps(unchanged: Unchanged, data_regression: DataRegressionFixture) -> None:
    def told(log: Log, check: str = "") -> list[str]:
        return said(of_log(log, check_jumps(log, TWO)), check)

    def leaping(by: float, *, step: float = 0.01, row: int = 500) -> Log:
        """Shift all positions from a row on, after a step of the given length."""
        log = two_joints()
        later = np.arange(len(log.t)) >= row
        return replace(
            log,
            q=log.q + by * later[:, None] * [0.0, 1.0],
            t=log.t + (step - 0.01) * later,
        )

    def off(by: float, row: int = 500, scale: float = 1.0) -> Log:
        log = two_joints()
        return replace(log, q=at(scale * log.q, row, 0, scale * log.q[row, 0] + by))

    def fast(speed: float) -> Log:
        """A joint with frequent large steps and one jump by a turn."""
        log = two_joints()
        q = at(log.q, slice(None), 0, speed * (np.arange(1000) % 2))
        q[500:, 0] += 2.0 * np.pi
        return replace(log, q=q)

    turn = 2.0 * np.pi
    unchanged(
        {
            "least turn": edge(lambda x: told(leaping(x), "wrap"), 5.0, 6.2),
            "most turn": edge(lambda x: told(leaping(x), "wrap"), 6.4, 8.0),
            "backwards": edge(lambda x: told(leaping(x), "wrap"), -8.0, -6.4),
            "near": edge(lambda x: told(leaping(turn, step=x), "wrap"), 0.011, 0.09),
            "spike": edge(lambda x: told(off(x, scale=30.0)), 0.0, 1.0),
            "least spike": edge(lambda x: told(off(x, scale=1e-3)), 0.0, 0.1),
            "usual": edge(lambda x: told(fast(x), "wrap"), 0.1, 1.0),
        },
        rtol=1e-4,
    )
    resting = at(0.0 * two_joints().q, slice(500, None), 0, turn)
    data_regression.check(
        {
            "turn": told(leaping(turn)),
            "turn at once": told(leaping(turn, row=1)),
            "turn at last": told(leaping(turn, row=999)),
            "two turns": told(
                replace(leaping(turn), q=leaping(turn).q + leaping(-turn, row=700).q)
            ),
            "of a joint at rest": told(replace(two_joints(), q=resting)),
            "spike": told(off(0.7)),
            "spike below": told(off(-0.7)),
            "spike at the second row": told(off(0.7, row=1)),
            "spike at the end": told(off(0.7, row=998)),
            "spike at the last row": told(off(0.7, row=999)),
            "both": told(replace(off(0.7), q=off(0.7).q + leaping(turn).q)),
            "both, swapped": told(replace(off(0.7), q=(off(0.7).q + leaping(turn).q)[:, ::-1])),
            "across a gap": told(cut(breaks=(500,))),
            "of two rows": told(two_joints(2)),
            "of three rows": told(two_joints(3)),
            "none": told(two_joints()),
        }
    )


def test_coarse_positions(unchanged: Unchanged, data_regression: DataRegressionFixture) -> None:
    def told(q: np.ndarray) -> list[str]:
        log = two_joints()
        return said(of_log(log, check_steps(replace(log, q=np.column_stack([q, 0.0 * q])), TWO)))

    def stairs(step: float, count: int = 100) -> np.ndarray:
        return step * (np.arange(1000) % count)

    def uneven(share: float) -> np.ndarray:
        """A staircase with some steps twice as high."""
        steps = np.where(np.arange(999) < round(999 * share), 0.01, 0.02 + 1e-4 * np.arange(999))
        return np.concatenate([[0.0], np.cumsum(steps)])

    def wavy(by: float) -> np.ndarray:
        """A staircase whose steps vary by the given share."""
        return np.concatenate([[0.0], np.cumsum(0.01 * (1.0 + by * (np.arange(999) % 3 - 1)))])

    unchanged(
        {
            "step": edge(lambda x: told(stairs(x)), 1e-4, 1e-2),
            "few": [n for n in range(14, 26) if told(stairs(0.01, n))],
            "travel": [n for n in range(14, 26) if told(stairs(8.1e-4, n))],
            "alike": edge(lambda x: told(wavy(x)), 1e-4, 0.1),
            "uneven": edge(lambda x: told(uneven(x)), 0.1, 0.9, steps=12),
        },
        rtol=1e-4,
    )
    data_regression.check(
        {"stairs": told(stairs(0.01)), "low": told(stairs(0.00123)), "none": told(stairs(5e-4))}
    )


def test_positions_beyond_the_limits(
    lift: Robot, unchanged: Unchanged, data_regression: DataRegressionFixture
) -> None:
    def told(
        turn: tuple[float, float],
        slide: tuple[float, float],
        *,
        unit: object = "rad",
        words: str = "",
    ) -> list[str]:
        model = Robot(in_unit(lift.description, q=unit))
        q = np.linspace([turn[0], slide[0]], [turn[1], slide[1]], 100)
        log = two_joints(100)
        found = said(of_log(log, check_limits(as_part(replace(log, q=q)), model)))
        return [x for x in found if words in x]

    inside = (-0.4, 1.4)
    unchanged(
        {
            "above": edge(lambda x: told((-1.0, x), inside), 1.5, 2.5),
            "below": edge(lambda x: told((x, 1.0), inside), -2.5, -1.5),
            "slide": edge(lambda x: told((-1.0, 1.0), (0.0, x)), 1.0, 2.5),
            "wrong": edge(lambda x: told((-1.0, x), inside, words="error"), 2.0, 9.0),
            "degrees": edge(lambda x: told((-5.0, x), inside, words="in degrees"), 5.0, 40.0),
            "no degrees": edge(lambda x: told((-5.0, x), inside, words="in degrees"), 40.0, 400.0),
            "nor below": edge(lambda x: told((x, 20.0), inside, words="in degrees"), -400.0, -40.0),
        },
        rtol=1e-4,
    )
    data_regression.check(
        {
            "above": told((-1.0, 2.1), inside),
            "below": told((-2.2, 2.1), inside),
            "both sides alike": told((-2.5, 2.5), inside),
            "wrong": told((-3.0, 9.0), inside),
            "wrong below": told((-9.0, 3.0), inside),
            "degrees": told((-80.0, 90.0), inside),
            "degrees, listed": told((-80.0, 90.0), inside, unit=("rad", "m")),
            "degrees beside a slide": told((-80.0, 90.0), (-0.7, 9.0)),
            "slide": told((-1.0, 1.0), (-0.6, 1.2)),
            "slide far": told((-1.0, 1.0), (-40.0, 80.0)),
        }
    )


def test_columns(unchanged: Unchanged, data_regression: DataRegressionFixture) -> None:
    log = two_joints(2000)

    def told(check: str = "", **signals: np.ndarray | None) -> list[str]:
        own = replace(log, **signals)
        return said(of_log(own, check_columns(as_part(own, dq=own.dq), TWO)), check)

    def clipped(rows: int, run: int = 6) -> np.ndarray:
        """2000 rows with some at the largest torque, part of them in one run."""
        places = [*range(50, 50 + run), *(100 + 4 * np.arange(rows - run))]
        return at(log.tau, places, 0, 9.0)

    def levels(count: int) -> np.ndarray:
        tau = at(log.tau, slice(None), 0, (np.arange(2000) % count).astype(float))
        return at(tau, slice(100, 160), 0, float(count - 1))

    unchanged(
        {
            "rows": [n for n in range(14, 26) if told(tau=clipped(n))],
            "runs": [n for n in range(2, 9) if told(tau=clipped(40, n))],
            "negative": [n for n in range(2, 9) if told(tau=-clipped(40, n))],
            "levels": [n for n in range(196, 206) if told(tau=levels(n))],
        }
    )
    twice = {name: getattr(log, name)[:, [0, 0]] for name in ("q", "tau")}
    assert log.dq is not None
    data_regression.check(
        {
            "clipped": told(tau=clipped(40)),
            "constant": told(tau=at(log.tau, slice(None), 1, 2.5)),
            "constant zero": told(tau=0.0 * log.tau),
            "one torque": told(tau=twice["tau"]),
            "one position": told(q=twice["q"]),
            "one velocity": told(dq=log.dq[:, [1, 1]]),
            "no velocity": said(
                of_log(log, check_columns(as_part(replace(log, **twice), dq=None), TWO))
            ),
            "none": told(),
        }
    )
