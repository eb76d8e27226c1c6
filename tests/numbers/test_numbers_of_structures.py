"""Structures of the symbolic family as separable problems, and the decisions of estimators."""

import numpy as np
import pytest
from unchanged import Unchanged

from hesr_model.laws.parfam import family, trial
from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.laws.parfam.laws import ParFamH, ParFamHX, ParFamV
from hesr_model.rigid_body.friction_record import FrictionRecord

STRUCTURES = {
    "paper": {"linear": ["1", "dq", "h", "dh"], "units": []},
    "generalised": {
        "linear": ["1", "dq", "h", "dh", "h_load", "h_bump"], "units": [], "state": "generalised",
    },
    "bristle": {"linear": ["1", "dq", "h", "dh"], "units": [], "state": "bristle"},
    "unit": {
        "linear": ["dq", "h"], "units": [{"g": "tanh", "arguments": ["1", "dq", "h", "dh"]}],
        "denominator": ["dq", "h"],
    },
}  # fmt: skip


@pytest.mark.parametrize("name", STRUCTURES)
def test_a_structure_as_a_problem(
    name: str, exact: HysteresisFeatures, unchanged: Unchanged
) -> None:
    structure = STRUCTURES[name]
    problem = trial.pose(structure, exact.rows)
    middle = problem.bounds.mean(axis=1) + 0.1 * np.ptp(problem.bounds, axis=1)
    near = trial.Trial(structure=structure, problem=problem, point=middle)
    more = near.change_structure({**structure, "linear": structure["linear"][:3]}, {})
    moved = problem.polish(middle, evaluations=2)
    unchanged(
        {
            "bounds": problem.bounds.tolist(),
            "numbers": problem.name_numbers(middle),
            "values": near.law().values,
            "left out": trial.cross_validate(near),
            "of others": more.problem.name_numbers(more.point).get("kappa", 0.0),
            "moved": moved,
            "solved": problem.solve(moved),
        },
        rtol=1e-3,
    )


def test_an_additional_unit(exact: HysteresisFeatures, unchanged: Unchanged) -> None:
    structure = STRUCTURES["paper"]
    problem = trial.pose(structure, exact.rows)
    base = trial.Trial(
        structure=structure, problem=problem, point=problem.point({"alpha": 12.0, "beta": 25.0})
    )
    features = exact.columns(12.0, 25.0)
    more = trial.add_unit(base, features, ["tanh", "sin"], 4, np.random.default_rng(2))
    costs = [trial.cross_validate(t) for t in (base, *more)]
    unchanged({"costs": costs, "chosen": trial.choose([base, *more], 0.05).structure}, rtol=0.05)
    assert all(t.structure["units"][0]["arguments"] == list(family.FEATURES) for t in more)


def test_later_extensions_must_gain(monkeypatch: pytest.MonkeyPatch) -> None:
    costs = {"base": 1.0, "barely": 0.96, "enough": 0.94}
    trials = [trial.Trial(structure={"is": n}, problem=None, point=np.zeros(0)) for n in costs]
    monkeypatch.setattr(trial, "cross_validate", lambda t: costs[t.structure["is"]])
    assert trial.choose(trials[:2], 0.05) is trials[0]
    assert trial.choose(trials, 0.05) is trials[2]


# --- estimators -------------------------------------------------------------------------------


def test_the_starts_of_the_third_stage(exact: HysteresisFeatures, unchanged: Unchanged) -> None:
    few = ParFamH(cells=2, starts=4, candidates=2, functions=("tanh", "sin"))
    *found, alias1, alias2 = few._evolve(exact, np.random.default_rng(0))
    assert [k.g for k in found] == [None, None, "tanh", "tanh", "sin", "sin"]
    assert [(k.g, k.alpha) for k in (alias1, alias2)] == [("sin", k.alpha) for k in found[4:]]
    geometric = ParFamH(search="paper", functions=("tanh",))._search_like_paper(
        exact, np.random.default_rng(0)
    )
    unchanged(
        {
            "cost": [k.cost for k in found],
            "alpha": [k.alpha for k in found],
            "beta": [k.beta for k in found],
            "paper": [[k.alpha, k.beta] for k in geometric],
        },
        rtol=1e-4,
    )


def test_a_law_of_velocity(records: list[FrictionRecord], unchanged: Unchanged) -> None:
    found = ParFamV(starts=3).fit(records, np.random.default_rng(0))
    unchanged(found.values, rtol=1e-2)


@pytest.mark.parametrize("state", ["bristle", "generalised", "paper"])
def test_terms_kept_by_a_state(state: str, exact: HysteresisFeatures, unchanged: Unchanged) -> None:
    of = ParFamHX()
    linear = [x for x in of.linear if state != "bristle" or x != "h_bump"]
    structure = {"linear": linear, "units": [], "state": state}
    problem = trial.pose(structure, exact.rows)
    middle = problem.bounds.mean(axis=1)
    found = of._remove_useless_terms(
        trial.Trial(structure=structure, problem=problem, point=middle)
    )
    kept = [linear.index(x) for x in found.structure["linear"]]
    unchanged({"kept": kept, "cost": found.problem.solve(found.point)[1]}, rtol=1e-2)
