"""ParFam edge cases: scales, bounds, short courses, options and the course of the search."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from joint_data import along, law, path

from hesr_model.fitting.joint_rows import JointRows
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.parfam import calibrate, evolve, laws, refine
from hesr_model.laws.parfam.calibrate import Cell
from hesr_model.laws.parfam.candidate import Candidate
from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.laws.parfam.laws import ParFamH
from hesr_model.laws.parfam.trial import Trial
from hesr_model.laws.rbfnn import NetworkInputs
from hesr_model.rigid_body.friction_record import FrictionRecord

TRUTH = law(
    "lugre", {}, sigma_0=600.0, sigma_1=1.0, sigma_2=4.0, F_c=8.0, F_s=11.0, v_s=0.1, tau_0=0.5
)


@pytest.fixture(scope="module")
def records() -> list[FrictionRecord]:
    return [along(TRUTH, path(k, seconds=4.0), noise=0.3, seed=k, log=str(k)) for k in range(2)]


@pytest.fixture(scope="module")
def features(records: list[FrictionRecord]) -> HysteresisFeatures:
    return HysteresisFeatures(
        rows=JointRows.from_records(records, coefficients=11), discretisation="exact"
    )


def candidate(**more: Any) -> Candidate:
    everything = {
        "g": "tanh", "alpha": 12.0, "beta": 25.0, "c": np.array([0.4, 2.0, 6.0, 0.1]),
        "theta": np.array([0.1, 0.8, -1.4, 0.05]), "gain": 5.0, "c_active": np.ones(4, bool),
        "theta_active": np.ones(4, bool), "cost": 1.0,
    }  # fmt: skip
    return Candidate(**(everything | more))


LINEAR = {"g": None, "gain": 0.0, "theta_active": np.zeros(4, bool)}


def test_a_candidate_without_a_unit_has_no_arguments() -> None:
    with pytest.raises(ValueError, match="candidate without a unit must"):
        candidate(g=None, gain=0.0)


# --- scales -----------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_the_geometric_guess_is_scale_free(features: HysteresisFeatures, size: float) -> None:
    samples = features.rows
    small = replace(features, rows=replace(samples, tau=size * samples.tau))
    assert calibrate.estimate_from_loop(small) == pytest.approx(
        calibrate.estimate_from_loop(features), rel=1e-9
    )


def test_arguments_do_not_depend_on_feature_size(features: HysteresisFeatures) -> None:
    """Holds down to a spread of 1e-12; below it a feature counts as constant."""
    x, tau = features.columns(12.0, 25.0)[::4], features.rows.tau[::4]
    small = x * [1.0, 1e-9, 1e-9, 1e-9]
    starts = evolve.starting_points(np.random.default_rng(0), 4, 4)
    [one] = evolve.search_arguments("tanh", x, x, tau, starts, 1)
    [other] = evolve.search_arguments("tanh", small, x, tau, starts, 1)
    np.testing.assert_allclose(other * [1.0, 1e-9, 1e-9, 1e-9], one, rtol=1e-5)
    np.testing.assert_allclose(
        calibrate._cubic_features(small), calibrate._cubic_features(x), rtol=1e-9
    )


def test_network_inputs_have_the_spread_of_their_features(features: HysteresisFeatures) -> None:
    slow = replace(features, rows=replace(features.rows, dq=1e-9 * features.rows.dq))
    found = NetworkInputs.from_features(slow, Cell(alpha=12.0, beta=25.0, cost=0.0))
    np.testing.assert_allclose(found.z.std(axis=0), 1.0, rtol=1e-9)


def test_the_papers_search_is_scale_free(
    features: HysteresisFeatures, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evolve, "HOPS", 0)
    x, tau = features.columns(12.0, 25.0)[::8], features.rows.tau[::8]
    cell = Cell(alpha=12.0, beta=25.0, cost=0.0)
    one = evolve.search_of_paper(cell, "tanh", x, tau, np.random.default_rng(1))
    small = x * [1.0, 1e-9, 1e-9, 1e-9]
    two = evolve.search_of_paper(cell, "tanh", small, 1e-9 * tau, np.random.default_rng(1))
    assert two.cost == pytest.approx(1e-18 * one.cost, rel=1e-3)


# --- bounds and short courses -----------------------------------------------------------------


@pytest.mark.parametrize("low", [False, True])
def test_a_start_at_a_bound_can_move_inside(features: HysteresisFeatures, low: bool) -> None:
    bounds = calibrate.bounds(features)
    alpha, beta = (b[0 if low else 1] for b in bounds)
    place = refine.Refinement(features, candidate(alpha=alpha, beta=beta)).pack()[:2]
    np.testing.assert_allclose(place, np.full(2, (-1.0 if low else 1.0) * 13.815509557935), 1e-9)


def test_ten_rows_of_a_course_give_the_settling_rate(features: HysteresisFeatures) -> None:
    course = np.exp(-np.arange(12.0))
    assert calibrate._settling_rate(features, [course[:9]]) == 0.0
    assert calibrate._settling_rate(features, [course[:10]]) > 0.0
    assert calibrate._settling_rate(features, []) == 0.0
    assert calibrate._settling_rate(features, [np.ones(12)]) == 0.0


def test_a_mean_course_is_as_long_as_half_of_the_reversals_allow(
    features: HysteresisFeatures,
) -> None:
    long, short = np.linspace(0.0, 3.0, 40), np.linspace(0.0, 3.0, 40)[:20]
    rate = calibrate._settling_rate
    assert rate(features, [long, short]) == pytest.approx(rate(features, [long]))
    assert rate(features, [long, short, short]) == pytest.approx(rate(features, [short]))


def test_short_logs_use_all_rows_for_a_steep_unit(
    records: list[FrictionRecord], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []
    arguments = evolve.search_arguments

    def told(g: str, features: np.ndarray, *more: Any, **also: Any) -> list[np.ndarray]:
        seen.append((g, len(features), also["limit"], also["keep"], len(more[2])))
        return arguments(g, features, *more, **also)

    monkeypatch.setattr(evolve, "search_arguments", told)
    laws.ParFamV(starts=2).fit(records, np.random.default_rng(0))
    rows = sum(len(r.t) for r in records)
    assert seen == [("tanh", rows, 2000.0, 3, 4), ("sin", rows, 12.0, 3, 4)]


# --- options of the estimator -----------------------------------------------------------------


def test_only_the_papers_search_needs_a_function() -> None:
    assert ParFamH(functions=()).functions == ()


@pytest.mark.parametrize("search", ["projection", "paper"])
def test_the_named_search_is_used(
    search: Any, records: list[FrictionRecord], monkeypatch: pytest.MonkeyPatch
) -> None:
    done = []
    for name in ("_evolve", "_search_like_paper"):
        monkeypatch.setattr(
            ParFamH, name, lambda *_, own=name: done.append(own) or [candidate(**LINEAR)]
        )
    ParFamH(search=search).fit(records, np.random.default_rng(0))
    assert done == ["_search_like_paper" if search == "paper" else "_evolve"]


@pytest.mark.parametrize(
    ("options", "memory", "tried"),
    [
        ({}, True, []),
        ({"units": 2}, True, ["unit"]),
        ({"denominator": True}, True, ["denominator"]),
        ({"units": 2, "denominator": True}, True, ["unit", "denominator"]),
        ({"units": 2, "denominator": True}, False, []),
    ],
)
def test_extensions_are_tried_on_request(
    options: dict[str, Any],
    memory: bool,
    tried: list[str],
    features: HysteresisFeatures,
    records: list[FrictionRecord],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    active = np.array([True, True, memory, memory])
    of = candidate(**LINEAR, c_active=active).law("parfam_h", "exact")
    seen: list[str] = []

    def with_unit(base: Trial, *_: object) -> list[Trial]:
        seen.append("unit")
        return [base]

    def changed(self: Trial, *_: object) -> Trial:
        seen.append("denominator")
        return self

    monkeypatch.setattr(laws, "add_unit", with_unit)
    monkeypatch.setattr(Trial, "change_structure", changed)
    found = ParFamH(**options)._enlarge_law(
        of, features, TrainedRange.from_records(records), np.random.default_rng(0)
    )
    assert seen == tried
    assert found is of


def test_an_extended_law_is_a_different_one(
    features: HysteresisFeatures, records: list[FrictionRecord], monkeypatch: pytest.MonkeyPatch
) -> None:
    of = candidate(**LINEAR).law("parfam_h", "exact")
    monkeypatch.setattr(laws, "extend_trial", lambda _, more, __: more[0])
    few = ParFamH(denominator=True)
    found = few._enlarge_law(
        of, features, TrainedRange.from_records(records), np.random.default_rng(0)
    )
    assert found.structure["denominator"] == ["dq", "h"]
    assert found.name == "parfam_h"


def test_reported_steps(
    records: list[FrictionRecord], features: HysteresisFeatures, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first half is the search, the second the rounds of the refinement."""
    told: list[float] = []
    for module in (laws, refine):
        monkeypatch.setattr(module, "step", lambda done, of: told.append(done / of))
    few = ParFamH(cells=2, starts=2, candidates=1, functions=("tanh", "sin"))
    found = few._evolve(features, np.random.default_rng(0))
    assert told == [0.0, 0.125, 0.25, 0.375]
    told.clear()
    monkeypatch.setattr(refine, "ROUNDS", ((2, 2), (2, 1)))
    refine.select(features, found, features.rows.folds, TrainedRange.from_records(records))
    assert [candidate.g for candidate in found] == [None, "tanh", "sin", "sin"]  # and an alias
    assert told == [0.5, 0.5625, 0.625, 0.6875, 0.75, 0.875]
