"""Checks of logs state nothing by themselves, and know no size of their own.

A number that decides has no unit: it is a share, a ratio, a count or a number of standard errors.
What has a unit, or decides under another name, is listed with its reason.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import hesr_model.health
import hesr_model.logs.rest
from hesr_model.health.referee import Hypothesis

HEALTH = Path(hesr_model.health.__file__).parent
REST = Path(hesr_model.logs.rest.__file__)
CHECKS = sorted(
    path.stem for path in HEALTH.glob("*.py") if path.stem not in ("__init__", "referee")
)
MODULES = [*sorted(HEALTH.glob("*.py")), REST]
STATEMENTS = {"Finding", "build_joint_finding", "caution"}
UNIT = re.compile(r"\[(?:rad|m|s|Hz|N|A|K|kg|degC)\b[^\]]*\]")
SHARES = re.compile(
    r"_(SHARES?|TO_[A-Z_]+|ERRORS|COUNT|ROWS|ROUNDS|BLOCKS|LEVELS|R2|GAIN|SCALES?|STEPS|QUANTILES?"
    r"|CORRELATION|TOLERANCE|UNCERTAINTY|CHANCE|OVER_SIMPLER|REVERSALS|RIVALS|MISTAKES|RUN|RATIO"
    r"|FACTOR|RESIDUAL|LOSS|WIDTHS|RELIABILITY|SQUARES|SIGNIFICANCE|LENGTH|STRIDE|LIMIT|NOISE"
    r"|ERROR|WARNING|FRICTION)$"
)
"""Names of numbers without a unit: shares, ratios, counts and standard errors."""

WITH_UNIT = {
    ("rest", "MOVING"): "the share of usual joints, between two shares of a joint's own peak",
    ("rest", "_NOISE_FREQUENCY"): "of white noise behind the low pass of the logs",
    ("rest", "_NOISE_BANDWIDTH"): "of white noise behind the low pass of the logs",
    ("choices", "_EXAMPLE_RATE"): "an example to replace; it decides nothing",
    ("columns", "_PLACEHOLDER_CONSTANT"): "an example to replace; it decides nothing",
    ("evidence", "_NOISE_FREQUENCY"): "of white noise over the cut-off of the low pass",
    ("evidence", "_NOISE_BANDWIDTH"): "of white noise over the cut-off of the low pass",
    ("mistakes", "_EARTH_GRAVITY"): "a constant of nature, where the file states none",
    ("positions", "_EARTH_GRAVITY"): "a constant of nature",
    ("mistakes", "_SNAP_ANGLE"): "of a mounting; angles have no size of a robot",
    ("mistakes", "_MIN_TILT"): "of a mounting; angles have no size of a robot",
    ("positions", "_TURN"): "the angle after which encoders wrap",
    ("velocity", "_MAX_ARM_TRAVEL"): "two turns; cables of arms allow no more",
    ("positions", "_MAX_SLIDING_TRAVEL"): "only a length contradicts a unit of length; it is the "
    "last witness, of joints without limits whose speed is not that of a fall",
    ("positions", "_PLAUSIBLE_PERIODS"): "only a period contradicts a unit of time",
    # Lags are those of clocks and filters, which do not know how large a robot is.
    ("velocity", "_MAX_LAG"): "end of a search",
    ("timing", "_MAX_DELAY"): "end of a search",
    ("timing", "_SEARCH_STEP"): "grid of a search",
    ("timing", "_SHIFTS"): "grid of a search",
    ("timing", "_AVERAGING_WINDOW"): "rows are averaged over it",
    ("timing", "_AVERAGE_SPACING"): "distance of averages",
    ("timing", "_BODY_SPACING"): "distance of evaluations",
    ("timing", "_NARROW_HALF_INTERVAL"): "of a lag of clocks, next to its standard error",
    ("timing", "_MIN_REPORTED_LAG"): "of a lag of clocks, next to its standard error",
    ("timing", "_UNKNOWN_LAG"): "its error is infinite, so that it decides nothing",
    ("torque", "_SPEED_WINDOW"): "speeds are averaged over it",
    ("torque", "_MIN_STUCK_TIME"): "of a sensor that repeats a row, next to a count of rows",
}
"""Numbers with a unit, each with the reason why no other joint is judged by it."""

OTHERS = {
    ("timing", "_INERTIA_SCALES"), ("timing", "_MIN_REPORTED_RATE"),
    ("timing", "_MEMORY"), ("timing", "_RIVAL_MEMORY"),  # over the travel of a joint
    ("timing", "_MIN_SHARE_OF_MEMORY"), ("torque", "_ROWS_OF_A_CHANGE"),
}  # fmt: skip
"""Numbers without a unit whose names do not end like those of others."""


SCORES = {
    ("torque", "NO_SIGNAL_R2"): "bound of a score on folds: what a statistic of left-out rows must "
    "exceed; below it no race about scales is run",
    ("torque", "_MIN_R2"): "selects fits worth a comparison of joints, or without a race; the "
    "statement has statistics of its own",
    ("mistakes", "_MIN_R2"): "selects corrections worth a race on folds, which decides",
    ("mistakes", "_MIN_GAIN"): "selects corrections worth a race on folds, which decides",
    ("mistakes", "_MIN_GAIN_OVER_SIMPLER"): "a simpler mistake that explains as much is named "
    "instead, or beside it",
    ("referee", "MATERIAL_GAIN"): "of every race: share of squared errors on left-out rows",
    ("referee", "CURE_GAIN"): "of races that change a file: share of squared errors",
    ("omissions", "_MIN_GAIN"): "of a race on folds: a size differs near reversals only, which "
    "are few rows, and its uncertainty must be smaller still",
    ("omissions", "_KNEE_SHARES"): "candidates of a shape over the peak speed; folds choose",
    ("evidence", "_KNEE_SHARE"): "shape over the peak speed, the same for all rivals of a race",
    ("trials", "_KNEE_SHARE"): "shape over the peak speed, the same for all rivals of a race",
}
"""Scores and shapes, each with the reason why it decides nothing alone."""


def read_numbers(path: Path) -> Iterator[tuple[str, str]]:
    """Yield the names of numbers at the top of a module, and the comments next to them."""
    text = path.read_text(encoding="utf-8")
    lines = text.splitlines()
    for node in ast.parse(text).body:
        if not isinstance(node, ast.Assign) or not isinstance(node.targets[0], ast.Name):
            continue
        numbers = [
            value.value
            for value in ast.walk(node.value)
            if isinstance(value, ast.Constant)
            and isinstance(value.value, int | float)
            and not isinstance(value.value, bool)
        ]
        if numbers and not isinstance(node.value, ast.Dict):
            first = node.lineno - 1
            while lines[first - 1].startswith("#"):
                first -= 1
            yield node.targets[0].id, "\n".join(lines[first : node.end_lineno])


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_no_number_that_decides_has_a_unit(path: Path) -> None:
    for name, lines in read_numbers(path):
        place = path.stem, name
        if place in WITH_UNIT:
            continue
        assert not UNIT.search(lines), lines
        assert SHARES.search(name) or place in OTHERS, f"{place}: which unit has it?"


def test_numbers_that_are_listed_exist() -> None:
    names = {(path.stem, name) for path in MODULES for name, _ in read_numbers(path)}
    assert (set(WITH_UNIT) | OTHERS) - names == set()


def test_scores_decide_nothing_alone() -> None:
    """Shares of explained squares are bounds of races on folds, or select what is raced."""
    pattern = re.compile(r"_R2$|_KNEE_SHARES?$|_GAIN(_OVER_\w+)?$")
    names = {(path.stem, name) for path in MODULES for name, _ in read_numbers(path)}
    assert {(stem, name) for stem, name in names if pattern.search(name)} == set(SCORES)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_sizes_are_compared_with_sizes(path: Path) -> None:
    """A literal next to a comparison is a count, a ratio or round-off, and none is tiny."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    literals = [
        operand.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Compare)
        for operand in (node.left, *node.comparators)
        if isinstance(operand, ast.Constant) and isinstance(operand.value, int | float)
    ]
    assert [value for value in literals if 0.0 < abs(value) < 0.01] == []


@pytest.mark.parametrize("module", CHECKS)
def test_only_the_referee_makes_statements(module: str) -> None:
    tree = ast.parse((HEALTH / f"{module}.py").read_text(encoding="utf-8"))
    calls = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
    assert not {call.id for call in calls if isinstance(call, ast.Name)} & STATEMENTS


def test_a_hypothesis_holds_words_and_trials_only() -> None:
    assert {field: str(kind) for field, kind in Hypothesis.__annotations__.items()} == {
        **dict.fromkeys(["check", "joint", "observation", "remedy", "record"], "<class 'str'>"),
        "severity": str(Hypothesis.__annotations__["severity"]),
        "trials": "tuple[hesr_model.health.referee.Race | hesr_model.health.referee.Statistic, "
        "...]",
        **dict.fromkeys(["contradictions", "further_joints", "logs"], "tuple[str, ...]"),
        "changes": "collections.abc.Mapping[str, typing.Any]",
    }
