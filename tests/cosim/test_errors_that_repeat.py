"""What repeats of the errors of laws: from records to files, tables and sentences."""

from pathlib import Path

import numpy as np
import pytest

from cosim.report.tables.replicates import (
    build_tables,
    choose_laws,
    describe_replicates,
    split_of_laws,
)
from cosim.report.tables.table import ResultTable
from cosim.study.replicates import (
    REPLICATES,
    Replicates,
    read_replicates,
    split_by_replicates,
)
from cosim.study.scores import ORACLE
from hesr_model.errors import ArtifactError
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.arrays import Array
from hesr_model.support.typed_files import to_json, write_json

PERIOD = 8.0  # [s]
NOISE = 0.5  # [N.m]


def record_sine(log: str, duration: float) -> FrictionRecord:
    """A joint in a sine whose torque has a part that repeats, 1 N.m, and noise of half of it."""
    t = np.arange(0.0, duration, 0.01)
    q = np.cos(2.0 * np.pi * t / PERIOD)
    dq = -2.0 * np.pi / PERIOD * np.sin(2.0 * np.pi * t / PERIOD)
    ripple = np.sqrt(2.0) * np.sin(60.0 * q)
    noise = NOISE * np.random.default_rng(len(t)).normal(size=len(t))
    return FrictionRecord(
        log=log, joint="a", t=t, dq=dq, q=q, tau_load=0.0 * t, tau=ripple + noise + np.sign(dq)
    )


def predict(record: FrictionRecord) -> dict[str, list[list[Array]]]:
    """Torques of a law without the ripple, of one with it, of one that diverged, of the truth."""
    coulomb = np.sign(record.dq)
    ripple = np.sqrt(2.0) * np.sin(60.0 * record.q)
    return {
        "stribeck": [[coulomb]],
        "lugre": [[coulomb + ripple]],
        "parfam_s": [[1e200 * coulomb]],
        ORACLE: [[coulomb + 0.99 * ripple]],
    }


@pytest.fixture(scope="module")
def replicates() -> Replicates:
    record = record_sine("sine", 41.0)
    split = split_by_replicates([[record]], predict(record))
    assert split is not None
    return split


def test_law_without_the_ripple_leaves_what_repeats(replicates: Replicates) -> None:
    (stribeck,) = replicates.laws["stribeck"]
    (lugre,) = replicates.laws["lugre"]
    assert stribeck.repeats == pytest.approx(0.8, abs=0.03)
    assert stribeck.left_to_gain == pytest.approx(np.sqrt(0.2), abs=0.04)
    assert lugre.repeats < 0.05
    # The floor is that of the data, whatever the law.
    assert stribeck.rmse * stribeck.left_to_gain == pytest.approx(NOISE, rel=0.05)
    assert lugre.rmse * lugre.left_to_gain == pytest.approx(NOISE, rel=0.05)


def test_rows_and_period(replicates: Replicates) -> None:
    assert replicates.period == pytest.approx(PERIOD, abs=1e-3)
    assert replicates.count == 5
    assert 0.95 * replicates.all_rows < replicates.rows <= replicates.all_rows


def test_ripple_is_what_repeats_above_5_hz(replicates: Replicates) -> None:
    (split,) = replicates.fast["stribeck"]
    assert 0.3 < split.repeats < 0.9


def test_law_that_diverged_has_no_split(replicates: Replicates) -> None:
    assert set(replicates.laws) == set(replicates.fast) == {"stribeck", "lugre", ORACLE}


def test_one_period_has_no_replicate() -> None:
    record = record_sine("sine", PERIOD)
    assert split_by_replicates([[record]], predict(record)) is None


def test_replicates_in_two_logs() -> None:
    records = [record_sine("first", PERIOD), record_sine("second", PERIOD - 1.0)]
    torques = {"stribeck": [[np.sign(record.dq) for record in records]]}
    replicates = split_by_replicates([records], torques)
    assert replicates is not None
    assert replicates.period is None
    assert replicates.laws["stribeck"][0].repeats == pytest.approx(0.8, abs=0.05)
    (sentence,) = describe_replicates({"test": replicates}, "test", [])
    assert "repeats between replicates" in sentence


def test_file_keeps_splits_and_what_has_none(replicates: Replicates, tmp_path: Path) -> None:
    assert read_replicates(tmp_path) == {}  # earlier versions
    write_json(tmp_path / REPLICATES, {"sines": to_json(replicates), "test": None})
    assert read_replicates(tmp_path) == {"sines": replicates, "test": None}


def test_damaged_file_is_refused(replicates: Replicates, tmp_path: Path) -> None:
    saved = to_json(replicates)
    del saved["period"]
    write_json(tmp_path / REPLICATES, {"sines": saved})
    with pytest.raises(ArtifactError, match="key 'period' is missing"):
        read_replicates(tmp_path)


def test_sentence_states_what_repeats_and_what_is_left(replicates: Replicates) -> None:
    (split,) = replicates.laws["stribeck"]
    (sentence,) = describe_replicates({"sines": replicates}, "sines", ["stribeck"])
    assert sentence.startswith(f"J1: {100.0 * split.repeats:.0f} % of the squared error")
    assert f"a factor of {split.left_to_gain:.2f} is left" in sentence
    assert len(sentence.split()) <= 25


def test_sentence_where_nothing_repeats(replicates: Replicates) -> None:
    (sentence,) = describe_replicates({"sines": replicates}, "sines", ["lugre"])
    assert sentence.startswith("J1: no part of")
    assert "LuGre repeats significantly" in sentence


def test_nothing_is_called_noise_without_a_replicate() -> None:
    (sentence,) = build_tables({"test": None}, "test", ["stribeck"])
    assert sentence.startswith("'test': no motion occurs twice")
    assert build_tables({}, "test", ["stribeck"]) == []  # earlier versions


def test_table_states_the_parts_of_the_recommended_law(replicates: Replicates) -> None:
    assert choose_laws(replicates, ["stribeck"]) == ["stribeck"]
    assert choose_laws(replicates, ["parfam_s"]) == ["lugre"]  # never the truth
    table = split_of_laws("sines", replicates, ["stribeck"])
    (row,) = table.rows
    (split,) = replicates.laws["stribeck"]
    values = dict(zip(table.head[1:], (cell.value for cell in row.cells), strict=True))
    assert values["RMSE [N.m]"] == split.rmse
    assert values["repeats [%]"] == 100.0 * split.repeats
    assert values["noise [%]"] == pytest.approx(100.0 - 100.0 * split.repeats)
    assert values["left to gain"] == split.left_to_gain
    split_table, shares, _ = build_tables({"sines": replicates}, "sines", ["stribeck"])
    assert split_table == table
    assert isinstance(shares, ResultTable)
    assert len(shares.rows) == len(replicates.laws)
