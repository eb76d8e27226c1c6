"""Tables as spreadsheets and killed loggers leave them have the values of the plain table."""

import json
import logging
from pathlib import Path

import numpy as np
import pytest
from containing import Containing

from hesr_model.errors import LogError
from hesr_model.logs import csv_text
from hesr_model.logs.tables import read_table

ROWS = np.arange(40.0).reshape(10, 4) / 8.0
HEADER = "t,q1,dq1,tau1"
LINES = [",".join(f"{value:.6f}" for value in row) for row in ROWS]
PLAIN = "\n".join([HEADER, *LINES]) + "\n"


def read(path: Path, content: bytes) -> np.ndarray:
    path.write_bytes(content)
    table = read_table(path)
    assert table.names == tuple(HEADER.split(","))
    return np.asarray(table.numbers(table.names))


@pytest.mark.parametrize(
    "content",
    [
        PLAIN.encode() + b"\0" * 4096,
        PLAIN.encode() + b"\0" * 10 + b"\0" * csv_text._MAX_LINE_LENGTH,
        PLAIN.removesuffix("\n").encode() + b"\0" * 7,
        PLAIN.replace("\n", ",,\n").encode(),
        PLAIN.replace("\n", ",,\r\n").encode(),
    ],
)
def test_a_tail_and_empty_columns_have_no_effect(content: bytes, tmp_path: Path) -> None:
    np.testing.assert_array_equal(read(tmp_path / "a.csv", content), ROWS)


@pytest.mark.parametrize("tail", [b"", b"\0" * 100])
def test_a_torn_last_row_is_left_out(
    tail: bytes, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    content = PLAIN.encode()[:-12] + tail
    with caplog.at_level(logging.WARNING):
        values = read(tmp_path / "a.csv", content)
    np.testing.assert_array_equal(values, ROWS[:-1])
    (record,) = caplog.records
    assert record.getMessage() == Containing("a.csv: its last row, 11, ", "left out.")


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (PLAIN.encode() + b"\0" * 9 + b"1,2,3,4\n", "cannot be read as CSV text"),
        (PLAIN.replace("\n1.", "\0\n1.", 1).encode(), "cannot be read as CSV text"),
        (b"\0" * 4096, "cannot be read as CSV text"),
        # A row that ends was not cut by its end, and one in the middle not at all.
        (PLAIN.encode() + b"9.0,1.0\n", "row 12 has 2 cells"),
        (PLAIN.replace(LINES[4], "1.0,2.0").encode(), "row 6 has 2 cells"),
    ],
)
def test_other_faults_are_refused(content: bytes, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(LogError, match=sentence):
        read(tmp_path / "a.csv", content)


def test_a_column_without_name_that_has_values_stays(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(PLAIN.replace("\n", ",3\n").replace(f"{HEADER},3", f"{HEADER},"), "utf-8")
    assert read_table(path).names == (*HEADER.split(","), "Unnamed: 4")


def write_lists(path: Path, lists: list[list[float]]) -> None:
    rows = [f'{0.1 * k:.1f},"{json.dumps(cells)}"' for k, cells in enumerate(lists)]
    path.write_text("\n".join(["t,positions", *rows]) + "\n", encoding="utf-8")


@pytest.mark.parametrize("chunk_cells", [2**18, 4])
def test_lists_in_cells_are_columns(
    chunk_cells: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(csv_text, "_CHUNK_CELLS", chunk_cells)
    write_lists(tmp_path / "a.csv", ROWS.tolist())
    table = read_table(tmp_path / "a.csv")
    names = tuple(f"positions_{k}" for k in range(1, 5))
    assert table.names == ("t", *names)
    np.testing.assert_array_equal(table.numbers(names), ROWS)


@pytest.mark.parametrize("chunk_cells", [2**18, 4])
def test_lists_of_different_lengths_are_refused(
    chunk_cells: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(csv_text, "_CHUNK_CELLS", chunk_cells)
    write_lists(tmp_path / "a.csv", [*ROWS.tolist(), [1.0, 2.0]])
    with pytest.raises(LogError, match="lists in column 'positions' have 2 to"):
        read_table(tmp_path / "a.csv")
