"""Width of a band: errors on left-out logs, and the covariance elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from joint_data import along, law, path, with_tau

from hesr_model.errors import ArtifactError, SimulationError
from hesr_model.fitting.calibration import calibrate_band, recalibrate_band
from hesr_model.fitting.uncertainty import add_standard_errors
from hesr_model.friction.band import REST, Band, shapes
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.residual import transform_records
from hesr_model.robots.transmission import Coupling

TRUTH = law("strain_wave", {}, x_0=4e-3, mu_avg=0.12, mu_dif=0.03, F_c=5.0, sigma_2=7.0, tau_0=0.5)


def noisy(seed: int, *, rests: bool = False, spread: float = 0.5) -> FrictionRecord:
    """A log whose noise doubles in slow motion and grows with speed."""
    clean = along(TRUTH, path(seed, seconds=24.0, rests=rests))
    slow = 1.0 / (1.0 + (clean.dq / 0.08) ** 2)
    size = spread * np.sqrt(1.0 + 3.0 * slow + clean.dq**2)
    noise = size * np.random.default_rng(seed).normal(size=len(clean.t))
    return replace(with_tau(clean, clean.tau + noise), log=f"log {seed}")


@pytest.fixture(scope="module")
def banded() -> FrictionLaw:
    records = [noisy(seed) for seed in range(3)]
    return calibrate_band(add_standard_errors(TRUTH, records), records)[0]


def model_of(*laws: FrictionLaw, **more) -> FrictionModel:
    joints = tuple(f"axis_{i}" for i, _ in enumerate(laws))
    return FrictionModel(
        law="lugre", robot="bench", joints=joints, laws=laws, sample_time=0.008, **more
    )


@pytest.mark.parametrize("coverage", [0.8, 0.9, 0.95, 0.99])
def test_a_band_covers_its_share_of_an_unseen_log(banded: FrictionLaw, coverage: float) -> None:
    inside, width = [], []
    for seed in range(10, 14):
        unseen = replace(noisy(seed), joint="axis_0")
        lower, upper = model_of(banded).predict_band([unseen], coverage=coverage)
        inside.append((unseen.tau > lower[:, 0]) & (unseen.tau < upper[:, 0]))
        width.append(np.abs(unseen.dq))
    held, speed = np.concatenate(inside), np.concatenate(width)
    assert held.mean() == pytest.approx(coverage, abs=0.02)
    for slow in (speed < 0.1, speed > 0.5):  # regions with different error sizes
        assert held[slow].mean() == pytest.approx(coverage, abs=0.05)


def test_band_width_matches_the_errors(banded: FrictionLaw) -> None:
    band = banded.band
    assert band is not None
    assert band.floor == pytest.approx(1.96 * 0.5, rel=0.15)
    assert band.slow == pytest.approx(1.96 * 0.5 * np.sqrt(3.0), rel=0.3)
    assert band.slow_speed in (0.04, 0.08, 0.16)
    assert band.tail == pytest.approx(0.65, abs=0.06)  # for normal errors
    assert (band.envelope, band.rest) == (1.0, 0.0)


def test_uncertain_coefficients_widen_the_band() -> None:
    """Left-out logs set the width, covariance its distribution: viscous friction grows."""
    records = [noisy(seed) for seed in range(3)]
    known = add_standard_errors(TRUTH, records)
    assert known.covariance is not None
    large = replace(known.covariance, within=1e4 * known.covariance.within)
    certain, doubtful = (
        calibrate_band(x, records)[0].band
        for x in (replace(known, covariance=None), replace(known, covariance=large))
    )
    assert certain is not None
    assert doubtful is not None
    assert doubtful.fast / doubtful.floor > 2.0 * certain.fast / certain.floor


def test_observed_rests_replace_the_envelope() -> None:
    records = [noisy(seed, rests=True) for seed in range(5)]  # two rests each
    for seen, envelope in ((records, 0.0), (records[:4], 1.0)):
        band = calibrate_band(TRUTH, seen)[0].band
        assert band is not None
        assert band.envelope == envelope


def test_perfect_logs_give_a_band_without_width() -> None:
    records = [along(TRUTH, path(0))]
    band = calibrate_band(TRUTH, records)[0].band
    assert band is not None
    assert band.floor == pytest.approx(0.0, abs=1e-9)


def test_a_band_survives_json(banded: FrictionLaw, tmp_path) -> None:
    model = replace(model_of(replace(banded, covariance=None)), law="strain_wave")
    model.write(tmp_path / "law.json")
    assert FrictionModel.read(tmp_path / "law.json").laws[0].band == banded.band


@pytest.mark.parametrize(
    ("name", "value"), [("floor", -1.0), ("slow_speed", 0.0), ("tail", float("nan"))]
)
def test_invalid_bands_are_refused(banded: FrictionLaw, name: str, value: float) -> None:
    with pytest.raises(ArtifactError, match=f"'{name}' of a band is"):
        replace(banded.band, **{name: value})


def test_a_missing_band_is_reported(banded: FrictionLaw) -> None:
    record = replace(noisy(0), joint="axis_0")
    with pytest.raises(SimulationError, match="fit the model to logs"):
        model_of(TRUTH).predict_band([record])


def test_squares_of_the_bands_of_coupled_motors_add(banded: FrictionLaw) -> None:
    """The second motor carries friction of both joints; a reversed one swaps lower and upper."""
    logs = [replace(noisy(seed), joint=f"axis_{seed}") for seed in range(2)]
    for sign in (1.0, -1.0):
        coupling = Coupling(matrix=((1.0, 0.0), (sign, 1.0)))
        model = model_of(banded, banded, coupling=coupling)
        assert model.banded
        plain = model_of(banded, banded)
        moved = transform_records([replace(r, coupling=coupling) for r in logs])
        lower, upper = plain.predict_band(moved)
        torque = plain.predict(moved)
        below, above = (np.maximum(x, 0.0) for x in (torque - lower, upper - torque))
        second = (below, above) if sign > 0.0 else (above, below)
        ends = model.predict_band(logs)
        for end, way, own, other in zip(ends, (-1.0, 1.0), (below, above), second, strict=True):
            first = torque @ coupling.forward
            width = np.hypot(own[:, 0], other[:, 1])
            np.testing.assert_allclose(end[:, 0], first[:, 0] + way * width, atol=1e-12)
            np.testing.assert_allclose(end[:, 1], torque[:, 1] + way * own[:, 1], atol=1e-12)


def build_errors(band: Band, size: float, *, rows: int = 4000) -> tuple[np.ndarray, ...]:
    """Return speeds, loads and normal errors, of which `size` times the band contains 95 %."""
    rng = np.random.default_rng(0)
    dq = rng.uniform(-1.0, 1.0, rows)
    tau_load = rng.uniform(-20.0, 20.0, rows)
    parts = np.stack(shapes(dq, tau_load, band.slow_speed), axis=1)
    sizes = np.array([band.floor, band.slow, band.rest, band.fast, band.load])
    half_width = np.sqrt(parts @ sizes**2)
    return dq, tau_load, size * half_width / 1.96 * rng.standard_normal(rows)


@pytest.mark.parametrize("size", [0.8, 1.0, 1.5])
def test_errors_on_left_out_rows_decide_the_width(banded: FrictionLaw, size: float) -> None:
    """All parts of the band change alike, and the tail is that of these errors."""
    band = banded.band
    assert band is not None
    found = recalibrate_band(band, *build_errors(band, size))
    for name in ("floor", "slow", "rest", "fast", "load"):
        expected = size * getattr(band, name)
        assert getattr(found, name) == pytest.approx(expected, rel=0.03), name
    assert found.tail == pytest.approx(0.676, abs=0.05)  # of a normal distribution's quantiles
    assert (found.slow_speed, found.envelope) == (band.slow_speed, band.envelope)


def test_rests_few_rows_and_laws_that_diverge_leave_a_band_as_it_is(banded: FrictionLaw) -> None:
    band = banded.band
    assert band is not None
    dq, tau_load, errors = build_errors(band, 2.0)
    assert recalibrate_band(band, 0.9 * REST * np.sign(dq), tau_load, errors) == band
    assert recalibrate_band(band, dq[:99], tau_load[:99], errors[:99]) == band
    errors[7] = np.inf
    assert recalibrate_band(band, dq, tau_load, errors) == band
