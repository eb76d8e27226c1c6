"""Thresholds of odd results, gaps in the excitation, and proposed constants."""

from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from limits_found import as_part, edge, said, two_joints
from pytest_regressions.data_regression import DataRegressionFixture
from unchanged import Unchanged

from hesr_model.health.evidence import Estimate, JointTorque
from hesr_model.health.examine import _least_inertia, check_body, check_laws, check_owner, unseen
from hesr_model.health.proposal import _constants, _with_cutoff, changed
from hesr_model.rigid_body.residual import FrictionRecord
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.text import toml

ROWS = 1000


def fit(**changes: object) -> JointTorque:
    own: Mapping[str, object] = {
        "gravity": Estimate(value=2.0, error=0.01), "inertia": Estimate(value=1.0, error=0.1),
        "friction": Estimate(value=0.5, error=0.01), "gravity_size": 5.0, "friction_size": 1.0,
        "residual": 0.3, "deviation": 5.0,
    }  # fmt: skip
    return JointTorque(**{**own, **changes})


def test_missing_excitation(unchanged: Unchanged, data_regression: DataRegressionFixture) -> None:
    wave = np.sin(np.linspace(0.0, 12.0 * np.pi, ROWS))

    def told(v: np.ndarray = wave, *fits: JointTorque, parts: int = 1) -> list[str]:
        both = np.column_stack([v, 0.0 * v])
        part = as_part(two_joints(ROWS), v=both)
        found = SimpleNamespace(
            parts=[part] * parts, explained=[{0: one} for one in fits] + [{}] * (parts - len(fits))
        )
        return [f"{joint}: {what}" for joint, what in unseen(found, ("a", "b"))]

    def slow(rows: int) -> np.ndarray:
        """Back and forth at full speed, with some rows at a twentieth of it, above the rest
        threshold."""
        v = np.where(np.arange(ROWS) % 100 < 50, 1.0, -1.0)
        v[np.arange(rows) * 7] = 0.05
        return v

    def turns(count: int) -> np.ndarray:
        return np.where(
            np.arange(ROWS) // 50 % 2 * (np.arange(ROWS) < 100 * count / 2 + 50), -1.0, 1.0
        )

    def lacks(words: str, found: list[str]) -> bool:
        return any(words in x for x in found)

    unchanged(
        {
            "slow": [n for n in range(44, 56) if lacks("slow", told(slow(n)))],
            "slowly": edge(
                lambda x: lacks("slow", told(np.where(slow(60) == 0.05, x, slow(60)))), 0.03, 0.2
            ),
            "rests": [n for n in range(14, 26) if lacks("rest", told(slow(n) * 0.3))],
            "reversals": [n for n in range(8) if lacks("reversals", told(turns(n)))],
            "in two parts": [n for n in range(8) if lacks("reversals", told(turns(n), parts=2))],
            "load": edge(
                lambda x: lacks("load", told(wave, fit(gravity_size=x, residual=1e-3))), 0.1, 2.0
            ),
        }
    )  # fmt: skip
    weak = fit(gravity_size=0.1)
    light = fit(gravity_size=0.4, residual=0.01)
    data_regression.check(
        {
            "none": told(),
            "heavy": told(wave, fit()),
            "weightless": told(wave, weak),
            "light": told(wave, light),
            "one of two": told(wave, weak, fit(), parts=2),
            "light and heavy": told(wave, light, fit(), parts=2),
            "light and weightless": told(wave, light, weak, parts=2),
        }
    )


def test_odd_results(
    arm_model: Robot, unchanged: Unchanged, data_regression: DataRegressionFixture
) -> None:
    nominal = arm_model.nominal_parameters

    def body(coulomb: float = 1.0, rmse: float = 1.0, rotor: float = 0.1) -> SimpleNamespace:
        parameters = nominal.copy()
        parameters[-1] = rotor
        friction = np.array([[1.0, 2.0, 0.0], [coulomb, 2.0, 0.0], [1.0, 2.0, 0.0]])
        return SimpleNamespace(parameters=parameters, friction=friction, rmse=[1.0, rmse, 1.0])

    def of_body(**own: float) -> list[str]:
        return said(check_body(body(**own), arm_model))

    t = 0.01 * np.arange(200)
    tau = np.where(t < 1.0, 1.0, -1.0)
    record = FrictionRecord(
        log="run", joint="a", t=t, dq=tau, q=tau, tau_load=tau, tau=tau, gear_ratio=None
    )

    def of_laws(rmse: float = 0.1, **values: float) -> list[str]:
        law = SimpleNamespace(values=values)
        model = SimpleNamespace(joints=("a",), training_rmse=[rmse], laws=[law])
        return said(check_laws({"lugre": model}, [[record]]))

    unchanged(
        {
            "negative": edge(lambda x: of_body(coulomb=x), -2.0, 0.0),
            "no body": edge(lambda x: of_body(rotor=x), -0.5, 0.1),
            "least": [_least_inertia(body(rotor=x), arm_model) for x in (0.1, -0.1)],
            "nothing": edge(lambda x: of_laws(x), 0.5, 1.5),
            "bounds": [
                edge(lambda x: of_laws(F_c=2.0, F_s=2.0 * x), low, high)
                for low, high in ((0.19, 0.2), (0.2, 0.21), (4.8, 5.0), (5.0, 5.2))
            ],
        },
        rtol=1e-4,
    )
    owners = [
        SimpleNamespace(robot=robot, joints=joints, law="lugre")
        for robot in ("arm", "other")
        for joints in (("j1", "j2", "j3"), ("j1",))
    ]
    data_regression.check(
        {
            "negative": of_body(coulomb=-1.234),
            "no body": of_body(rotor=-0.5),
            "nothing": of_laws(1.0),
            "bounds": [of_laws(F_c=2.0, F_s=2.0 * x) for x in (0.1, 0.2, 1.0, 5.0, 9.0)],
            "negative ratio": [of_laws(F_c=-1.0, F_s=1.0), of_laws(F_c=0.0, F_s=1.0)],
            "none": [of_body(), of_laws(F_c=1.0), of_laws(F_s=1.0)],
            "owners": [said(check_owner(owner, arm_model)) for owner in owners],
        }
    )


def test_proposed_constants(
    arm: RobotDescription, unchanged: Unchanged, data_regression: DataRegressionFixture
) -> None:
    reasons: dict[str, str] = {}
    amperes = changed(arm, {"log.torque_per_ampere": (1.0, 2.0, -3.0)})

    def constants(*found: dict[int, JointTorque]) -> list[float]:
        own = _constants(amperes, SimpleNamespace(explained=found), reasons)
        return list(own.get("log.torque_per_ampere", ()))

    def gravity(value: float, error: float = 0.01, **more: object) -> JointTorque:
        return fit(gravity=Estimate(value=value, error=error), **more)

    def cutoff(period: float, given: float = 15.0) -> float:
        own = changed(arm, {"log.filter_cutoff": given})
        logs = [SimpleNamespace(period=x) for x in (0.001, period)]
        return float(_with_cutoff(own, logs, {}).log.filter_cutoff)

    unchanged(
        {
            "constants": [
                constants({0: gravity(0.2), 1: gravity(-0.5)}, {0: gravity(0.3)}),
                constants({1: gravity(1.1)}),
                constants({1: gravity(0.9), 2: gravity(2.0)}),
            ],
            "far": edge(lambda x: constants({0: gravity(x)}), 1.0, 2.0),
            "near": edge(lambda x: constants({0: gravity(x)}), 0.5, 1.0),
            "sure": edge(lambda x: constants({0: gravity(2.0, x)}), 0.01, 1.0),
            "seen": edge(lambda x: constants({0: gravity(2.0, residual=x)}), 0.1, 20.0),
            "rate": edge(lambda x: cutoff(x) != 15.0, 0.02, 0.04),
            "slowest": edge(lambda x: cutoff(x, 0.5) != 0.5, 0.9, 1.1),
            "cut-offs": [cutoff(x) for x in (0.02, 0.0267, 0.03, 0.1, 0.5, 2.0)],
        }
    )
    data_regression.check(
        {
            "reasons": reasons,
            "toml": [
                toml(x)
                for x in ({"a b": (1.0, True), "c": "é"}, [], ["x", 2], 1e-7, Path("x").name)
            ],
        }
    )
