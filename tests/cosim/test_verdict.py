"""The verdict of a run and the marks in its tables: no more than the intervals support."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from registry_models import models_of_registry

from cosim.report.tables.scores import errors
from cosim.study.scores import ORACLE, Comparison, LawScores, Ratios, compare, predict_model
from cosim.study.verdict import (
    Verdict,
    limits,
    read_verdict,
    recommend,
    separation,
    verdict,
    write_verdict,
)
from hesr_model.audit.expectations import EXPECTATIONS
from hesr_model.audit.properties import JointProperties, Properties, PropertyResult
from hesr_model.errors import ArtifactError
from hesr_model.fitting.fit import fit
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.residual import FrictionRecord

JOINTS = ("base", "arm")


def record(joint: str, *, peak: float, seed: int, load: float = 0.0) -> FrictionRecord:
    """Friction with a memory of position, beyond the reach of a static law."""
    t = np.arange(10_000) * 0.01
    dq = peak * (np.sin(1.7 * t + seed) + 0.3 * np.sin(6.1 * t))
    q = np.cumsum(dq) * 0.01
    held = np.zeros(len(t))
    for k in range(1, len(t)):
        held[k] = np.clip(held[k - 1] + (q[k] - q[k - 1]) / 0.02, -1.0, 1.0)
    noise = np.random.default_rng(seed).normal(0.0, 0.2, len(t))
    tau = 6.0 * held + 2.0 * dq + noise
    tau_load = load * np.sin(0.3 * t)
    return FrictionRecord(log=f"l{seed}", joint=joint, t=t, dq=dq, q=q, tau_load=tau_load, tau=tau)


@pytest.fixture(scope="module")
def trained() -> list[list[FrictionRecord]]:
    return [[record(joint, peak=1.0, seed=1)] for joint in JOINTS]


@pytest.fixture(scope="module")
def tested() -> list[list[FrictionRecord]]:
    return [[record(joint, peak=1.5, seed=2)] for joint in JOINTS]


@pytest.fixture(scope="module")
def models(trained: list[list[FrictionRecord]]) -> dict[str, FrictionModel]:
    return {law: fit(law, [of_joint[0] for of_joint in trained]) for law in ("stribeck", "lugre")}


@pytest.fixture(scope="module")
def scores(
    models: dict[str, FrictionModel], tested: list[list[FrictionRecord]]
) -> dict[str, Comparison]:
    predicted = {law: predict_model(model, tested) for law, model in models.items()}
    truth = [[r.tau + 0.0 for r in of_joint] for of_joint in tested]
    return {"unseen": compare(tested, predicted | {ORACLE: truth})}


def judged(scores, models, trained, tested, **more: bool) -> Verdict:  # type: ignore[no-untyped-def]
    settings = {"gear_ratio": False} | more
    return verdict(scores, models, trained, tested, {}, **settings)


def test_a_verdict_names_the_fmu_the_reason_and_the_residual(
    scores, models, trained, tested
) -> None:
    found = judged(scores, models, trained, tested)
    assert (found.law, found.fmu, found.test) == ("lugre", "fmus/lugre.fmu", "unseen")
    of_law = scores["unseen"].laws["lugre"].rmse
    expected = 100 * np.divide(of_law, scores["unseen"].tau_std)
    np.testing.assert_allclose(list(found.unexplained.values()), expected)
    assert list(found.unexplained) == list(JOINTS)
    text = "\n".join(found.sentences)
    assert text.startswith(
        "Recommended: fmus/lugre.fmu (LuGre): on 2 of 2 joints no other law is significantly better"
    )
    assert f"J1 {expected[0]:.0f} %, J2 {expected[1]:.0f} %." in text


def test_a_verdict_recommends_improvements(scores, models, trained, tested) -> None:
    text = "\n".join(judged(scores, models, trained, tested).improve)
    assert "J1, J2: the test is faster than the training logs" in text
    assert "payload" in text
    assert "gear_ratio" in text
    heavy = [[replace(of_joint[0], tau_load=9 * np.sin(of_joint[0].t))] for of_joint in trained]
    same = judged(scores, models, heavy, trained, gear_ratio=True).improve
    assert not any("faster" in s or "payload" in s or "gear_ratio" in s for s in same)
    resting = [
        [replace(heavy[0][0], dq=np.where(heavy[0][0].t < 3, 0.0, heavy[0][0].dq))],
        heavy[1],
    ]
    said = judged(scores, models, resting, trained, gear_ratio=True).improve
    assert not any("rests" in s and "J1" in s for s in said)


def test_laws_without_significant_difference_lead_together(tested) -> None:
    truth = [[r.tau for r in of_joint] for of_joint in tested]
    rng = np.random.default_rng(1)

    def off(size: float) -> list[list[np.ndarray]]:
        return [[tau + rng.normal(0.0, size, len(tau)) for tau in of] for of in truth]

    found = compare(tested, {"a": off(1.0), "b": off(1.0), "c": off(3.0)})
    assert [set(of_joint) for of_joint in found.leading] == [{"a", "b"}] * 2
    rows = errors("unseen", found).rows
    assert [row.head for row in rows[1:]][-1] == "c"
    assert not any(cell.best for row in rows for cell in row.cells)
    clear = compare(tested, {"c": off(3.0), "a": off(1.0)})
    assert clear.leading == (("a",), ("a",))
    rows = errors("unseen", clear).rows
    assert [row.head for row in rows[1:]] == ["a", "c"]
    assert [cell.best for cell in rows[1].cells] == [True, True]
    old = replace(clear, leading=())
    assert not any(cell.best for cell in errors("unseen", old).rows[1].cells)


def test_joints_that_a_law_explains_badly_are_named(scores, models, trained, tested) -> None:
    whole = scores["unseen"]
    bad = replace(whole, tau_std=tuple(0.01 * s for s in whole.tau_std))
    weak = judged({"unseen": bad}, models, trained, tested).weak
    assert any("Poorly modelled: J1, J2" in s for s in weak)


def test_a_verdict_is_read_back(scores, models, trained, tested, tmp_path: Path) -> None:
    assert read_verdict(tmp_path) is None
    found = judged(scores, models, trained, tested)
    write_verdict(tmp_path, found)
    assert read_verdict(tmp_path) == found
    (tmp_path / "verdict.json").write_text('{"format": "hesr-verdict-1"}', encoding="utf-8")
    with pytest.raises(ArtifactError, match=r"verdict\.json"):
        read_verdict(tmp_path)


# --- cases ------------------------------------------------------------------------------------


registered = cache(lambda: list(models_of_registry()))


def case(
    rmse: dict[str, list[float]], leading: list[tuple[str, ...]], found: float | None = 1.1
) -> Comparison:
    """Scores with given errors [law][joint] and laws that the test cannot distinguish."""
    joints = [f"j{k}" for k in range(1, len(leading) + 1)]
    none = (None,) * len(joints)
    return Comparison(
        joints=tuple(joints),
        tau_std=(10.0,) * len(joints),
        laws={
            law: LawScores(rmse=tuple(of), rmse_reversal=none, rmse_moving=none, r2=none)
            for law, of in rmse.items()
        },
        ratios=Ratios(reference="lugre", laws={}),
        leading=tuple(leading),
        detectable=tuple(
            {law: found for law in rmse if law != of_joint[0]} if found else {}
            for of_joint in leading
        ),
        seconds=(120.0,) * len(joints),
    )


def model_of(law: str, joints: int, left_out: float = 1.0) -> FrictionModel:
    own = next(model for model in registered() if model.law == law).laws[0]
    return FrictionModel(
        law=law,
        robot="r",
        joints=tuple(f"j{k}" for k in range(1, joints + 1)),
        laws=(own,) * joints,
        sample_time=0.01,
        left_out_rmse=(left_out,) * joints,
    )


def test_the_simpler_of_two_equal_laws_is_recommended() -> None:
    """Equal to four decimals: the law without load wins, although its error is larger."""
    rmse = {"lugre_load": [1.00001, 1.0], "lugre": [1.00002, 1.00003], "stribeck": [2.0, 2.1]}
    scores = case(rmse, [("lugre_load", "lugre"), ("lugre_load", "lugre")])
    law, why = recommend(scores, {law: model_of(law, 2) for law in rmse})
    assert law == "lugre"
    assert "on 2 of 2 joints no other law is significantly better" in why
    assert "the 2 such laws within 5 %" in why
    assert "simplest (inputs v)" in why


def test_a_law_better_on_two_of_six_joints_is_named_for_them() -> None:
    rmse = {"lugre": [1.0] * 6, "lugre_load": [1.3, 1.3, 1.3, 1.3, 0.5, 0.5]}
    leading = [("lugre",)] * 4 + [("lugre_load",)] * 2
    law, why = recommend(case(rmse, leading), {law: model_of(law, 6) for law in rmse})
    assert law == "lugre"
    assert "on 4 of 6 joints" in why
    assert "LuGre+load is better on J5, LuGre+load is better on J6" in why


def test_the_joints_named_are_those_where_the_chosen_law_is_worse() -> None:
    """Each law leads on one joint; the chosen one is worse where the other leads."""
    rmse = {"lugre_load": [1.0, 1.3], "lugre": [1.3, 1.0]}
    scores = case(rmse, [("lugre_load",), ("lugre",)])
    law, why = recommend(scores, {law: model_of(law, 2) for law in rmse})
    assert law == "lugre"
    assert "(LuGre+load is better on J1)" in why


def test_a_law_alone_is_not_a_short_test(scores, models, tested) -> None:
    predicted = {"lugre": predict_model(models["lugre"], tested)}
    truth = [[r.tau + 0.0 for r in of_joint] for of_joint in tested]
    found = compare(tested, predicted | {ORACLE: truth})
    assert found.too_short == (False, False)
    law, why = recommend(found, {"lugre": models["lugre"]})
    assert (law, "too short" in why) == ("lugre", False)


def test_a_short_test_decides_nothing() -> None:
    """The law with the lowest error on left-out training logs, not on the test, is taken."""
    rmse = {"stribeck": [1.0], "lugre": [1.2]}
    scores = case(rmse, [("stribeck", "lugre")], found=None)
    models = {"stribeck": model_of("stribeck", 1, 2.0), "lugre": model_of("lugre", 1, 1.5)}
    law, why = recommend(scores, models)
    assert (law, "too short" in why, "left-out training logs" in why) == ("lugre", True, True)
    (limit,) = limits("'five seconds'", law, tuple(separation(scores)))
    assert limit == "'five seconds' is too short to compare laws; record at least 120 s."


def test_twice_the_error_is_not_recommended_even_if_the_test_cannot_show_it() -> None:
    rmse = {"lugre_load": [1.0, 1.0], "stribeck": [2.0, 2.0]}
    scores = case(rmse, [("lugre_load", "stribeck")] * 2, found=2.5)
    law, why = recommend(scores, {law: model_of(law, 2) for law in rmse})
    assert law == "lugre_load"
    assert "it alone is within 5 % of the lowest error" in why
    first, second = limits("'t'", law, tuple(separation(scores)))
    assert "1 law on J1 (150 %), 1 law on J2 (150 %)" in first
    assert "about 120 s" in second


def test_a_failed_check_of_all_laws_is_stated(scores, models, trained, tested) -> None:
    key = next(iter(EXPECTATIONS))
    failed = {
        law: Properties(
            law=law,
            robot="r",
            tau_load=0.0,
            joints=tuple(
                JointProperties(
                    joint=joint,
                    speed=1.0,
                    level=1.0,
                    deflection=1.0,
                    inertia=None,
                    findings={
                        k: PropertyResult(verdict="fail" if k == key else "pass", reason="")
                        for k in EXPECTATIONS
                    },
                )
                for joint in JOINTS
            ),
        )
        for law in models
    }
    found = verdict(scores, models, trained, tested, failed, gear_ratio=True)
    assert any(EXPECTATIONS[key].title in sentence for sentence in found.weak)


def test_the_reason_agrees_with_the_scores(scores, models, trained, tested) -> None:
    """The scores alone decide: only this law leads on both joints."""
    found = judged(scores, models, trained, tested)
    assert all(found.law in of_joint for of_joint in scores["unseen"].leading)
    others = set(models) - {found.law}
    assert not any(law in of_joint for law in others for of_joint in scores["unseen"].leading)
    assert "which holds for this law alone" in found.why
    assert found.limits == ()
    for one, of_joint in zip(found.joints, scores["unseen"].leading, strict=True):
        assert (one.best, *one.tied) == of_joint
