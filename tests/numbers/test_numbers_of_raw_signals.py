"""Thresholds and messages of the checks for stuck, jumping and held raw signals."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from limits_found import TWO, as_part, at, edge, said, two_joints
from pytest_regressions.data_regression import DataRegressionFixture
from unchanged import Unchanged

from hesr_model.health.examine import of_log
from hesr_model.health.torque import _speeds, check_held, check_speed
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription


def told(log: Log, check: str = "") -> list[str]:
    return said(of_log(log, check_held(log, TWO)), check)


def spiked(height: float, *, beside: float = 0.0, rows: int = 1000, row: int = 500) -> Log:
    log = two_joints(rows)
    return replace(log, tau=at(log.tau, [row - 1, row, row + 1], 0, [0.0, height, beside]))


def still(
    rows: int, *, of: int = 1000, period: float = 0.01, quantity: str = "q", begin: int = 300
) -> Log:
    """A log whose first joint repeats one signal value the given number of times."""
    log = two_joints(of, period)
    values = at(getattr(log, quantity), slice(begin, begin + rows + 1), 0, 0.123456)
    return replace(log, **{quantity: values})


def test_spikes_of_torque(unchanged: Unchanged, data_regression: DataRegressionFixture) -> None:
    unchanged(
        {
            "height": edge(lambda x: told(spiked(x)), 3.0, 60.0),
            "downwards": edge(lambda x: told(spiked(x)), -60.0, -3.0),
            "beside": edge(lambda x: told(spiked(30.0, beside=x)), 0.0, 20.0),
        },
        rtol=1e-4,
    )
    log = two_joints()
    data_regression.check(
        {
            "one": told(spiked(60.0)),
            "negative": told(spiked(-60.0)),
            "second row": told(spiked(60.0, row=1)),
            "last but one": told(spiked(60.0, row=998)),
            "weak": told(replace(spiked(60.0), tau=1e-4 * spiked(60.0).tau)),
            "of nothing": told(replace(log, tau=at(0.0 * log.tau, 500, 0, 9.0))),
        }
    )


def test_stuck_signals(unchanged: Unchanged, data_regression: DataRegressionFixture) -> None:
    moving = two_joints()

    def slow(speed: float) -> Log:
        """The position is constant while the velocity is not zero."""
        log = still(60)
        return replace(log, dq=np.full_like(log.q, speed))

    def creeping(speed: float) -> Log:
        """The torque is constant while the position moves."""
        log = still(60, quantity="tau")
        return replace(log, q=speed * log.t[:, None] * [1.0, 1.0])

    def partly(rows: int) -> Log:
        log = still(40)
        return replace(log, dq=at(0.0 * log.q, slice(300, 300 + rows), 0, 1.0))

    def among(rows: int, others: int) -> Log:
        """Further runs of 1, 2, .. repeats."""
        log = still(rows)
        q, row = log.q.copy(), 500
        for k in range(1, others + 1):
            q[row : row + k + 1, 0] = k
            row += k + 3
        return replace(log, q=q)

    unchanged(
        {
            "seconds": edge(lambda x: told(still(20, period=x), "stuck"), 0.01, 0.03),
            "position": [n for n in range(10, 20) if told(still(n, period=0.05), "stuck")],
            "torque": [
                n for n in range(10, 20) if told(still(n, period=0.05, quantity="tau"), "stuck")
            ],
            "fast": edge(lambda x: told(slow(x), "stuck"), 0.01, 0.2),
            "fast backwards": edge(lambda x: told(slow(x), "stuck"), -0.2, -0.01),
            "moves": edge(lambda x: told(creeping(x), "stuck"), 0.01, 0.2),
            "share": [n for n in range(5, 20) if told(partly(n), "stuck")],
            "among": [
                min(n for n in range(20, 150) if told(among(n, k), "stuck")) for k in (2, 4, 8)
            ],
        },
        rtol=1e-5,
    )
    largest = replace(moving, tau=at(moving.tau, slice(300, 361), 0, 9.0))
    data_regression.check(
        {
            "position": told(still(60)),
            "torque": told(still(60, quantity="tau")),
            "at the first row": told(still(60, begin=0)),
            "at the last row": told(still(60, begin=939)),
            "without velocity": told(replace(still(60), dq=None)),
            "the largest torque": told(largest),
            "almost": told(replace(largest, tau=at(largest.tau, 700, 0, -9.1))),
            "none": told(moving),
            "29 rows": told(still(20, of=29, begin=4, period=0.05)),
            "30 rows": told(still(20, of=30, begin=4, period=0.05)),
        }
    )


def test_held_torques(unchanged: Unchanged, data_regression: DataRegressionFixture) -> None:
    log = two_joints(1001)

    def repeated(rows: int) -> Log:
        """Every third row repeats the previous one, up to some row."""
        places = 3 * np.arange(rows) + 1
        tau = log.tau.copy()
        tau[places] = tau[places - 1]
        return replace(log, tau=tau)

    def levels(count: int) -> Log:
        """Pairs of equal rows, with the given number of levels in the second joint."""
        tau = np.repeat(np.arange(501) % count, 2)[: len(log.t)]
        return replace(log, tau=np.column_stack([0.0 * tau, tau.astype(float)]))

    def briefly(rows: int) -> Log:
        """The joint moves in the given number of rows; torques repeat throughout."""
        q = np.minimum(log.t, 0.01 * rows)[:, None] * [0.0, 1.0]
        return replace(repeated(333), q=q, dq=None, tau=np.repeat(log.tau[::2], 2, axis=0)[:1001])

    unchanged(
        {
            "rows": [n for n in range(290, 310) if told(repeated(n), "held-samples")],
            "levels": [n for n in range(196, 206) if told(levels(n), "held-samples")],
            "briefly": [n for n in range(2, 20) if told(briefly(n), "held-samples")],
        }
    )
    resting = replace(repeated(333), q=at(0.0 * log.q, slice(None), 1, 0.06 * log.t), dq=None)
    data_regression.check(
        {
            "a third": told(repeated(333)),
            "one joint moves": told(resting),
            "one joint repeats": told(replace(log, tau=at(log.tau, slice(None), 0, 1.0))),
            "none is fine": told(replace(log, tau=np.round(log.tau))),
        }
    )


@pytest.mark.parametrize(
    ("period", "around"), [(0.005, 10), (0.01, 5), (0.03, 2), (0.05, 1), (0.2, 1)]
)
def test_speeds_are_differences_over_a_tenth_of_a_second(period: float, around: int) -> None:
    log = two_joints(60, period)
    found = _speeds(replace(log, q=np.column_stack([log.t**3, log.t**2])))
    inner = slice(around, -around)
    # Central differences of a cube and a square.
    wide = (around * period) ** 2
    np.testing.assert_allclose(found[inner, 0], 3.0 * log.t[inner] ** 2 + wide, rtol=1e-9)
    np.testing.assert_allclose(found[:1, 1], log.t[around], rtol=1e-9)
    np.testing.assert_allclose(
        found[1, 1], log.t[1 + around] + log.t[max(1 - around, 0)], rtol=1e-9
    )
    np.testing.assert_allclose(found[-1, 1], log.t[-1] + log.t[-1 - around], rtol=1e-9)


URDF = """
<robot name="lift">
  <link name="base"/>
  <joint name="lift" type="prismatic">
    <parent link="base"/><child link="column"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.35" effort="2000" velocity="0.07"/>
  </joint>
  <link name="column"/>
  <joint name="arm" type="revolute">
    <parent link="column"/><child link="forearm"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="100" velocity="1.5"/>
  </joint>
  <link name="forearm"/>
</robot>
"""


def test_speeds_beyond_the_limits(
    tmp_path: Path, unchanged: Unchanged, data_regression: DataRegressionFixture
) -> None:
    path = tmp_path / "lift.urdf"
    path.write_text(URDF, encoding="utf-8")
    model = Robot(RobotDescription(name="lift", model=path, joints=("lift", "arm")))
    rising = np.linspace(-1.0, 0.7, 1001)[:, None]

    def told(*peaks: float, travel: float = 1.0) -> list[str]:
        part = as_part(two_joints(1001))
        fast = replace(part, v=peaks * rising, q=travel * part.q)
        return said(of_log(part.log, check_speed(fast, model)))

    unchanged(
        {
            "lift": edge(lambda x: told(x, 1.0), 0.01, 0.5),
            "arm": edge(lambda x: told(0.01, x), 0.5, 5.0),
        }
    )
    data_regression.check(
        {
            "lift": told(0.2, 1.0),
            "arm": told(0.03, 4.0),
            "both": told(3.0, 40.0),
            "at rest": told(3.0, 40.0, travel=1e-6),
        }
    )
