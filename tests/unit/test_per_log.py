"""Day offsets are estimated and removed: the law is that of the mean log."""

from dataclasses import replace

import numpy as np
import pytest

from hesr_model.fitting.days import (
    LogNuisances,
    add_fitted_nuisances,
    estimate_nuisances,
    remove_nuisances,
)
from hesr_model.fitting.fit import fit_models
from hesr_model.rigid_body.friction_record import FrictionRecord

LEVELS, OFFSETS = (0.8, 1.0, 1.2), (1.5, 0.0, -1.5)


def record(k: int, *, part: int = 0) -> FrictionRecord:
    t = np.arange(2000) * 0.01
    dq = np.sin(1.3 * t + k + part) + 0.4 * np.sin(4.1 * t + part)
    rng = np.random.default_rng(10 * k + part)
    tau = LEVELS[k] * (6.0 * np.tanh(dq / 0.02) + 3.0 * dq) + OFFSETS[k]
    tau += rng.normal(0.0, 0.2, len(t))
    return FrictionRecord(
        log=f"day{k}", joint="arm", t=t, dq=dq, q=np.cumsum(dq) * 0.01, tau_load=0 * t, tau=tau
    )


@pytest.fixture
def records() -> list[FrictionRecord]:
    return [record(0), record(1), record(1, part=1), record(2)]


def test_day_levels_and_offsets_are_found(records: list[FrictionRecord]) -> None:
    own = estimate_nuisances(records, ("offset", "level"))
    assert list(own) == ["day0", "day1", "day2"]
    np.testing.assert_allclose([o.level for o in own.values()], LEVELS, atol=0.01)
    np.testing.assert_allclose([o.offset for o in own.values()], OFFSETS, atol=0.05)
    rows = np.array([2000, 4000, 2000]) / 8000
    assert rows @ [o.level for o in own.values()] == pytest.approx(1.0, abs=1e-12)
    assert rows @ [o.offset for o in own.values()] == pytest.approx(0.0, abs=1e-12)
    only = estimate_nuisances(records, ("offset",))
    assert [o.level for o in only.values()] == [1.0, 1.0, 1.0]
    np.testing.assert_allclose([o.offset for o in only.values()], OFFSETS, atol=0.1)
    level = estimate_nuisances(records, ("level",))
    assert [o.offset for o in level.values()] == [0.0, 0.0, 0.0]


def test_a_single_log_has_no_day_offset() -> None:
    assert estimate_nuisances([record(2), record(2, part=1)], ("offset", "level")) == {
        "day2": LogNuisances(level=1.0, offset=0.0)
    }
    assert estimate_nuisances([record(0), record(1)], ()) == {
        "day0": LogNuisances(),
        "day1": LogNuisances(),
    }


def test_without_day_offsets_the_law_is_that_of_the_mean_log(records: list[FrictionRecord]) -> None:
    settings = {"robot": "r", "seed": 0, "workers": 1}
    models = {
        per_log: fit_models(["stribeck"], [records], per_log=per_log, **settings)["stribeck"]  # type: ignore[arg-type]
        for per_log in ((), ("offset", "level"))
    }
    plain, own = (model.training_rmse[0] for model in models.values())
    assert own < 0.3
    assert plain > 3 * own
    said = models["offset", "level"].provenance["per_log"]["arm"]["day0"]
    assert said["level"] == pytest.approx(0.8, abs=0.01)
    assert "per_log" not in models[()].provenance
    blind = models["offset", "level"].predict([replace(record(1), log="new")])[:, 0]
    assert np.sqrt(np.mean((blind - record(1).tau) ** 2)) < 0.3


def test_a_prediction_with_day_offsets_uses_the_measured_torque(
    records: list[FrictionRecord],
) -> None:
    mean = [6.0 * np.tanh(r.dq / 0.02) + 3.0 * r.dq for r in records]
    fitted = add_fitted_nuisances(mean, records, ("offset", "level"))
    for torque, found in zip(fitted, records, strict=True):
        assert np.sqrt(np.mean((torque - found.tau) ** 2)) < 0.21
    shifted = add_fitted_nuisances(mean, records, ("offset",))
    np.testing.assert_allclose(shifted[0] - mean[0], 1.5, atol=0.15)
    bare = remove_nuisances(records, estimate_nuisances(records, ("offset", "level")))
    np.testing.assert_allclose(np.std(bare[0].tau - mean[0]), 0.25, atol=0.03)
