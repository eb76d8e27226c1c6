"""Checks of logs state nothing by themselves, and know no speed, travel or torque of their own."""

import ast
import re
from pathlib import Path

import pytest

import hesr_model.health
from hesr_model.health.referee import Hypothesis

HEALTH = Path(hesr_model.health.__file__).parent
CHECKS = sorted(
    path.stem for path in HEALTH.glob("*.py") if path.stem not in ("__init__", "referee")
)
STATEMENTS = {"Finding", "build_joint_finding", "caution"}
UNIT = re.compile(r"\[[^\]]*\b(rad/s|m/s|N\.m|N|A)\b[^\]]*\]")
"""Units that a threshold must not have: those of speeds and torques."""


@pytest.mark.parametrize("module", CHECKS)
def test_only_the_referee_makes_statements(module: str) -> None:
    tree = ast.parse((HEALTH / f"{module}.py").read_text(encoding="utf-8"))
    calls = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
    assert not {call.id for call in calls if isinstance(call, ast.Name)} & STATEMENTS


@pytest.mark.parametrize("module", CHECKS)
def test_no_threshold_is_a_speed_or_a_torque(module: str) -> None:
    """A number that is assigned at the top of a module, with a unit in its comment."""
    constants = [
        line
        for line in (HEALTH / f"{module}.py").read_text(encoding="utf-8").splitlines()
        if re.match(r"_?[A-Z][A-Z_]+ = ", line) and UNIT.search(line)
    ]
    assert constants == []


def test_a_hypothesis_holds_words_and_trials_only() -> None:
    assert {field: str(kind) for field, kind in Hypothesis.__annotations__.items()} == {
        **dict.fromkeys(["check", "joint", "observation", "remedy", "record"], "<class 'str'>"),
        "severity": str(Hypothesis.__annotations__["severity"]),
        "trials": "tuple[hesr_model.health.referee.Race | hesr_model.health.referee.Statistic, "
        "...]",
        **dict.fromkeys(["contradictions", "further_joints", "logs"], "tuple[str, ...]"),
        "changes": "collections.abc.Mapping[str, typing.Any]",
    }
