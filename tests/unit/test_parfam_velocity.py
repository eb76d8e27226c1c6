"""ParFam-V: a symbolic law of velocity alone, without memory."""

import numpy as np
import pytest
from joint_data import HX_PAPER, along, error_on, law, path, training, unseen

from hesr_model.errors import FitError
from hesr_model.fitting.fit import fit_joint
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.laws.parfam.laws import ParFamV

NOISE = 0.2


def static(g: str, **values: float) -> FrictionLaw:
    structure = {"linear": ["1", "dq"], "units": [{"g": g, "arguments": ["1", "dq"]}]}
    return law("parfam_v", structure, **values)


TRUTHS = {
    "smooth": static("tanh", c_0=0.5, c_dq=4.0, c_g1=8.0, theta1_0=0.2, theta1_dq=6.0),
    "steep": static("tanh", c_0=-0.3, c_dq=5.0, c_g1=10.0, theta1_0=0.0, theta1_dq=300.0),
    "wave": static("sin", c_0=0.5, c_dq=6.0, c_g1=4.0, theta1_0=0.3, theta1_dq=5.0),
}


@pytest.mark.parametrize("kind", TRUTHS)
def test_the_generating_law_is_found(kind: str) -> None:
    truth = TRUTHS[kind]
    found = fit_joint("parfam_v", training(truth, noise=NOISE), seed=0)
    assert found.structure == truth.structure
    v = np.linspace(-0.8, 0.8, 161)
    t = 0.01 * np.arange(len(v))
    expected = predict(truth, t=t, dq=v)
    # A step this steep lies between two neighbouring rows.
    apart = np.abs(v) > 0.02
    np.testing.assert_allclose(predict(found, t=t, dq=v)[apart], expected[apart], atol=0.15)
    assert found.values["c_dq"] == pytest.approx(truth.values["c_dq"], abs=0.5)


def test_it_uses_velocity_and_has_no_state() -> None:
    found = fit_joint("parfam_v", training(TRUTHS["smooth"], noise=NOISE), seed=0)
    assert [u.name for u in found.form.inputs] == ["dq"]
    assert found.form.relaxations == ()
    assert set(found.values) == {"c_0", "c_dq", "c_g1", "theta1_0", "theta1_dq"}


@pytest.mark.parametrize("g", ["tanh", "sin"])
def test_only_the_requested_functions_are_tried(g: str) -> None:
    records = training(TRUTHS["smooth"], noise=NOISE)
    found = ParFamV(functions=(g,)).fit(records, np.random.default_rng(0))
    assert [unit["g"] for unit in found.structure["units"]] == [g]


def test_left_out_logs_choose_the_function() -> None:
    """A wave cannot fit a steep step, nor the reverse."""
    for kind, other in (("steep", "sin"), ("wave", "tanh")):
        truth = TRUTHS[kind]
        records, test = training(truth, noise=NOISE), unseen(truth)
        chosen = fit_joint("parfam_v", records, seed=0)
        forced = ParFamV(functions=(other,)).fit(records, np.random.default_rng(0))
        assert error_on(chosen, test) < 0.5 * error_on(forced, test)


def test_memory_cannot_be_fitted() -> None:
    truth = law("parfam_hx", HX_PAPER, c_0=0.0, c_dq=5.0, c_h=9.0, c_dh=0.02, alpha=12.0, beta=60.0)
    records = training(truth, noise=NOISE)
    static_error = error_on(fit_joint("parfam_v", records, seed=0), unseen(truth))
    with_state = error_on(fit_joint("parfam_h", records, seed=0), unseen(truth))
    assert with_state < 0.2 * static_error


def test_the_same_seed_gives_the_same_law() -> None:
    records = training(TRUTHS["steep"], noise=NOISE)
    assert fit_joint("parfam_v", records, seed=2) == fit_joint("parfam_v", records, seed=2)


def test_seeds_agree() -> None:
    for truth in TRUTHS.values():
        records = training(truth, noise=NOISE)
        errors = [error_on(fit_joint("parfam_v", records, seed=s), records[0]) for s in range(4)]
        assert max(errors) < 1.01 * min(errors)


def test_too_few_rows_are_refused() -> None:
    record = along(TRUTHS["smooth"], path(0))
    short = {n: v[:4] for n, v in vars(record).items() if isinstance(v, np.ndarray)}
    with pytest.raises(FitError, match="4 rows for 5 coefficients"):
        fit_joint("parfam_v", [type(record)(**(vars(record) | short))], seed=0)
