"""Laws that a test does not separate from a given law: the function, and its table."""

from dataclasses import replace

import numpy as np
import pytest

from cosim.report.tables.scores import errors, separations
from cosim.study.scores import Comparison, compare, find_unseparated
from hesr_model.rigid_body.friction_record import FrictionRecord

LOG_COUNT = 5
SECONDS = 30.0
PERIOD = 0.02
SIZES = {"a": 1.0, "b": 1.01, "c": 1.5, "d": 1.52}  # of errors [N.m]


def compare_laws(log_count: int, seconds: float = SECONDS) -> Comparison:
    """Scores of laws whose errors are noise of known sizes, on the logs of one joint."""
    rng = np.random.default_rng(3)
    t = PERIOD * np.arange(round(seconds / PERIOD))
    records = [
        FrictionRecord(
            log=f"log_{k}",
            joint="j1",
            t=t,
            dq=np.sin(t),
            q=-np.cos(t),
            tau_load=np.zeros_like(t),
            tau=10.0 * np.sign(np.sin(t)),
        )
        for k in range(log_count)
    ]
    predictions = {
        law_name: [[record.tau + rng.normal(0.0, size, len(t)) for record in records]]
        for law_name, size in SIZES.items()
    }
    return compare([records], predictions)


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compare_laws(LOG_COUNT)


@pytest.mark.parametrize(
    ("law_name", "laws", "better"),
    [("a", {"b"}, set()), ("b", {"a"}, set()), ("c", {"d"}, {"a", "b"}), ("d", {"c"}, {"a", "b"})],
)
def test_laws_are_compared_with_the_given_one(
    comparison: Comparison, law_name: str, laws: set[str], better: set[str]
) -> None:
    """Not with the best of the test: two laws that are equally bad are not separated."""
    unseparated = find_unseparated(comparison, law_name, 0)
    assert unseparated
    assert set(unseparated.laws) == laws
    assert set(unseparated.better) == better
    assert unseparated.detectable
    assert 1.0 < unseparated.detectable[0] <= unseparated.detectable[1] < 1.4
    assert unseparated.seconds > 0.0


def test_the_law_with_the_lowest_error_has_the_leaders(comparison: Comparison) -> None:
    best, *tied = comparison.leading[0]
    unseparated = find_unseparated(comparison, best, 0)
    assert unseparated
    assert list(unseparated.laws) == tied
    assert comparison.seconds == (unseparated.seconds,)


@pytest.mark.parametrize(
    ("law_name", "cells"),
    [("a", ["a", "b", "none", "b"]), ("d", ["d", "b", "a, b", "c"])],
)
def test_the_table_is_that_of_the_recommended_law(
    comparison: Comparison, law_name: str, cells: list[str]
) -> None:
    table = separations("test", comparison, [law_name])
    assert table
    assert table.head == ("joint", "recommended", "lowest error", "better", "not separated",
                          "would show", "for 10 %")  # fmt: skip
    (row,) = table.rows
    assert [cell.text for cell in row.cells[:4]] == cells
    unseparated = find_unseparated(comparison, law_name, 0)
    assert unseparated
    assert row.cells[5].text == f"{unseparated.seconds:.0f} s"


def test_the_tables_say_for_which_logs_they_hold(comparison: Comparison) -> None:
    single = compare_laws(1, 60.0)
    few = compare_laws(2)
    notes = []
    for scores in (comparison, single, few):
        table = separations("test", scores)
        assert table
        notes.append(table.note)
    assert "5 logs" in notes[0]
    assert "other logs of this kind" in notes[0]
    assert "few" not in notes[0]
    assert "on this log only" in notes[1]
    assert "2 logs are few" in notes[2]
    assert "interval on other logs of the kind" in str(errors("test", comparison).caption)
    assert "interval on this log" in str(errors("test", single).caption)


def test_parts_of_one_log_are_one_log() -> None:
    """A log with gaps says nothing of other logs."""
    t = PERIOD * np.arange(1500)
    record = FrictionRecord(log="l", joint="j", t=t, dq=t, q=t, tau_load=0.0 * t, tau=np.sin(t))
    parts = [replace(record, t=t + 40.0 * k) for k in range(3)]
    rng = np.random.default_rng(1)
    predictions = {
        law_name: [[part.tau + rng.normal(0.0, 1.0, len(t)) for part in parts]]
        for law_name in ("a", "b")
    }
    comparison = compare([parts], predictions)
    assert comparison.log_count == 1
    assert not comparison.ratios.laws["b"][0].on_other_logs


def test_results_of_earlier_versions_know_only_the_best_law(comparison: Comparison) -> None:
    earlier = replace(comparison, unseparated=(), log_count=0)
    best, *tied = earlier.leading[0]
    unseparated = find_unseparated(earlier, best, 0)
    assert unseparated
    assert list(unseparated.laws) == tied
    assert find_unseparated(earlier, "d", 0) is None
    table = separations("test", earlier, ["d"])
    assert table
    assert [cell.text for cell in table.rows[0].cells[3:]] == ["unknown"] * 3
