"""The verdict of a run and the marks in its tables: no more than the intervals support."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from containing import Containing, OneSentence

from cosim.report.tables.scores import errors
from cosim.study.scores import ORACLE, Comparison, LawScores, Ratios, compare
from cosim.study.study import LEFT_OUT
from cosim.study.verdict import (
    Separation,
    Verdict,
    _list_improvements,
    _list_weaknesses,
    describe_limits,
    find_separations,
    judge_run,
    read_verdict,
    write_verdict,
)
from fmu_src.friction.predictions import Records, predict_model
from hesr_model.audit.properties import EXPECTATIONS, JointProperties, Properties, PropertyResult
from hesr_model.errors import ArtifactError
from hesr_model.fitting.fit import fit, fit_joint
from hesr_model.forward.output_error import RefinementResult
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.inference.choice import JointChoice, LawChoice
from hesr_model.rigid_body.friction_record import FrictionRecord

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


def choose(*laws: str, ratio: float = 0.5) -> LawChoice:
    """A choice of laws by joint, of which the first is the base."""
    joints = tuple(
        JointChoice(
            law_name=law,
            reason="base" if law == laws[0] else "better",
            known="law",
            ratio=ratio,
            low=0.9 * ratio,
            high=1.1 * ratio,
            unexplained=0.2,
        )
        for law in laws
    )
    return LawChoice(base=laws[0], joints=joints, fold_count=5, seconds=100.0)


def judged(
    scores: Mapping[str, Comparison],
    models: Mapping[str, FrictionModel],
    trained: Records,
    tested: Records,
    **more: Any,
) -> Verdict:
    settings: dict[str, Any] = {
        "gear_ratio": False,
        "choice": choose(*["lugre"] * len(trained)),
    } | more
    return judge_run(
        scores, models, trained_records=trained, tested_records=tested, properties={}, **settings
    )


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
    assert text.startswith("Recommended: fmus/lugre.fmu (LuGre), for feed-forward: it has the ")
    assert "J1, J2: LuGre, 0.50 of the error" in text
    assert f"J1 {expected[0]:.0f} %, J2 {expected[1]:.0f} %." in text


def test_a_run_without_tests_says_nothing_of_one(scores, models, trained) -> None:
    found = judged({LEFT_OUT: scores["unseen"]}, models, trained, trained)
    assert not found.has_test
    assert found.limits == ()
    text = "\n".join(found.sentences)
    assert "Unexplained friction on" not in text
    assert "left out in turn" in text
    assert list(found.unexplained) == list(JOINTS)


def test_the_choice_decides_not_the_test(scores, models, trained, tested) -> None:
    """The test shows that another law is better, and the verdict says so."""
    found = judged(scores, models, trained, tested, choice=choose("stribeck", "stribeck"))
    assert found.laws == ("stribeck", "stribeck")
    for one in found.joints:
        assert (one.law, one.best, one.better) == ("stribeck", "lugre", ("lugre",))
    assert "On J1 'unseen' shows LuGre to be better." in found.limits


def test_a_verdict_recommends_improvements(scores, models, trained, tested) -> None:
    text = "\n".join(judged(scores, models, trained, tested).improve)
    assert "J1, J2: the test is faster" in text
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


@cache
def law_of(law: str) -> FrictionLaw:
    made = record("arm", peak=1.0, seed=3, load=2.0)
    return fit_joint(law, [made.rows(slice(0, 1000))], seed=0)


def model_of(law: str, joints: int, left_out: float = 1.0) -> FrictionModel:
    own = law_of(law)
    return FrictionModel(
        law=law,
        robot="r",
        joints=tuple(f"j{k}" for k in range(1, joints + 1)),
        laws=(own,) * joints,
        sample_time=0.01,
        left_out_rmse=(left_out,) * joints,
    )


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


def made(sizes: dict[str, list[float]], seconds: float = 100.0) -> Comparison:
    """Scores of torques whose errors are noise of given sizes [law][joint] on measured records."""
    count = len(next(iter(sizes.values())))
    rows = slice(0, round(100 * seconds))
    records = [[record(f"j{k}", peak=1.0, seed=k).rows(rows)] for k in range(1, count + 1)]
    rng = np.random.default_rng(5)
    predicted = {
        law: [
            [r.tau + rng.normal(0.0, size, len(r.tau)) for r in of]
            for of, size in zip(records, of_law, strict=True)
        ]
        for law, of_law in sizes.items()
    }
    return compare(records, predicted)


def test_joints_of_different_laws_are_named(trained) -> None:
    """Torques with errors of known sizes: the first law is better on J1 to J4."""
    sizes = {"lugre": [1.0] * 4 + [2.0] * 2, "lugre_load": [2.0] * 4 + [1.0] * 2}
    scores = made(sizes)
    seen = (TrainedRange.from_records(trained[0]),) * 6
    models = {law: replace(model_of(law, 6), trained=seen) for law in sizes}
    laws = ("lugre",) * 4 + ("lugre_load",) * 2
    records = trained[:1] * 6
    found = judged({"t": scores}, models, records, records, choice=choose(*laws))
    assert found.laws == laws
    assert (found.law, found.fmu) == ("recommended", "fmus/recommended.fmu")
    start = "Recommended: fmus/recommended.fmu (LuGre on J1, J2, J3, J4; LuGre+load on J5, J6), "
    assert found.sentences[0].startswith(start)
    lowest = [min(of.rmse[j] for of in scores.laws.values()) for j in range(6)]
    shares = [100 * e / std for e, std in zip(lowest, scores.tau_std, strict=True)]
    assert list(found.unexplained.values()) == pytest.approx(shares)
    assert found.limits == ()


def limits_of(scores: Comparison, *laws: str) -> list[str]:
    return list(describe_limits("'t'", list(find_separations(scores, laws))))


def test_no_test_of_a_day_is_advised() -> None:
    tied = {"best": "lugre", "tied": ("stribeck",), "seconds": 49190.0}
    joints = [Separation(detectable=None, **tied), Separation(detectable=(1.4, 58.7), **tied)]
    first, second, third = describe_limits("'t'", joints)
    assert first == OneSentence("'t'", "laws on J1", "differ too much")
    assert "40 to more than 100 %" in second
    assert third == OneSentence("of an hour", "10 %", "on J2")


def test_a_law_alone_is_not_a_short_test(models, tested) -> None:
    predicted = {"lugre": predict_model(models["lugre"], tested)}
    truth = [[r.tau + 0.0 for r in of_joint] for of_joint in tested]
    found = compare(tested, predicted | {ORACLE: truth})
    assert found.too_short == (False, False)
    assert limits_of(found, "lugre", "lugre") == []


def test_a_test_of_five_seconds_shows_nothing() -> None:
    scores = made({"stribeck": [1.0, 1.0], "lugre": [3.0, 3.0]}, seconds=5.0)
    assert scores.too_short == (True, True)
    (limit,) = limits_of(scores, "stribeck", "stribeck")
    assert limit == OneSentence("'t' is too short", "record at least 40 s")


def test_a_joint_that_a_test_is_too_short_for_is_named() -> None:
    scores = case(
        {"lugre": [1.0, 1.0], "stribeck": [2.0, 2.0]}, [("lugre",), ("lugre", "stribeck")]
    )
    scores = replace(scores, detectable=(scores.detectable[0], {}))
    (limit,) = limits_of(scores, "lugre", "lugre")
    assert "on J2; record at least 120 s" in limit


def test_twice_the_error_is_not_separated_by_a_test_that_cannot_show_it() -> None:
    rmse = {"lugre_load": [1.0, 1.0], "stribeck": [2.0, 2.0]}
    scores = case(rmse, [("lugre_load", "stribeck")] * 2, found=2.5)
    first, second = limits_of(scores, "lugre_load", "lugre_load")
    assert "from 1 law on J1, J2; it would show more than 100 %" in first
    assert "about 120 s" in second


def test_a_longer_test_is_advised_only_if_10_percent_would_not_show() -> None:
    rmse = {"lugre": [1.0, 1.0], "stribeck": [1.01, 1.5]}
    scores = case(rmse, [("lugre", "stribeck"), ("lugre",)], found=1.05)
    (limit,) = limits_of(scores, "lugre", "lugre")
    assert "from 1 law on J1; it would show 5 %" in limit


def test_twice_the_error_is_found_by_a_test_of_100_s() -> None:
    scores = made({"stribeck": [2.0, 2.0], "lugre": [1.0, 1.0]})
    assert scores.leading == (("lugre",), ("lugre",))
    assert limits_of(scores, "lugre", "lugre") == []
    assert limits_of(scores, "stribeck", "lugre") == [
        Containing("On J1 't' shows LuGre to be better")
    ]


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
    choice = choose("lugre", "lugre")
    found = judge_run(scores, models, choice, trained, tested, failed, gear_ratio=True)
    assert any(EXPECTATIONS[key].title in sentence for sentence in found.weak)


def test_the_separations_agree_with_the_scores(scores, models, trained, tested) -> None:
    """The scores alone decide: only this law leads on both joints."""
    found = judged(scores, models, trained, tested)
    assert found.limits == ()
    for one, of_joint in zip(found.joints, scores["unseen"].leading, strict=True):
        assert (one.best, *one.tied) == of_joint


def test_weaknesses_are_named_by_joint() -> None:
    none = (None,) * 4
    own = LawScores(
        rmse=(1.0, 1.0, 2.0, 1.0), rmse_reversal=(1.5, 1.51, 3.01, None), rmse_moving=none, r2=none
    )
    percent = {"a": 25.0, "b": 25.1, "c": 3.0, "d": 99.0}
    assert list(_list_weaknesses(own, percent, None)) == [
        Containing("Poorly modelled: J2, J4 (more than 25 %"),
        "Large errors near reversals: J2, J3.",
    ]
    assert (
        list(_list_weaknesses(replace(own, rmse_reversal=none), dict.fromkeys("abcd", 1.0), None))
        == []
    )


def rows(*, fast: int = 0, resting: int = 10, load: float = 1.0) -> FrictionRecord:
    """100 rows; some are faster than 1 rad/s, some rest."""
    dq = np.where(np.arange(100) % 2, 0.5, -0.5)
    dq[:resting], dq[100 - fast :] = 0.0, 1.5
    tau = np.linspace(-1.0, 1.0, 100)
    t = 0.01 * np.arange(100)
    return FrictionRecord(log="l", joint="a", t=t, dq=dq, q=0.0 * t, tau_load=load * tau, tau=tau)


@pytest.mark.parametrize(
    ("trained", "tested", "advice"),
    [
        ({}, {}, None),
        ({}, {"fast": 2}, None),
        ({}, {"fast": 3}, "J1: the test is faster"),
        ({"resting": 2}, {}, None),
        ({"resting": 1}, {}, "J1: hardly any standstill"),
        ({"load": 0.51}, {}, None),
        (
            {"load": 0.49},
            {},
            "J1: the load hardly changes",
        ),
        ({}, {"load": 1.01}, None),
        (
            {},
            {"load": 1.2},
            "J1: the load of the test",
        ),
    ],
)
def test_helpful_data_are_named(
    trained: dict[str, float], tested: dict[str, float], advice: str | None
) -> None:
    wide = TrainedRange(
        sample_time=0.01, dq=(-1.0, 1.0), q=(-1.0, 1.0), tau_load=(-1.0, 1.0), tau=(-1.0, 1.0)
    )
    model = replace(model_of("lugre_load", 1), trained=(wide,))
    known, new = [[rows(**trained)]], [[rows(**tested)]]  # type: ignore[arg-type]
    found = list(_list_improvements(model, known, new, gear_ratio=True))
    assert found == ([] if advice is None else [OneSentence(advice)])
    more = list(_list_improvements(model, known, new, gear_ratio=False))
    assert more == [*found, Containing("robot file to also fit motor")]


def refined(model: FrictionModel, ratio: float, *errors: float) -> RefinementResult:
    left_out = np.array([errors])
    body: Any = None  # unused
    return RefinementResult(body=body, model=model, ratio=ratio, before=left_out, left_out=left_out)


def test_a_verdict_names_the_law_for_simulation(scores, models, trained, tested) -> None:
    of_laws = {
        "lugre": refined(models["lugre"], 1.0, 2e-3, 8e-3),
        "stribeck": refined(models["stribeck"], 0.9, 1e-3, 4e-3),
    }
    found = judged(scores, models, trained, tested, refined=of_laws)
    assert found.simulation is not None
    assert found.simulation.errors == pytest.approx({"lugre": 4e-3, "stribeck": 2e-3})
    assert found.sentences[1] == Containing(
        "fmus/stribeck.fmu (Stribeck)", "0.50 times that of LuGre", "improved 1 of 2 laws"
    )


def test_a_verdict_without_left_out_windows_says_so(scores, models, trained, tested) -> None:
    of_laws = {law: refined(model, 1.0, np.nan) for law, model in models.items()}
    found = judged(scores, models, trained, tested, refined=of_laws)
    assert found.simulation is None
    assert any("too short to choose a law" in line for line in found.sentences)


@pytest.mark.parametrize(
    ("joints", "asked", "shown"), [(1, False, True), (1, True, False), (2, False, False)]
)
def test_output_error_is_suggested_for_one_joint(
    joints: int, asked: bool, shown: bool, trained: list[list[FrictionRecord]]
) -> None:
    records, seen = trained[:1] * joints, (TrainedRange.from_records(trained[0]),) * joints
    models = {"lugre": replace(model_of("lugre", joints), trained=seen)}
    scores = made({"lugre": [1.0] * joints})
    found = judged({"t": scores}, models, records, records, refined={} if asked else None)
    said = 'simulation, add refinement = "output_error"'
    assert any(said in sentence for sentence in found.sentences) == shown
