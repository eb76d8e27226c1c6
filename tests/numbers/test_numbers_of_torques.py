"""Thresholds and messages of the checks of torque sign, size and signal."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from limits_found import as_part, edge, said, two_joints
from pytest_regressions.data_regression import DataRegressionFixture
from unchanged import Unchanged

from hesr_model.health.evidence import Estimate, JointTorque
from hesr_model.health.examine import of_log
from hesr_model.health.torque import check_torque, sign_change
from hesr_model.robots.robot import Robot, RobotDescription

LINK = '<link name="l{k}"><inertial><mass value="1"/>'
LINK += '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
JOINT = '<joint name="{name}" type="{kind}"><parent link="l{k}"/><child link="l{next}"/>'
JOINT += '<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="{effort}" velocity="2"/></joint>'
KINDS = (("a", "revolute", 100.0), ("b", "revolute", 50.0), ("c", "revolute", 1.6),
         ("d", "prismatic", 2.0), ("e", "revolute", 0.0))  # fmt: skip
SOUND = JointTorque(
    gravity=Estimate(value=1.0, error=0.01),
    inertia=Estimate(value=1.2, error=0.02),
    friction=Estimate(value=0.5, error=0.01),
    gravity_size=5.0,
    friction_size=0.6,
    residual=0.3,
    deviation=5.0,
)
"""Baseline without any finding."""
LIGHT = replace(SOUND, gravity=Estimate(value=0.0, error=np.inf), gravity_size=0.0)
"""The same baseline for a joint without gravity torque."""


@pytest.fixture
def robot(tmp_path: Path) -> RobotDescription:
    parts = [LINK.format(k=0)]
    for k, (name, kind, effort) in enumerate(KINDS):
        parts.append(JOINT.format(name=name, kind=kind, effort=effort, k=k, next=k + 1))
        parts.append(LINK.format(k=k + 1))
    path = tmp_path / "five.urdf"
    path.write_text(f'<robot name="five">{"".join(parts)}</robot>', encoding="utf-8")
    return RobotDescription(name="five", model=path, joints=tuple("abcde"))


def logged(robot: RobotDescription, **log: object) -> RobotDescription:
    data = robot.model_dump()
    data["gear_ratio"] = log.pop("gear_ratio", None)
    data["log"]["torque_per_ampere"] = log.pop("torque_per_ampere", None)
    data["log"]["units"] |= log
    return RobotDescription.model_validate(data)


def told(
    robot: RobotDescription,
    found: Mapping[int, JointTorque],
    check: str = "",
    *,
    peaks: tuple[float, ...] = (3.0, 3.0, 1.0, 1.0, 1.0),
    late: tuple[int, ...] = (),
) -> list[str]:
    part = as_part(two_joints(1001), tau=np.linspace(0.0, 1.0, 1001)[:, None] * peaks)
    return said(of_log(part.log, check_torque(part, found, Robot(robot), late)), check)


def of(value: float, error: float = 0.01) -> Estimate:
    return Estimate(value=value, error=error)


def test_signs_of_torques(
    robot: RobotDescription, unchanged: Unchanged, data_regression: DataRegressionFixture
) -> None:
    def sign(j: int = 0, **changes: object) -> list[str]:
        fit = replace(SOUND, **({"friction": of(-0.5)} | changes))
        return told(robot, {j: fit}, "torque-sign")

    def turned(**changes: object) -> list[str]:
        fit = replace(SOUND, gravity=of(-1.0), **changes)
        return told(robot, {0: fit}, "gravity-sign")

    def follows(error: float) -> bool:
        return any("position and velocity count" in x for x in sign(gravity=of(1.0, error)))

    unchanged(
        {
            "sure": edge(lambda x: sign(friction=of(-1.0, x)), 0.01, 1.0),
            "size": edge(lambda x: sign(friction_size=x), 0.01, 1.0),
            "gravity's error": edge(
                lambda x: told(robot, {0: replace(SOUND, gravity=of(-1.0, x))}, "gravity-sign"),
                0.01,
                1.0,
            ),
            "seen": edge(lambda x: turned(gravity_size=x), 0.01, 1.0),
            "follows": edge(follows, 0.01, 1.0),
            "bears": edge(
                lambda x: any("which" in t or "or its" in t for t in sign(gravity_size=x)), 0.1, 2.0
            ),
        },
        rtol=1e-5,
    )
    data_regression.check(
        {
            "torque": sign(gravity=of(1.0, 1.0)),
            "at five errors": sign(gravity=of(1.0, 0.2)),
            "position": sign(),
            "slides": sign(3),
            "no gravity": sign(gravity_size=0.0),
            "gravity turned around": turned(),
            "both": told(robot, {1: replace(SOUND, gravity=of(-1.234), friction=of(-0.5))}),
            "none": told(robot, {0: SOUND, 1: SOUND}),
        }
    )


def test_changes_of_sign(robot: RobotDescription, data_regression: DataRegressionFixture) -> None:
    mixed = logged(robot, q=("rad", "-deg", 2.0, "m", "-rad"), tau=("N.m", "-mN.m", -3.0, "N", 1.0))
    amperes = logged(robot, torque_per_ampere=(1.0, -2.5, 3.0, 4.0, 5.123456))
    data_regression.check(
        {
            f"{name}, joint {j}, {position=}": [
                (change := sign_change(own, j, position=position))[0],
                {key: str(value) for key, value in change[1].items()},
            ]
            for name, own in (("plain", robot), ("mixed", mixed), ("amperes", amperes))
            for j in (None, 0, 1, 2, 4)
            for position in (False, True)
        }
    )


def test_sizes_of_torques(
    robot: RobotDescription, unchanged: Unchanged, data_regression: DataRegressionFixture
) -> None:
    def scale(own: RobotDescription = robot, j: int = 0, **changes: object) -> list[str]:
        return told(own, {j: replace(SOUND, **changes)}, "torque-scale")

    def gone(x: float) -> bool:
        return any("was removed" in t for t in scale(gravity=of(x, 1e-4)))

    def words(text: str, found: list[str]) -> bool:
        return any(text in x for x in found)

    def motor(x: float) -> bool:
        return words("motor torque before", scale(geared, gravity=of(x), inertia=of(0.01)))

    def beside(x: float) -> bool:
        found = {0: two, 1: replace(two, gravity=of(x))}
        return words("currents", told(robot, found, "torque-scale"))

    geared = logged(robot, gear_ratio=(50.0, 50.0, 200.0, 1.0, 1.0))
    amperes = logged(robot, torque_per_ampere=(1.0, 2.0, 3.0, 4.0, 5.0))
    unseen = {"gravity": of(1.0, 1.0)}
    hardly = {"gravity_size": 0.01, "residual": 0.3}
    two = replace(SOUND, gravity=of(0.2))
    unchanged(
        {
            "small": edge(lambda x: scale(gravity=of(x)), 0.1, 1.0),
            "large": edge(lambda x: scale(gravity=of(x)), 1.0, 9.0),
            "turned, small": edge(lambda x: scale(gravity=of(x)), -1.0, -0.1),
            "margin": edge(lambda x: scale(gravity=of(0.2, x)), 1e-3, 0.038),
            "margin of large": edge(lambda x: scale(gravity=of(6.0, x)), 0.01, 0.9),
            "sure": edge(
                lambda x: words("inertia", scale(gravity=of(6.0, x), inertia=of(0.1))), 0.1, 9.0
            ),
            "inertia": edge(lambda x: scale(**unseen, inertia=of(x)), 0.1, 1.0),
            "margin of inertia": edge(lambda x: scale(**unseen, inertia=of(0.1, x)), 1e-3, 1.0),
            "explained": edge(lambda x: scale(gravity=of(0.1), residual=x), 0.3, 4.9),
            "gone": edge(gone, 0.0, 0.3),
            "gone, beside inertia": edge(
                lambda x: words("was removed", scale(gravity=of(0.05, 1e-4), inertia=of(x))),
                0.1,
                1.0,
            ),
            "weightless": edge(
                lambda x: words("was removed", scale(gravity=of(0.01, x), inertia=of(1.0))),
                1e-3,
                0.2,
            ),
            "hardly seen": edge(lambda x: scale(**hardly, gravity=of(x)), 1.0, 29.0),
            "hardly, with an error": edge(
                lambda x: scale(**hardly, gravity=of(20.0, x)), 0.01, 3.9
            ),
            "least that is seen": edge(
                lambda x: scale(gravity=of(100.0), gravity_size=x, residual=2.0), 1e-5, 0.01
            ),
            "milli": edge(lambda x: words("mN.m", scale(gravity=of(x))), 50.0, 200.0),
            "motor": edge(motor, 0.001, 0.02),
            "motor at most": edge(motor, 0.02, 0.1),
            "everywhere": edge(beside, 0.2, 1.0),
            "everywhere, large": edge(beside, 1.0, 9.0),
        },
        rtol=1e-5,
    )
    data_regression.check(
        {
            "small": scale(gravity=of(0.01)),
            "large": scale(gravity=of(7.77)),
            "gone": scale(gravity=of(0.01), inertia=of(1.0)),
            "a tenth": scale(gravity=of(0.1, 1e-4), inertia=of(1.0)),
            "hardly any": scale(gravity=of(0.1, 0.08), inertia=of(0.1)),
            "threefold beside": told(robot, {0: two, 1: replace(two, gravity=of(3.0))}),
            "negative": scale(gravity=of(-0.01, 0.02), inertia=of(1.0)),
            "inertia": scale(**unseen, inertia=of(0.1)),
            "inertia below zero": scale(**unseen, inertia=of(-0.4)),
            "much inertia": scale(**unseen, inertia=of(40.0)),
            "neither": scale(gravity=of(0.0, np.inf), gravity_size=0.0, inertia=of(0.0, np.inf)),
            "without gravity": told(robot, {0: replace(LIGHT, inertia=of(0.1))}),
            "milli": scale(gravity=of(1e3)),
            "motor": scale(geared, gravity=of(0.02), inertia=of(0.01)),
            "motor of others": scale(geared, gravity=of(0.2), inertia=of(0.01)),
            "currents": told(robot, {0: two, 1: two}),
            "one of two": told(robot, {0: two, 1: SOUND}),
            "two and one without": told(robot, {0: two, 1: two, 2: LIGHT}),
            "both too large": told(robot, {k: replace(two, gravity=of(5.0)) for k in (0, 1)}),
            "late": told(robot, {0: two, 1: two}, late=(0,)),
            **{
                f"constant {x:g}": scale(amperes, gravity=of(x), inertia=of(0.1))
                for x in (0.0123, 0.077, 0.24, 3.7, 12.6, 96.7, 1234.0)
            },
            "constant of nothing": scale(amperes, **unseen, inertia=of(-0.4)),
            "constant of zero": scale(amperes, **unseen, inertia=of(0.0)),
        }
    )


def test_torques_without_signal_or_friction(
    robot: RobotDescription, unchanged: Unchanged, data_regression: DataRegressionFixture
) -> None:
    def signal(residual: float) -> list[str]:
        return told(robot, {0: replace(SOUND, residual=residual)}, "torque-signal")

    def alone(other: JointTorque = LIGHT, **changes: object) -> list[str]:
        fit = replace(exact_one, **changes)
        found = {0: fit} if other is LIGHT else {0: fit, 1: other}
        return told(robot, found, "no-friction")

    def exact(**changes: object) -> list[str]:
        own = {"friction": of(0.01), "residual": 0.1} | changes
        return told(robot, {0: replace(SOUND, **own), 1: LIGHT}, "no-friction")

    exact_one = replace(SOUND, friction=of(0.01), residual=0.1)
    other = replace(exact_one, deviation=0.11)
    unchanged(
        {
            "signal": edge(signal, 0.1, 4.9),
            "friction": edge(lambda x: alone(friction=of(x)), 0.0, 0.5),
            "drives": edge(lambda x: alone(friction=of(x)), -0.5, 0.0),
            "residual": edge(lambda x: alone(residual=x), 0.1, 2.0),
            "explained": edge(lambda x: alone(replace(SOUND, deviation=x)), 0.31, 5.0),
        },
        rtol=1e-5,
    )
    data_regression.check(
        {
            "none": signal(4.9),
            "less than none": signal(6.0),
            "no friction": told(robot, {0: exact_one, 2: exact_one}),
            "one of two": told(robot, {0: exact_one, 1: other}),
            "one with friction": exact(),
            "nothing": told(robot, {}),
        }
    )


def test_torques_against_limits(
    robot: RobotDescription, unchanged: Unchanged, data_regression: DataRegressionFixture
) -> None:
    def at_peaks(*peaks: float, found: int = 5, check: str = "", r2: float = 0.9) -> list[str]:
        fit = replace(SOUND, residual=5.0 * np.sqrt(1.0 - r2))
        own = {j: fit if j == 0 else SOUND for j in range(found)}
        return told(robot, own, check, peaks=peaks)

    rest = (40.0, 1.2, 1.0, 1.0)
    unchanged(
        {
            "limit": edge(lambda x: at_peaks(x, *rest, check="torque-limit"), 100.0, 3e3),
            "small": edge(lambda x: at_peaks(x, *rest, check="torque-small"), 0.1, 50.0),
            "explained": edge(
                lambda x: at_peaks(0.1, *rest, check="torque-small", r2=x), 0.5, 0.95
            ),
        },
        rtol=1e-5,
    )
    data_regression.check(
        {
            "too large": at_peaks(3e3, *rest),
            "too small": at_peaks(0.12345, *rest),
            "of two": at_peaks(0.1, *rest, found=2),
            "of three": at_peaks(0.1, *rest, found=3),
            "slides": at_peaks(10.0, 5.0, 0.1, 900.0, 1.0),
            "without a limit": at_peaks(10.0, 5.0, 0.1, 1.0, 1e9),
            "last": at_peaks(99.0, 49.0, 0.01, 1.0, 1.0),
        }
    )
