"""No reader drops more than 1 % of the rows without a finding that gives the count and the cause.

Faults of tables are tried in each format, and with a robot file that pieces of long logs are read
with. Rows are counted: each row of a file is used, counted by a finding, or the file is refused.
"""

import gzip
import json
import re
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from hesr_model.errors import LogError
from hesr_model.findings import Finding
from hesr_model.health.positions import report_gaps
from hesr_model.health.proposal import inspect_logs
from hesr_model.logs.long_log import LongLog
from hesr_model.logs.robot_log import Log

Table = dict[str, np.ndarray]
ROWS = 600
NAMES = ("t", "q1", "dq1", "tau1")
T = np.round(0.01 * np.arange(ROWS), 6)
Q = np.round(np.sin(2.0 * T) + 0.4 * np.sin(5.1 * T), 6)
DQ = np.round(2.0 * np.cos(2.0 * T) + 2.04 * np.cos(5.1 * T), 6)
TAU = np.round(0.3 * np.tanh(DQ / 0.05) + 0.02 * DQ + 0.01 * np.sin(97.0 * T), 6)
EVERY = np.arange(7, ROWS, 20)
MAX_SHARE = 0.01  # of rows that may be lost without a finding
_COUNTS = re.compile(r"(\d+) rows ")


def plain() -> Table:
    return dict(zip(NAMES, (T.copy(), Q.copy(), DQ.copy(), TAU.copy()), strict=True))


def blank(names: tuple[str, ...], rows: Any) -> Table:
    table = plain()
    for name in names:
        table[name][rows] = np.nan
    return table


def take(rows: np.ndarray) -> Table:
    return {name: values[rows] for name, values in plain().items()}


def stamp(t: np.ndarray) -> Table:
    return {**plain(), "t": np.round(t, 6)}


def begin_again(*rows: int) -> Table:
    t = T.copy()
    for row in rows:
        t[row:] -= t[row]
    return stamp(t)


def pause(*rows: int) -> Table:
    return stamp(T + 5.0 * sum((np.arange(ROWS) >= row for row in rows), np.zeros(ROWS)))


def stagger(every: int, delay: float, first: int = 0) -> Table:
    """Torques of another topic in rows of their own, `every` so many positions from a row on."""
    rows = []
    for k in range(ROWS):
        rows.append([T[k], Q[k], DQ[k], np.nan])
        if k >= first and k % every == 0:
            rows.append([T[k] + delay, np.nan, np.nan, TAU[k]])
    return dict(zip(NAMES, np.array(rows).T, strict=True))


def swap(*rows: int) -> Table:
    order = np.arange(ROWS)
    for row in rows:
        order[[row, row + 1]] = row + 1, row
    return take(order)


FAULTS: dict[str, Table] = {
    "nothing": plain(),
    "torques missing": blank(("tau1",), EVERY),
    "a block of positions missing": blank(("q1",), slice(200, 300)),
    "stamps missing": blank(("t",), EVERY),
    "whole rows missing": blank(NAMES, EVERY),
    "whole rows but stamps missing": blank(NAMES[1:], slice(100, 150)),
    "the beginning missing": blank(NAMES[1:], slice(0, 200)),
    "every other velocity missing": blank(("dq1",), slice(1, None, 2)),
    "rows repeated": take(np.sort(np.append(np.arange(ROWS), EVERY))),
    "a block repeated": take(np.append(np.arange(400), np.arange(300, ROWS))),
    "the last row repeated": take(np.append(np.arange(ROWS), np.repeat(ROWS - 1, 60))),
    "stamps repeated": stamp(np.where(np.isin(np.arange(ROWS), EVERY), np.roll(T, 1), T)),
    "stamps exchanged": swap(100, 300, 500),
    "a stamp falls": stamp(np.where(np.arange(ROWS) == 300, 0.0, T)),
    "restarted": begin_again(300),
    "restarted early": begin_again(50),
    "restarted often": begin_again(60, 120, 400),
    "restarted too often": begin_again(*range(90, ROWS, 90)),
    "short parts": pause(300, 350),
    "bursts": stamp(0.05 * (np.arange(ROWS) // 5)),
    "a counter wraps": stamp((10.0 * np.arange(ROWS) + 64_000.0) % 65_536.0),
    "two topics": stagger(1, 0.004),
    "two topics with equal stamps": stagger(1, 0.0),
    "a slow topic": stagger(8, 0.004),
    "a late topic": stagger(2, 0.004, first=200),
}


def write_cell(value: float) -> str:
    return "" if np.isnan(value) else repr(float(value))


def list_rows(table: Table) -> Iterator[list[float]]:
    yield from np.column_stack(list(table.values())).tolist()


def list_records(table: Table) -> list[dict[str, float | None]]:
    rows = [[None if np.isnan(value) else value for value in row] for row in list_rows(table)]
    return [dict(zip(table, row, strict=True)) for row in rows]


def write_text(path: Path, table: Table, delimiter: str = ",", decimal: str = ".") -> None:
    lines = [delimiter.join(table)]
    for row in list_rows(table):
        cells = [write_cell(value).replace(".", decimal) for value in row]
        lines.append(delimiter.join(cells))
    text = "\n".join(lines) + "\n"
    path.write_bytes(gzip.compress(text.encode()) if path.suffix == ".gz" else text.encode())


def write_lines(path: Path, table: Table) -> None:
    path.write_text("\n".join(map(json.dumps, list_records(table))) + "\n", encoding="utf-8")


def write_columns(path: Path, table: Table) -> None:
    records = list_records(table)
    columns = {name: [record[name] for record in records] for name in table}
    path.write_text(json.dumps(columns), encoding="utf-8")


def write_arrow(path: Path, table: Table) -> None:
    pyarrow = pytest.importorskip("pyarrow", reason="needs hesr[formats]")
    content = pyarrow.table(
        {name: pyarrow.array(values, from_pandas=True) for name, values in table.items()}
    )
    kind = path.suffix.removeprefix(".")
    library = pytest.importorskip(f"pyarrow.{kind}", reason="needs hesr[formats]")
    getattr(library, {"parquet": "write_table", "feather": "write_feather"}[kind])(content, path)


def write_records(path: Path, table: Table) -> None:
    records = np.empty(len(table["t"]), [(name, float) for name in table])
    for name, values in table.items():
        records[name] = values
    np.save(path, records)


def write_hdf5(path: Path, table: Table) -> None:
    h5py = pytest.importorskip("h5py", reason="needs hesr[formats]")
    with h5py.File(path, "w") as file:
        for name, values in table.items():
            file[name] = values


def write_workbook(path: Path, table: Table) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason="needs hesr[formats]")
    book = openpyxl.Workbook()
    book.active.append(list(table))
    for record in list_records(table):
        book.active.append(list(record.values()))
    book.save(path)


WRITERS: dict[str, Callable[[Path, Table], object]] = {
    "run.csv": write_text,
    "comma.csv": lambda path, table: write_text(path, table, ";", ","),
    "tabs.txt": lambda path, table: write_text(path, table, "\t"),
    "packed.csv.gz": write_text,
    "lines.jsonl": write_lines,
    "columns.json": write_columns,
    "run.parquet": write_arrow,
    "run.feather": write_arrow,
    "run.npz": lambda path, table: np.savez(path, allow_pickle=False, **table),
    "run.npy": write_records,
    "run.mat": savemat,
    "run.h5": write_hdf5,
    "run.xlsx": write_workbook,
}


def count_told(findings: Any) -> int:
    """Return the number of rows that findings on left-out rows give, each with a cause."""
    sentences = {f.found for f in findings if f.check in ("dropped-rows", "gaps")}
    return sum(int(count) for sentence in sentences for count in _COUNTS.findall(sentence))


def count_used(log: Log) -> int:
    return sum(len(part.t) for part in log.parts())


def count_joined(table: Table) -> int:
    """Return the rows whose numbers are in other rows: those of a topic without its own rows."""
    is_of_torque = np.isfinite(table["tau1"])
    if is_of_torque.all() or not np.isnan(table["q1"][is_of_torque]).all():
        return 0
    stamps = table["t"]
    torque_stamps = stamps[is_of_torque]
    after = np.searchsorted(stamps[~is_of_torque], torque_stamps)
    return len(set(after.tolist()) | set((after - 1).tolist()))


def require_told(rows: int, used: int, findings: Any, joined: int = 0) -> None:
    lost = rows - used - joined
    told = count_told(findings)
    assert lost <= MAX_SHARE * rows or told >= lost - MAX_SHARE * rows, (rows, used, joined, told)
    assert told <= rows - used


def list_cases(names: Collection[str], every: int) -> list[tuple[str, str]]:
    """Return faults with CSV and some of the other formats, so that each has many faults."""
    return [
        (fault, name)
        for k, fault in enumerate(FAULTS)
        for j, name in enumerate(names)
        if j == 0 or (k + j) % every == 0
    ]


TOO_OFTEN = "restarted too often"


@pytest.mark.ci
@pytest.mark.parametrize(("fault", "name"), list_cases(WRITERS, 4))
def test_rows_of_a_faulty_table_are_used_or_counted(fault: str, name: str, tmp_path: Path) -> None:
    table = FAULTS[fault]
    path = tmp_path / name
    WRITERS[name](path, table)
    if fault == TOO_OFTEN:
        with pytest.raises(LogError, match=r"6 gaps .* leave no part of 1 s"):
            inspect_logs([path])
        return
    proposal = inspect_logs([path])
    (log,) = proposal.logs
    findings = (*proposal.first_findings, *proposal.examination.findings)
    require_told(len(table["t"]), count_used(log), findings, count_joined(table))


PIECED = ("run.csv", "comma.csv", "packed.csv.gz", "lines.jsonl", "run.parquet", "run.npz")


def list_findings(long_log: LongLog) -> list[Finding]:
    """Return what commands say on the rows of a log that is read in pieces."""
    findings = []
    for log in long_log.checked_pieces:
        texts = [f"{count} rows {cause}" for cause, count in log.left_out.items()]
        findings += [Finding(check="dropped-rows", found=text) for text in texts]
    parts = len(long_log.starts)
    gaps = report_gaps(long_log.gaps, long_log.longest_step, parts, long_log.short_rows)
    return [*findings, Finding(check="gaps", found=gaps.observation)]


@pytest.mark.ci
@pytest.mark.parametrize(("fault", "name"), list_cases(PIECED, 3))
def test_rows_of_pieces_are_used_or_counted(fault: str, name: str, tmp_path: Path) -> None:
    table = FAULTS[fault]
    WRITERS[name](tmp_path / name, table)
    if fault == TOO_OFTEN:
        return  # refused
    proposal = inspect_logs([tmp_path / name])
    long_log = LongLog(tmp_path / name, proposal.description, max_rows=128)
    used = sum(part.last - part.first for part in long_log._parts)
    assert used == count_used(proposal.logs[0])
    require_told(len(table["t"]), used, list_findings(long_log), count_joined(table))


LINES = [",".join(f"{value:.6f}" for value in row) for row in zip(T, Q, DQ, TAU, strict=True)]


def insert(text: str, every: int = 20) -> str:
    """Return a CSV with a line before each so many rows."""
    lines = [",".join(NAMES)]
    for k, line in enumerate(LINES):
        if k % every == every // 2:
            lines.append(text)
        lines.append(line)
    return "\n".join(lines) + "\n"


def change(edit: Callable[[str], str], rows: Any = EVERY) -> str:
    """Return a CSV with some rows edited."""
    chosen = set(np.arange(ROWS)[rows].tolist())
    lines = [edit(line) if k in chosen else line for k, line in enumerate(LINES)]
    return "\n".join([",".join(NAMES), *lines]) + "\n"


# Text, the number of its rows with numbers, and how many of them are left out.
TEXTS: dict[str, tuple[str, int]] = {
    "blank lines": (insert(""), 0),
    "comments": (insert("# a pause"), 0),
    "headers": (insert(",".join(NAMES)), 0),
    "rows of commas": (insert(",,,"), 30),
    "rows in comments": (change(lambda line: f"#{line}"), 30),
    "rows in comments of MATLAB": (change(lambda line: f"% {line}"), 30),
    "words for no number": (change(lambda line: f"{line.rpartition(',')[0]},N/A"), 30),
    "a cut last row": (insert("")[:-7], 1),
}


@pytest.mark.parametrize("name", TEXTS)
def test_lines_without_a_row_are_skipped_and_others_counted(name: str, tmp_path: Path) -> None:
    text, left_out = TEXTS[name]
    path = tmp_path / "run.csv"
    path.write_text(text, encoding="utf-8")
    proposal = inspect_logs([path])
    (log,) = proposal.logs
    assert len(log.t) == ROWS - (left_out if "commas" not in name else 0)
    if left_out > 1:
        assert count_told(proposal.first_findings) == left_out


def test_rows_without_a_cell_do_not_shift_rows_without_stamps(tmp_path: Path) -> None:
    """With a rate they are counted, except at the end of the file."""
    rows = [line.partition(",")[2] for line in LINES]
    for k in EVERY:
        rows[k] = ",,"
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["q1,dq1,tau1", *rows, ",,", ",,"]) + "\n", encoding="utf-8")
    description = inspect_logs([_write_timed(tmp_path)]).description
    log_format = description.log.model_copy(update={"rate": 100.0, "missing": "drop"})
    log = Log.read(path, description.model_copy(update={"log": log_format}))
    assert log.dropped == len(EVERY)
    np.testing.assert_allclose(log.t, np.delete(T, EVERY), atol=1e-9)
    np.testing.assert_array_equal(log.q[:, 0], np.delete(Q, EVERY))


def _write_timed(folder: Path) -> Path:
    path = folder / "timed.csv"
    write_text(path, plain())
    return path


def test_records_of_text_that_begins_like_a_comment_are_rows(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    records = [{"note": "# first", **record} for record in list_records(plain())]
    path.write_text("\n".join(map(json.dumps, records)), encoding="utf-8")
    (log,) = inspect_logs([path]).logs
    assert len(log.t) == ROWS


@pytest.mark.parametrize("split", [300, 400])
def test_other_lists_of_a_file_are_left_over_with_their_length(split: int, tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    records = list_records(plain())
    data = {"robot": "arm", "first": records[:split], "second": {"data": records[split:]}}
    path.write_text(json.dumps(data), encoding="utf-8")
    proposal = inspect_logs([path])
    (log,) = proposal.logs
    assert len(log.t) == split
    assert set(log.left_over) == {"robot", f"second.data ({ROWS - split} entries)"}
    (finding,) = [f for f in proposal.examination.findings if f.check == "left-over"]
    assert f"({ROWS - split} entries)" in finding.found


@pytest.mark.ci
def test_each_log_has_its_own_count(tmp_path: Path) -> None:
    faults = ("torques missing", "every other velocity missing", "short parts", "restarted early")
    for fault in faults:
        write_text(tmp_path / f"{fault}.csv", FAULTS[fault])
    for names in (faults[:2], faults[2:]):
        proposal = inspect_logs([tmp_path / f"{name}.csv" for name in names])
        for log in proposal.logs:
            findings = [f for f in proposal.first_findings if log.name in f.logs]
            require_told(ROWS, count_used(log), findings)
