"""Files of other programs: Feather, Excel, HDF5, NumPy, packed text, UTF-16, no header, no time."""

import bz2
import gzip
import lzma
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pytest
from pyarrow import feather
from scipy.io import savemat

from hesr_model.errors import ConfigError, LogError
from hesr_model.health.proposal import inspect_logs
from hesr_model.logs.log_format import LogFormat
from hesr_model.logs.parsers import excel
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import RobotDescription

N = 50
NAMES = ("t", "q1", "q2", "dq1", "dq2", "tau1", "tau2")


def table() -> np.ndarray:
    """Two joints at 100 Hz; all values differ."""
    values = np.random.default_rng(1).normal(size=(N, 7))
    values[:, 0] = 0.01 * np.arange(N)
    return values


def text(values: np.ndarray, header: str = ",".join(NAMES), between: str = ",") -> str:
    rows = [between.join(f"{x:.17g}" for x in row) for row in values]
    return "\n".join([*([header] if header else []), *rows, ""])


def robot(**log: Any) -> RobotDescription:
    # No test here opens the model.
    return RobotDescription(
        name="two", model=Path("two.urdf"), joints=("a", "b"), log=LogFormat.model_validate(log)
    )


def require_equal(log: Log, values: np.ndarray | None = None) -> None:
    assert log.dq is not None
    found = np.column_stack([log.t, log.q, log.dq, log.tau])
    np.testing.assert_array_equal(found, table() if values is None else values)


def by_name() -> dict[str, np.ndarray]:
    values = table()
    return {"t": values[:, :1], "q": values[:, 1:3], "dq": values[:, 3:5], "tau": values[:, 5:]}


def save_feather(path: Path) -> None:
    feather.write_feather(pyarrow.table(dict(zip(NAMES, table().T, strict=True))), path)


def save_excel(path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason="needs hesr[formats]")
    book = openpyxl.Workbook()
    book.active.append(["Recorded on Monday"])
    sheet = book.create_sheet("data")
    sheet.append([None, "Test bench 3"])
    sheet.append([])
    for row in [NAMES, *table().tolist()]:
        sheet.append([None, *row])
    book.save(path)


def save_hdf5(path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="needs hesr[formats]")
    with h5py.File(path, "w") as file:
        file["note"] = "recorded"
        for name, array in by_name().items():
            file[name] = array


def save_records(path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="needs hesr[formats]")
    with h5py.File(path, "w") as file:
        file["log"] = np.rec.fromarrays(table().T, names=NAMES)


SAVES: dict[str, Callable[[Path], Any]] = {
    "run.feather": save_feather,
    "run.xlsx": save_excel,
    "run.h5": save_hdf5,
    "run.npz": lambda path: np.savez(path, **by_name()),
    "packed.npz": lambda path: np.savez_compressed(
        path, **{k: v.T[:, None, :] for k, v in by_name().items()}
    ),
    "run.npy": lambda path: np.save(path, np.rec.fromarrays(table().T, names=NAMES)),
    "run.csv.gz": lambda path: path.write_bytes(gzip.compress(text(table()).encode())),
    "run.csv.bz2": lambda path: path.write_bytes(bz2.compress(text(table()).encode())),
    "run.csv.xz": lambda path: path.write_bytes(lzma.compress(text(table()).encode())),
    "windows.csv": lambda path: path.write_bytes(f"# at 20 °C\n{text(table())}".encode("cp1252")),
    "utf16.csv": lambda path: path.write_text(text(table()), encoding="utf-16"),
    "utf16le.txt": lambda path: path.write_bytes(text(table()).encode("utf-16-le")),
    "utf16be.csv.gz": lambda path: path.write_bytes(
        gzip.compress(text(table()).encode("utf-16-be"))
    ),
}


@pytest.mark.parametrize("name", SAVES)
def test_every_format_is_read_bit_by_bit(tmp_path: Path, name: str) -> None:
    SAVES[name](tmp_path / name)
    log = Log.read(tmp_path / name, robot())
    if name == "run.xlsx":  # openpyxl writes 16 digits
        found = np.column_stack([log.t, log.q, log.tau])
        np.testing.assert_allclose(found, table()[:, [0, 1, 2, 5, 6]], rtol=1e-15)
    else:
        require_equal(log)


def test_records_in_hdf5_are_columns(tmp_path: Path) -> None:
    save_records(tmp_path / "run.h5")
    columns = {k: f"log.{k}{{}}" for k in ("q", "dq", "tau")}
    require_equal(Log.read(tmp_path / "run.h5", robot(columns={"t": "log.t", **columns})))


@pytest.mark.parametrize("between", [",", "\t", ";", " "])
def test_text_without_a_header_is_read_with_names(tmp_path: Path, between: str) -> None:
    for header in ("", between.join(map(str, range(7))), "# made by a recorder"):
        (tmp_path / "run.txt").write_text(text(table(), header, between), encoding="utf-8")
        require_equal(Log.read(tmp_path / "run.txt", robot(columns=NAMES)))


@pytest.mark.parametrize("shape", [(N, 7), (7, N), (1, 7, N)])
def test_one_matrix_is_read_with_names(tmp_path: Path, shape: tuple[int, ...]) -> None:
    matrix = table() if shape[0] == N else table().T.reshape(shape)
    savemat(tmp_path / "run.mat", {"data": matrix})
    np.save(tmp_path / "run.npy", matrix)
    for name in ("run.mat", "run.npy"):
        require_equal(Log.read(tmp_path / name, robot(columns=NAMES)))
        columns = {"t": "data1", "q": ["data2", "data3"], "dq": ["data4", "data5"]}
        columns |= {"tau": ["data6", "data7"]}
        require_equal(Log.read(tmp_path / name, robot(columns=columns)))


def test_a_rate_replaces_the_time(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(text(table()[:, 1:], ",".join(NAMES[1:])), encoding="utf-8")
    log = Log.read(path, robot(rate=100.0))
    np.testing.assert_allclose(log.t, table()[:, 0], atol=1e-15)
    with pytest.raises(LogError, match=r"column 't' is missing; it has q1, q2, dq1"):
        Log.read(path, robot())
    with pytest.raises(LogError, match=r"looks like time; .* or state 'log\.rate' \[Hz\]\.$"):
        inspect_logs([path])


def test_a_rate_is_compared_with_the_time(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text(text(table()), encoding="utf-8")
    require_equal(Log.read(tmp_path / "run.csv", robot(rate=100.0)))
    with pytest.raises(LogError, match=r"0\.01 s apart, .* 500 Hz"):
        Log.read(tmp_path / "run.csv", robot(rate=500.0))


def test_repeated_rows_leave_the_first(tmp_path: Path) -> None:
    repeated = np.insert(table(), 4, table()[3] + np.eye(7)[2], axis=0)
    (tmp_path / "run.csv").write_text(text(repeated), encoding="utf-8")
    with pytest.raises(LogError, match="duplicates = 'first' leaves out rows"):
        Log.read(tmp_path / "run.csv", robot())
    log = Log.read(tmp_path / "run.csv", robot(duplicates="first"))
    require_equal(log)
    assert log.dropped == 1


def test_swapped_rows_are_sorted(tmp_path: Path) -> None:
    order = [*range(30), 31, 30, *range(32, N)]
    (tmp_path / "run.csv").write_text(text(table()[order]), encoding="utf-8")
    with pytest.raises(LogError, match=r"row 33: time must .*; \[log\]"):
        Log.read(tmp_path / "run.csv", robot())
    require_equal(Log.read(tmp_path / "run.csv", robot(sort=True)))


def test_inspect_proposes_to_sort(tmp_path: Path) -> None:
    t = 0.01 * np.arange(600)
    q = np.sin(3 * t[:, None] + [0, 1])
    values = np.column_stack([t, q, 3 * np.cos(3 * t[:, None] + [0, 1]), q])
    values[[400, 401]] = values[[401, 400]]
    (tmp_path / "run.csv").write_text(text(values), encoding="utf-8")
    proposal = inspect_logs([tmp_path / "run.csv"])
    assert proposal.description.log.sort
    assert len(proposal.logs[0].t) == 600


@pytest.mark.parametrize(
    ("name", "content", "names", "message"),
    [
        ("a.txt", b"0 1.5 2\n1 2.5 3\n", (), r"0, 1\.5, 2; name its 3"),
        ("a.txt", b"0 1.5 2\n1 2.5 3\n", ("t", "q1"), r"3 cells, .* names 2 columns"),
        ("a.gz", gzip.compress(b"t,q1\n" * 99, mtime=0)[:-9], (),
         r"a\.gz: cannot be unpacked; it is trunc"),
        ("a.csv", b"\xff\xfet\x00\x00\xd8", (), r"a\.csv: cannot be read as CSV text\.$"),
        ("a.csv", b"t,q\xb0\n0,1\n\x01,\xb0\n", (), r"a\.csv: cannot be read as CSV text\.$"),
        ("a.npz", b"PK\x03\x04nothing", (), r"a\.npz: cannot be read as NumPy arrays without obj"),
        ("a.npz", b"", (), "log needs a header and rows"),
        ("a.feather", b"ARROW1nothing", (), r"a\.feather: cannot be read as Feather\.$"),
        ("a.h5", b"\x89HDF\r\n\x1a\nno", (), r"a\.h5: cannot be read as a HDF5 file\.$"),
        ("a.xlsx", b"PK\x03\x04nothing", (), r"a\.xlsx: cannot be read as an Excel workbook\.$"),
    ],
)  # fmt: off
def test_other_files_are_refused(
    tmp_path: Path, name: str, content: bytes, names: tuple[str, ...], message: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError, match=message):
        Log.read(tmp_path / name, robot(columns=names) if names else robot())


def test_the_number_of_names_must_fit(tmp_path: Path) -> None:
    np.save(tmp_path / "run.npy", table())
    with pytest.raises(LogError, match=r"has 7 columns, data1, .*data7, but 'log\.columns' of"):
        Log.read(tmp_path / "run.npy", robot(columns=NAMES[:3]))
    (tmp_path / "robot.toml").write_text(
        'name = "a"\nmodel = "a.urdf"\njoints = ["a"]\n[log]\ncolumns = ["t", "t"]\n',
        encoding="utf-8",
    )
    with pytest.raises(ConfigError, match=r"the names of columns must differ\.$"):
        RobotDescription.read(tmp_path / "robot.toml")


def test_objects_in_numpy_files_are_never_loaded(tmp_path: Path) -> None:
    np.savez(tmp_path / "run.npz", t=np.array([{}], dtype=object))
    with pytest.raises(LogError, match="cannot be read as NumPy arrays without objects"):
        Log.read(tmp_path / "run.npz", robot())


def test_bombs_are_refused(tmp_path: Path) -> None:
    zeros = bytes(340 * 2**20)
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        file.writestr("t.npy", zeros)
    (tmp_path / "a.xlsx").write_bytes((tmp_path / "a.npz").read_bytes())
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress(zeros, 1))
    for name in ("a.npz", "a.xlsx"):
        with pytest.raises(LogError, match="claims more data than fits into"):
            Log.read(tmp_path / name, robot())
    with pytest.raises(LogError, match=r"a\.csv\.gz: unpacks to more than 3\d\d MB\.$"):
        Log.read(tmp_path / "a.csv.gz", robot())


@pytest.mark.parametrize(
    ("text", "hostile"),
    [
        ('<row r="20"', '<row r="2000000000"'),
        ('<row r="20"', '<row r="1e300"'),
        ('<c r="A', '<c r="XFD'),
    ],
)
def test_skipped_rows_and_cells_of_a_workbook_count(
    text: str, hostile: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reader yields the rows that a number skips, and the cells up to the last column."""
    openpyxl = pytest.importorskip("openpyxl", reason="needs hesr[formats]")
    monkeypatch.setattr(excel, "compute_max_bytes", lambda _: 1 << 20)
    book = openpyxl.Workbook(write_only=True)
    sheet = book.create_sheet("log")
    for _ in range(20):
        sheet.append([1.0])
    book.save(tmp_path / "dense.xlsx")
    path = tmp_path / "sparse.xlsx"
    with zipfile.ZipFile(tmp_path / "dense.xlsx") as source, zipfile.ZipFile(path, "w") as target:
        for name in source.namelist():
            content = source.read(name).decode()
            target.writestr(name, content.replace(text, hostile))
    with pytest.raises(LogError, match="claim more cells than fit"):
        list(excel.parse(path))


@pytest.mark.parametrize(
    ("name", "library"),
    [("a.h5", "h5py"), ("a.xlsx", "openpyxl"), ("a.pq", "pyarrow"), ("a.feather", "pyarrow")],
)
def test_a_missing_library_gives_the_install_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, library: str
) -> None:
    (tmp_path / name).write_bytes(b"content")
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(LogError, match=rf" need {library}: pip install '.+\[formats\]'"):
        Log.read(tmp_path / name, robot())
