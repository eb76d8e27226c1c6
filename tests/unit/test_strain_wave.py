"""The strain-wave law: recovery from its own data, and coefficients currents cannot determine."""

import numpy as np
import pytest
from joint_data import along, error_on, law, path, training, unseen, with_tau

from hesr.extras.laws.strain_wave import StrainWave
from hesr_model.friction.predict import predict
from hesr_model.inference.covariance import standard_errors

VALUES = {"x_0": 4e-3, "mu_avg": 0.12, "mu_dif": 0.03, "F_c": 5.0, "sigma_2": 7.0, "tau_0": 0.5}
TRUTH = law("strain_wave", {}, **VALUES)


def fitted_to(records: list) -> dict[str, float]:
    return dict(StrainWave().fit(records, np.random.default_rng(0)).values)


def test_generating_coefficients_are_found() -> None:
    found = fitted_to(training(TRUTH, noise=0.0))
    for name, value in VALUES.items():
        assert found[name] == pytest.approx(value, rel=1e-2), name


def test_noise_costs_only_its_share() -> None:
    fitted = StrainWave().fit(training(TRUTH, noise=0.5), np.random.default_rng(0))
    assert error_on(fitted, unseen(TRUTH)) < 0.08


def test_forces_never_drive() -> None:
    record = along(TRUTH, path(0))
    found = fitted_to([with_tau(record, -3.0 * np.tanh(30.0 * record.dq) - 2.0 * record.dq)])
    assert found["F_c"] == 0.0
    assert found["sigma_2"] == 0.0


def test_the_torque_follows_the_equation() -> None:
    way = path(2, from_rest=True)
    z, expected = 0.0, []
    for k, (v, load) in enumerate(zip(way.dq, way.load, strict=True)):
        if k and v:
            z = np.sign(v) + (z - np.sign(v)) * np.exp(-abs(v) / 4e-3 * (way.t[k] - way.t[k - 1]))
        expected.append(0.12 * abs(load) * z + 0.03 * load * z**2 + 5.0 * z + 7.0 * v + 0.5)
    torque = predict(TRUTH, t=way.t, dq=way.dq, tau_load=way.load)
    np.testing.assert_allclose(torque, expected, atol=1e-10)


def test_an_error_of_the_rigid_body_is_taken_for_mu_dif() -> None:
    """In sliding z^2 = 1, so mu_dif tau_load is a share of the rigid-body torque itself."""
    records = training(TRUTH, noise=0.0)
    scaled = [with_tau(r, r.tau + 0.04 * r.tau_load) for r in records]
    before, after = fitted_to(records), fitted_to(scaled)
    assert after["mu_dif"] - before["mu_dif"] == pytest.approx(0.04, abs=0.004)
    for name in ("mu_avg", "F_c", "sigma_2", "tau_0"):
        assert after[name] == pytest.approx(before[name], rel=0.05), name


def test_an_unknown_rigid_body_leaves_mu_dif_undetermined() -> None:
    """Its standard error grows many times over, unlike that of mu_avg."""
    record = along(TRUTH, path(0, seconds=20.0, rests=False), noise=0.5)

    def torque(values: dict[str, float]) -> np.ndarray:
        own = law("strain_wave", {}, **values)
        return predict(own, t=record.t, dq=record.dq, tau_load=record.tau_load)

    step = 1e-6
    columns = np.stack(
        [
            (torque(VALUES | {n: v + step}) - torque(VALUES | {n: v - step})) / (2.0 * step)
            for n, v in VALUES.items()
            if n != "x_0"
        ],
        axis=1,
    )
    residual = record.tau - torque(VALUES)
    known = standard_errors(columns, residual)
    unknown = standard_errors(np.column_stack([columns, record.tau_load]), residual)
    names = [n for n in VALUES if n != "x_0"]
    rise = dict(zip(names, unknown[:-1] / known, strict=True))
    assert rise["mu_dif"] > 4.0
    assert all(rise[name] < 1.2 for name in names if name != "mu_dif"), rise
