"""A law that cannot be fitted has a reason, and stops neither other laws nor other joints."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from joint_data import along, law, path

from hesr_model.errors import ArtifactError, FitError, SimulationError
from hesr_model.fitting import estimator, fit
from hesr_model.fitting.fit import fit_joint, fit_models
from hesr_model.fitting.reach import require_bounded_torque
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.predict import predict
from hesr_model.laws.baselines import CoulombViscous
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.arrays import Array

T = 0.01 * np.arange(600)
MOTION = np.sin(2.0 * T) * np.cos(0.6 * T)


def record(dq: Array, *, joint: str = "j1", log: str = "log", noise: float = 0.1) -> FrictionRecord:
    t = 0.01 * np.arange(len(dq))
    q = np.cumsum(dq) * 0.01
    tau = 5.0 * np.sign(dq) + 2.0 * dq + noise * np.random.default_rng(0).normal(size=len(dq))
    return FrictionRecord(
        log=log, joint=joint, t=t, dq=dq, q=q, tau_load=10.0 * np.sin(q), tau=tau, gear_ratio=100.0
    )


class Failing(CoulombViscous):
    """Raises `error` on the joint j2."""

    name = "failing"
    title = "Failing"
    error: Exception | None = None

    @classmethod
    def form(cls, structure: Mapping[str, Any]) -> LawForm:
        return CoulombViscous.form(structure)

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        law = replace(super().fit(records, rng), name="failing")
        if records[0].joint != "j2":
            return law
        if self.error is not None:
            raise self.error
        # The overflow is silent, as its result is refused.
        return replace(law, values={**law.values, "F_c": float(np.float64(1e300) * 1e300)})


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> type[Failing]:
    monkeypatch.setitem(estimator._REGISTRY, "failing", Failing)
    return Failing


def fit_two_joints(*names: str) -> tuple[dict[str, Any], dict[str, str]]:
    left_out: dict[str, str] = {}
    models = fit_models(
        names,
        [[record(MOTION)], [record(MOTION, joint="j2")]],
        robot="bench",
        seed=0,
        workers=1,
        report_left_out=lambda name, error: left_out.__setitem__(name, str(error)),
    )
    return models, left_out


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (np.linalg.LinAlgError("SVD did not converge"), "have no solution (SVD did not converge)"),
        (FloatingPointError("overflow"), "have no solution (overflow)"),
        (ArtifactError("coefficient 'a' is nan."), "coefficient 'a' is nan; its torque"),
        (SimulationError("the step is unstable."), "the step is unstable; its torque"),
        (FitError("joint 'j2': too few rows."), "too few rows."),
    ],
)
def test_one_joint_without_a_solution_leaves_the_law_out(
    failing: type[Failing], monkeypatch: pytest.MonkeyPatch, error: Exception, reason: str
) -> None:
    monkeypatch.setattr(failing, "error", error)
    models, left_out = fit_two_joints("none", "failing", "coulomb_viscous")
    assert list(models) == ["none", "coulomb_viscous"]
    assert list(left_out) == ["failing"]
    assert left_out["failing"].startswith("joint 'j2': ")
    assert reason in left_out["failing"]
    with pytest.raises(FitError, match="j2"):
        fit_two_joints("failing")  # nothing is left


def test_a_coefficient_that_is_not_finite_is_a_reason(failing: type[Failing]) -> None:
    models, left_out = fit_two_joints("none", "failing")
    assert list(models) == ["none"]
    assert "coefficient 'F_c' is inf" in left_out["failing"]


@pytest.mark.parametrize("step", ["add_standard_errors", "calibrate_band", "pool_errors"])
def test_later_steps_leave_a_law_out_as_well(monkeypatch: pytest.MonkeyPatch, step: str) -> None:
    original = getattr(fit, step)

    def fail(law: Any, *rest: Any) -> Any:
        laws = law if isinstance(law, list) else [law]
        if laws[0].name == "coulomb_viscous":
            raise np.linalg.LinAlgError("Singular matrix")
        return original(law, *rest)

    monkeypatch.setattr(fit, step, fail)
    models, left_out = fit_two_joints("none", "coulomb_viscous", "constant")
    assert list(models) == ["none", "constant"]
    assert "Singular matrix" in left_out["coulomb_viscous"]


def test_a_log_that_never_reverses_leaves_the_baselines() -> None:
    left_out: dict[str, str] = {}
    models = fit_models(
        ["constant", "stribeck", "parfam_s"],
        [[record(np.full(300, 0.4))]],
        robot="bench",
        seed=0,
        workers=1,
        report_left_out=lambda name, error: left_out.__setitem__(name, str(error)),
    )
    assert list(models) == ["constant"]
    assert list(left_out) == ["stribeck", "parfam_s"]
    assert all("never reverses" in reason for reason in left_out.values())


@pytest.mark.parametrize("logs", [("log", "log"), ("log", "other")])
def test_a_part_that_hardly_moves_does_not_spoil_the_law(logs: tuple[str, str]) -> None:
    """The difference of all rows and the moving ones was no positive definite matrix."""
    moving, creeping = record(MOTION, log=logs[0]), record(1e-5 * MOTION[:400], log=logs[1])
    creeping = replace(creeping, tau=0.01 * np.cos(T[:400]))
    law = fit_joint("parfam_s_v", [moving, creeping], seed=0)
    error = predict(law, t=moving.t, dq=moving.dq) - moving.tau
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.std(moving.tau)


def test_an_unknown_that_one_part_determines_alone_has_a_finite_error() -> None:
    """Where the other parts hold no information, their variance was negative round-off."""
    t = 0.01 * np.arange(3000)
    rates = 2.0 * np.pi * np.array([0.1, 0.17, 0.29, 0.41])
    phases = np.random.default_rng(0).uniform(0.0, 6.0, 4)
    dq = np.sin(np.outer(t, rates) + phases) @ [0.35, 0.3, 0.2, 0.15]
    dq[1500:] = 1e-5 * np.sin(np.arange(1500) / 50.0)
    law = fit_joint("lugre_static_first", [record(dq)], seed=0)
    assert law.covariance is not None
    assert np.all(np.isfinite(law.covariance.matrix))
    assert all(0.0 < error < np.inf for error in law.standard_errors.values())


def test_a_law_that_leaves_what_was_measured_is_refused() -> None:
    """A coefficient that the log does not excite may have any value."""
    true = law("coulomb_viscous", {}, F_c=1.0, sigma_2=0.5, tau_0=0.0)
    records = [along(true, path(0), noise=0.01)]
    require_bounded_torque(true, records)
    for coefficient in ("F_c", "sigma_2"):
        wild = replace(true, values={**true.values, coefficient: 100.0})
        with pytest.raises(FitError, match="does not determine"):
            require_bounded_torque(wild, records)
