"""What a run comes to, in words, and the marks in its tables: no more than the intervals say."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cosim.report.tables.scores import errors
from cosim.report.tables.table import TableCell
from cosim.study.scores import ORACLE, Comparison, compare, predict_model
from cosim.study.verdict import Verdict, read_verdict, verdict, write_verdict
from hesr_model.errors import ArtifactError
from hesr_model.fitting.fit import fit
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.residual import FrictionRecord

JOINTS = ("base", "arm")


def record(joint: str, *, peak: float, seed: int, load: float = 0.0) -> FrictionRecord:
    """Friction with a memory of position, which a static law cannot hold."""
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


def test_it_says_which_fmu_why_and_what_is_left(scores, models, trained, tested) -> None:
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


def test_it_says_what_would_improve_it(scores, models, trained, tested) -> None:
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


def test_laws_that_chance_may_order_lead_together(tested) -> None:
    truth = [[r.tau for r in of_joint] for of_joint in tested]
    rng = np.random.default_rng(1)

    def off(size: float) -> list[list[np.ndarray]]:
        return [[tau + rng.normal(0.0, size, len(tau)) for tau in of] for of in truth]

    found = compare(tested, {"a": off(1.0), "b": off(1.0), "c": off(3.0)})
    assert [set(of_joint) for of_joint in found.leading] == [{"a", "b"}] * 2
    rows = errors("unseen", found).rows
    assert [row.head for row in rows[1:]][-1] == "c"
    assert not any(cell.best for row in rows for cell in row.cells if isinstance(cell, TableCell))
    clear = compare(tested, {"c": off(3.0), "a": off(1.0)})
    assert clear.leading == (("a",), ("a",))
    rows = errors("unseen", clear).rows
    assert [row.head for row in rows[1:]] == ["a", "c"]
    assert [cell.best for cell in rows[1].cells] == [True, True]  # type: ignore[union-attr]
    old = replace(clear, leading=())
    assert not any(cell.best for cell in errors("unseen", old).rows[1].cells)  # type: ignore[union-attr]


def test_a_law_that_explains_little_is_called_weak(scores, models, trained, tested) -> None:
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
