"""Sentences on the choice of laws say what the numbers show, in at most 25 words."""

from itertools import product
from typing import Any

import pytest
from containing import Containing

from cosim.report.tables.scores import recommendation
from cosim.report.tables.table import title
from cosim.study.verdict import describe_choice, is_worse, state_rule
from hesr_model.inference.choice import CONSTANT, NONE, PLAIN, JointChoice, LawChoice

MAX_WORDS = 25


def make_joint(law_name: str = "parfam_s", **values: Any) -> JointChoice:
    settings: dict[str, Any] = {
        "reason": "base",
        "known": "law",
        "ratio": 0.81,
        "low": 0.74,
        "high": 0.89,
        "unexplained": 0.2,
    }
    return JointChoice(law_name=law_name, **settings | values)


def make_choice(*joints: JointChoice, base: str = "parfam_s", **values: Any) -> LawChoice:
    return LawChoice(base=base, joints=joints, **{"fold_count": 5, "seconds": 14.0} | values)


def describe(*joints: JointChoice, **values: Any) -> list[str]:
    return list(describe_choice(make_choice(*joints, **values)))


def test_joints_of_one_class_share_a_sentence_with_the_range_of_their_ratios() -> None:
    single, *_ = describe(make_joint())
    assert single == Containing("J1: ParFam-S, 0.81 (0.74 to 0.89) of", "Coulomb + viscous")
    pair = describe(make_joint(), make_joint(ratio=0.62, low=0.5, high=0.7))
    assert pair == [
        Containing("J1, J2: ParFam-S, 0.62 to 0.81 of", "Coulomb + viscous"),
        Containing("on 5 parts", "14 s in all", "each left out"),
    ]
    other = make_joint(PLAIN, reason="better", known="level", ratio=1.0, low=1.0, high=1.0)
    assert describe(make_joint(), other, make_joint()) == [
        Containing("J1, J3:"),
        Containing("J2:"),
        Containing("on 5 parts"),
    ]


@pytest.mark.parametrize(
    ("joint", "parts"),
    [
        (
            make_joint(known="level", ratio=1.01, low=0.93, high=1.1),
            ("do not tell ParFam-S from", "1.01 (0.93 to 1.10)", "the law of all joints."),
        ),
        (
            make_joint(known="level", ratio=1.1, low=1.04, high=1.16),
            ("ParFam-S has 1.10 (1.04 to 1.16) of", "the law of all joints."),
        ),
        (
            make_joint(PLAIN, reason="exploded", known="level", replaced="lugre", worst_fold=9.0),
            ("LuGre explodes", "(9 times", "Coulomb + viscous is used."),
        ),
        (
            make_joint(CONSTANT, reason="unexplained", known="nothing", replaced="parfam_s"),
            ("ParFam-S does not predict better", "no friction model is recommended. Record"),
        ),
        (
            make_joint(NONE, reason="unexplained", known="nothing", replaced=CONSTANT),
            ("no law predicts clearly better", "no friction model is recommended. Record"),
        ),
        (
            make_joint(reason="short", known="nothing", ratio=None, low=None, high=None),
            ("does not tell laws apart", "ParFam-S, the law of all joints, is used."),
        ),
        (
            make_joint(PLAIN, reason="better", known="level", ratio=1.0, low=1.0, high=1.0),
            ("Coulomb + viscous, better than ParFam-S on", "two standard errors."),
        ),
        (
            make_joint(CONSTANT, reason="better", known="level", ratio=0.99, low=0.9, high=1.1),
            (f"{title(CONSTANT)}, better than ParFam-S on", "two standard errors."),
        ),
    ],
)
def test_each_class_of_joints_has_its_sentence(joint: JointChoice, parts: tuple[str, ...]) -> None:
    assert describe(make_joint(), joint)[1] == Containing("J2: ", *parts)


def test_joints_above_and_below_coulomb_and_viscous_friction_are_told_apart() -> None:
    better = make_joint(known="level", ratio=0.99, low=0.9, high=1.1)
    worse = make_joint(known="level", ratio=1.2, low=1.1, high=1.3)
    assert not is_worse(better)
    assert is_worse(worse)
    first, second, _ = describe(better, worse)
    assert "J1: the left-out rows do not tell" in first
    assert "J2: ParFam-S has 1.20" in second


def test_one_joint_has_no_law_of_all_joints() -> None:
    text, _ = describe(make_joint(known="level", ratio=1.01, low=0.93, high=1.1))
    assert text.endswith("it is used nevertheless.")
    plain = make_joint(PLAIN, known="level", ratio=1.0, low=1.0, high=1.0)
    text, _ = describe(plain, base=PLAIN)
    assert text == Containing("J1: Coulomb + viscous;", "not better")


def test_logs_without_motion_are_not_said_to_be_judged() -> None:
    nothing = make_joint(PLAIN, reason="short", known="nothing", ratio=None, low=None, high=None)
    assert describe(nothing, nothing, base=PLAIN) == [
        Containing("J1, J2: the motion does not tell", "; Coulomb + viscous is used.")
    ]
    assert "do not tell laws apart" in state_rule(make_choice(nothing, base=PLAIN))


@pytest.mark.parametrize(
    ("choice", "parts"),
    [
        (make_choice(make_joint()), ("it has the lowest mean",)),
        (
            make_choice(make_joint(), guaranteed="hx"),
            ("passivity is proven", f"{title('hx')} is not better"),
        ),
        (
            make_choice(make_joint(), make_joint("lugre", reason="better")),
            ("ParFam-S has the lowest mean", "exceptions"),
        ),
        (
            make_choice(make_joint(PLAIN), base=PLAIN, is_short=True, seconds=5.0),
            ("of 5 s of one joint", "too short"),
        ),
    ],
)
def test_the_rule_that_decided_is_stated(choice: LawChoice, parts: tuple[str, ...]) -> None:
    """The base of a short log of one joint was not chosen by its error."""
    assert state_rule(choice) == Containing(*parts)


@pytest.mark.parametrize(("seconds", "text"), [(4.0, "4 s"), (12.34, "12 s"), (1234.5, "1234 s")])
def test_durations_are_round(seconds: float, text: str) -> None:
    assert f", {text} in all" in describe(make_joint(), seconds=seconds)[-1]


def test_no_sentence_has_more_than_25_words() -> None:
    reasons = ("base", "better", "exploded", "unexplained", "short")
    laws = ("parfam_s", PLAIN, CONSTANT, "lugre_passive")
    cases = product(reasons, ("law", "level", "nothing"), laws, (0.9, 1.1), (1, 2, 6))
    for reason, known, law_name, low, count in cases:
        joint = make_joint(
            law_name,
            reason=reason,
            known=known,
            low=low,
            replaced="lugre_passive",
            worst_fold=12.345,
        )
        choice = make_choice(*[joint] * count)
        for text in (*describe_choice(choice), state_rule(choice)):
            for sentence in text.removesuffix(".").split(". "):
                assert len(sentence.split()) <= MAX_WORDS, sentence


def test_the_table_has_the_figures_of_each_joint() -> None:
    nothing = make_joint(
        reason="short", known="nothing", ratio=None, low=None, high=None, unexplained=None
    )
    table = recommendation(make_choice(make_joint(proven=True), nothing), None)
    rows = [[row.head, *(cell.text for cell in row.cells)] for row in table.rows]
    assert rows == [
        ["J1", "ParFam-S", "0.81 (0.74 to 0.89)", "20 %", "proven", "not checked"],
        ["J2", "ParFam-S", "–", "–", "not proven", "not checked"],
    ]
