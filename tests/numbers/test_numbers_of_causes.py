"""Mistakes considered, their unexplained torque, and the resulting advice."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from limits_found import at, edge, said
from pytest_regressions.data_regression import DataRegressionFixture
from unchanged import Unchanged

from hesr_model.findings import Finding
from hesr_model.health.evidence import Motionwise, motionwise
from hesr_model.health.examine import (
    HealthError,
    _caused,
    _without_followers,
    hopeless,
    merged,
    require_sound,
)
from hesr_model.health.mistakes import (
    _best,
    _by_axis,
    _gravity,
    _unexplained,
    check_causes,
    mistakes,
    pooled,
    torques_of,
)
from hesr_model.health.proposal import _changes, _combined, changed
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.robots.transmission import Transmission

MakeMotion = Callable[..., Motion]
ALL = np.ones(3, dtype=bool)


@pytest.fixture
def part(make_motion: MakeMotion) -> Motionwise:
    motion = make_motion(name="run", friction=0.8)
    noise = np.random.default_rng(0).normal(0.0, 0.05, motion.tau.shape)
    log = Log(name="run", t=motion.t, q=motion.q, dq=motion.dq, tau=motion.tau + noise)
    (made,) = motionwise(log, 15.0)
    return made


def described(arm: RobotDescription, **more: object) -> Robot:
    data = arm.model_dump()
    data["log"] |= more.pop("log", {})
    return Robot(RobotDescription.model_validate(data | more))


def variants(arm: RobotDescription) -> dict[str, Robot]:
    coupled = Transmission(matrix=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.5, 1.0)), logs="motor")
    return {
        "plain": Robot(arm),
        "amperes": described(arm, log={"torque_per_ampere": (1.0, 2.0, -3.0)}),
        "zeros": described(arm, log={"zero": (0.1, 0.2, -0.3)}),
        "sideways": described(arm, gravity=(9.81, 0.0, 0.0)),
        "upside down": described(arm, gravity=(0.0, 0.0, 9.81)),
        "weightless": described(arm, gravity=(0.0, 0.0, 0.0)),
        "tilted": described(arm, gravity=(0.0, 5.0, -8.0)),
        "motors": described(arm, transmission=coupled),
    }


def test_mistakes(
    part: Motionwise,
    arm: RobotDescription,
    unchanged: Unchanged,
    data_regression: DataRegressionFixture,
) -> None:
    told: dict[str, list[str]] = {}
    numbers: dict[str, object] = {}
    for name, model in variants(arm).items():
        rows = pooled([part], model.gravity.tolist())
        found = list(mistakes(rows, model, ALL))
        told[name] = [f"{m.check} {m.joint}: {m.remedy} | {dict(m.changes)}" for m in found]
        numbers[name] = [
            [np.sum(getattr(m.mended, k) * np.arange(1.0, 4.0)) for k in ("q", "v", "a", "tau")]
            for m in found
        ]
        numbers[f"{name}, left"] = _unexplained(rows, model, ALL)
        numbers[f"{name}, gravity"] = [m.mended.gravity for m in _gravity(rows, model, [0, 1, 2])]
    plain = Robot(arm)
    rows = pooled([part], (1.0, -2.0, 3.0))
    numbers["torques"] = torques_of(rows, plain)
    numbers["by axis"] = _by_axis(rows.q, plain)
    two = np.array([True, False, True])
    told["two joints"] = [f"{m.check} {m.joint}" for m in mistakes(rows, plain, two)]
    told["one joint"] = [
        f"{m.check} {m.joint}" for m in mistakes(rows, plain, np.array([False, True, False]))
    ]
    numbers["two joints"] = _unexplained(rows, plain, two)
    unchanged(numbers, rtol=1e-4, atol=1e-6)
    data_regression.check(told)


def test_tilted_gravity(part: Motionwise, arm_model: Robot, unchanged: Unchanged) -> None:
    rows = pooled([part], arm_model.gravity.tolist())
    axes = _by_axis(rows.q, arm_model)
    own = torques_of(rows, arm_model).gravity

    def found(angle: float, size: float = 9.81, about: int = 0) -> list[float]:
        g = np.zeros(3)
        g[about], g[2] = size * np.sin(angle), -size * np.cos(angle)
        tau = rows.tau - own + np.einsum("kij,k->ij", axes, g)
        return [
            x
            for m in _gravity(replace(rows, tau=tau), arm_model, [0, 1, 2])
            for x in m.mended.gravity
        ]

    def noisy(size: float) -> list[object]:
        noise = size * np.random.default_rng(0).normal(size=rows.tau.shape)
        worse = replace(rows, tau=-rows.tau + noise)
        return list(_gravity(worse, arm_model, [0, 1, 2]))

    unchanged(
        {
            "tilted": edge(lambda x: found(x), 0.0, 1.0),
            "snaps": edge(lambda x: abs(found(x)[2]) > 1e-6, 1.0, 1.5),
            "snaps sideways": edge(lambda x: abs(found(x, about=1)[2]) > 1e-6, 1.0, 1.5),
            "small": edge(lambda x: found(2.0, x), 0.1, 9.0),
            "noise": edge(noisy, 0.1, 50.0, steps=12),
            "ways": [found(x, about=k) for x in (0.5, 1.55, 2.5, 3.1, -0.8) for k in (0, 1)],
        },
        rtol=1e-4,
        atol=1e-6,
    )


def test_causes(
    part: Motionwise,
    arm_model: Robot,
    unchanged: Unchanged,
    data_regression: DataRegressionFixture,
) -> None:
    def told(*parts: Motionwise) -> list[str]:
        return said(check_causes(parts, arm_model))

    back = replace(part, tau=part.tau * [1.0, -1.0, 1.0])

    def noisy(size: float) -> Motionwise:
        noise = size * np.random.default_rng(1).normal(size=part.tau.shape)
        return replace(back, tau=back.tau + noise)

    def weak(share: float) -> Motionwise:
        """A torque with reversed sign in a share of the rows."""
        ways = np.where(np.arange(len(part.t)) < share * len(part.t), -1.0, 1.0)
        return replace(part, tau=part.tau * ways[:, None] * [0.0, 1.0, 0.0] + part.tau * [1, 0, 1])

    rows = pooled([part], (0.0, 0.0, -9.81))
    now = _unexplained(rows, arm_model, ALL)
    unchanged(
        {
            "rows": [len(pooled([part] * n, (0, 0, 0)).q) for n in (1, 2, 5, 7, 8, 20)],
            "noise": edge(lambda x: told(noisy(x)), 0.0, 20.0, steps=12),
            "share": edge(lambda x: told(weak(x)), 0.2, 1.0, steps=9),
            "now": now,
            "best of none": _best(rows, now, arm_model, ALL)[1],
        },
        rtol=1e-3,
    )
    data_regression.check(
        {
            "none": told(part),
            "no logs": told(),
            "back": told(back),
            "three": told(replace(part, tau=part.tau * [-1.0, -1.0, 1.0], q=part.q * [1, 1, -1])),
            "one rests": told(replace(back, q=at(back.q, slice(None), 0, 0.0))),
            "one constant": told(replace(back, tau=at(back.tau, slice(None), 0, 2.0))),
            "two logs": told(back, replace(back, log=replace(back.log, name="other"))),
            "all back": told(replace(part, tau=-part.tau)),
            "first back": told(replace(part, tau=part.tau * [-1.0, 1.0, 1.0])),
        }
    )


def finding(
    check: str,
    joint: str = "",
    severity: str = "warning",
    log: str = "one",
    remedy: str = "c",
    **changes: object,
) -> Finding:
    return Finding(
        check=check,
        severity=severity,
        joints=(joint,) if joint else (),
        logs=(log,),
        found=f"{check} of {joint}",
        remedy=remedy,
        changes={key.replace("_", "."): value for key, value in changes.items()},
    )


def test_findings_become_sentences(data_regression: DataRegressionFixture) -> None:
    sign = finding("torque-sign", "a", "error")
    several = [
        finding("torque-lag", "a"),
        sign,
        finding("torque-lag", "a", log="two"),
        finding("torque-lag", "b", log="two"),
        finding("torque-lag", "c", remedy="d"),
        replace(sign, severity="warning", logs=("two",)),
        replace(sign, joints=("b",), logs=("three",)),
    ]
    told: dict[str, list[str]] = {"merged": [f.sentence for f in merged(several)]}
    told["turned around"] = said(merged(several[::-1]))
    told["bare"] = [replace(sign, joints=(), logs=()).sentence, replace(sign, logs=()).sentence]
    for accepted in ((), ("torque-lag",), ("torque-sign",)):
        for those in (several, several[:2]):
            try:
                told[f"{accepted} {len(those)}"] = said(require_sound(those, accepted))
            except HealthError as error:
                told[f"{accepted} {len(those)}"] = [str(error), str(len(error.findings))]
    lag, scale = finding("torque-lag", "b"), finding("torque-scale", "a")
    zero, all_back = finding("zero", "c", "error"), finding("torque-sign", severity="error")
    other = replace(sign, found="another")
    told |= {
        f"caused {k}": said(_caused([sign, lag, scale, finding("gaps")], causes))
        for k, causes in enumerate([[], [other], [zero], [all_back], [other, zero],
                                    [finding("position-sign", "a", "error")]])
    }  # fmt: skip
    unlike, speed = finding("velocity-match", "a", "error"), finding("speed-limit", "b")
    units = finding("velocity-scale", "b", log_units_dq="rpm")
    columns = finding("velocity-columns", "a", log_columns_dq=("b", "a"))
    told |= {
        f"without followers {k}": said(_without_followers([unlike, speed, *more]))
        for k, more in enumerate([[], [columns], [finding("same-column", "b")], [units],
                                  [finding("coarse", "c")], [finding("time-scale"), lag]])
    }  # fmt: skip
    told["hopeless"] = [
        str(hopeless([f]))
        for severity in ("error", "warning")
        for f in (
            finding("limits", "a", severity),
            finding("wrap", "a", severity),
            finding("spikes", "a", severity),
            finding("zero", "a", severity),
            finding("time-unit", "", severity, log_units_t="ms"),
            finding("velocity-scale", "", severity, log_units_q="deg"),
            finding("velocity-scale", "", severity, log_units_dq="rpm"),
        )
    ]
    data_regression.check(told)


def test_changes_of_several_findings(
    arm: RobotDescription, data_regression: DataRegressionFixture
) -> None:
    back = finding("velocity-sign", "j1", "error", log_units_dq=("-rad/s", "rad/s", "rad/s"))
    also = finding("velocity-scale", "j2", log_units_dq=("rad/s", "rpm", "rad/s"))
    lag = finding("velocity-lag", "j2", log_columns_dq="")
    same = finding("zero", "j2", log_units_q="rad")
    changes, reasons = _changes(arm, [back, also, lag, same])
    data_regression.check(
        {
            "both": str(changes),
            "reasons": reasons,
            "one for all": _combined("rad", ("a", "rad"), "deg"),
            "the first": str(_combined("rad", None, ("a", "b"))),
            "each its own": str(_combined("rad", ("deg", "rad"), ("rad", "mm"))),
            "of a list": str(_combined(("a", "b"), ("a", "c"), ("d", "b"))),
            "changed": str(changed(arm, {"log.units.q": "deg", "gravity": (0, 0, 1.0)}).log.units),
        }
    )
