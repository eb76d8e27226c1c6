"""Everything in a log file is used, irrelevant for a reason, or left over and named."""

from pathlib import Path

import numpy as np
import pytest
from containing import Containing
from rotor import signals
from scipy.io import savemat

from cosim.workflow.inspect import inspect
from hesr_model.findings import Finding
from hesr_model.logs.left_over import IRRELEVANT

SIGNALS = signals()
COLUMNS = {"t": SIGNALS["t"], "q1": SIGNALS["q"], "dq1": SIGNALS["dq"], "tau1": SIGNALS["tau"]}


def write(path: Path, columns: dict[str, np.ndarray]) -> Path:
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def find_left_over(path: Path) -> list[Finding]:
    return [finding for finding in inspect(path).findings if finding.check == "left-over"]


def test_values_of_irrelevant_columns_change_no_output(tmp_path: Path) -> None:
    rows = len(SIGNALS["t"])
    results = []
    for seed in (1, 2):
        random = np.random.default_rng(seed)
        others = {name.upper(): random.normal(size=rows) for name in IRRELEVANT}
        (tmp_path / str(seed)).mkdir()
        result = inspect(write(tmp_path / str(seed) / "run.csv", {**others, **COLUMNS}))
        assert "left-over" not in {finding.check for finding in result.findings}
        results.append((result.result(), result.proposal.description, result.summary()))
    assert results[0] == results[1]
    assert not [name for name in IRRELEVANT if "*" in name or name != name.lower()]
    assert all(IRRELEVANT.values())


def test_other_columns_are_named_in_one_finding(tmp_path: Path) -> None:
    others = {f"voltage_{k}": SIGNALS["volts"] for k in range(30)}
    path = write(tmp_path / "run.csv", {**COLUMNS, **others})
    (finding,) = find_left_over(path)
    assert finding.severity == "advice"
    assert finding.found == Containing("30 items", "'voltage_0'", "'voltage_4' and 25 more")
    assert len(finding.sentence) < 3 * 80
    assert find_left_over(write(tmp_path / "plain.csv", COLUMNS)) == []


def test_a_misspelt_optional_column_is_a_warning(tmp_path: Path) -> None:
    others = {"voltage": SIGNALS["volts"], "temprature1": SIGNALS["volts"]}
    (finding,) = find_left_over(write(tmp_path / "run.csv", {**COLUMNS, **others}))
    assert finding.severity == "warning"
    assert finding.found == Containing("'temprature1' (did you mean 'temperature1'?)", "'voltage'")


@pytest.mark.parametrize("suffix", [".mat", ".npz", ".h5"])
def test_arrays_of_other_lengths_are_left_over(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"run{suffix}"
    arrays = {**COLUMNS, "gains": np.ones((3, 4)), "operator": np.array("somebody")}
    if suffix == ".mat":
        savemat(path, arrays)
    elif suffix == ".npz":
        np.savez(path, allow_pickle=False, **arrays)
    else:
        h5py = pytest.importorskip("h5py", reason="needs hesr[formats]")
        with h5py.File(path, "w") as file:
            for name, values in arrays.items():
                file[name] = str(values) if values.dtype.kind == "U" else values
    (finding,) = find_left_over(path)
    assert finding.found == Containing("2 items ", "'gains (3 x 4)', 'operator'")


def test_other_sheets_of_a_workbook_are_left_over(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason="needs hesr[formats]")
    book = openpyxl.Workbook()
    book.active.title = "notes"
    book.active.append(["Recorded on Monday"])
    book.create_sheet("nothing")
    sheet = book.create_sheet("data")
    sheet.append(list(COLUMNS))
    for row in np.column_stack(list(COLUMNS.values())).tolist():
        sheet.append(row)
    book.save(tmp_path / "run.xlsx")
    (finding,) = find_left_over(tmp_path / "run.xlsx")
    assert finding.found == Containing("1 item ", "'sheet notes (1 row)'")
