"""Libraries that parse logs run in a child, whose answers are numbers and text."""

import json
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import attackers
import numpy as np
import pytest
import test_log_bag

from hesr_model.errors import LogError
from hesr_model.logs import parsed_file
from hesr_model.logs.log_format import LogFormat
from hesr_model.logs.log_table import TextCell
from hesr_model.logs.parsed_file import ParsedItem, parse_file
from hesr_model.logs.parsers import items
from hesr_model.logs.readers.bag import read_bag
from hesr_model.logs.readers.formats import find_format
from hesr_model.logs.robot_log import Log
from hesr_model.support import rights
from hesr_model.support.child import Child

h5py = pytest.importorskip("h5py", reason="needs hesr[formats]")
pyarrow = pytest.importorskip("pyarrow", reason="needs hesr[formats]")
openpyxl = pytest.importorskip("openpyxl", reason="needs hesr[formats]")
scipy_io = pytest.importorskip("scipy.io")

TIMES = [0.0, 0.5, 1.0]


def save_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["t"] = TIMES


def save_excel(path: Path) -> None:
    book = openpyxl.Workbook()
    for row in ["t"], *([t] for t in TIMES):
        book.active.append(row)
    book.save(path)


SAVERS: dict[str, Callable[[Path], None]] = {
    "a.h5": save_hdf5,
    "a.mat": lambda path: scipy_io.savemat(path, {"t": TIMES}),
    "a.xlsx": save_excel,
    "a.parquet": lambda path: pytest.importorskip("pyarrow.parquet").write_table(
        pyarrow.table({"t": TIMES}), path
    ),
    "a.feather": lambda path: pytest.importorskip("pyarrow.feather").write_feather(
        pyarrow.table({"t": TIMES}), path
    ),
}
LIBRARIES = {
    "h5py": ["File"],
    "scipy.io": ["loadmat"],
    "openpyxl": ["load_workbook"],
    "pyarrow.parquet": ["ParquetFile", "read_table"],
    "pyarrow.ipc": ["open_file"],
    "rosbags.highlevel": ["AnyReader"],
}
"""Functions of libraries that parse."""


@pytest.fixture
def _no_parsers(monkeypatch: pytest.MonkeyPatch) -> None:
    for library, names in LIBRARIES.items():
        module = pytest.importorskip(library)
        for name in names:
            monkeypatch.setattr(module, name, None)


@pytest.mark.parametrize("name", SAVERS)
def test_no_library_parses_a_log_in_this_process(name: str, tmp_path: Path, request: Any) -> None:
    path = tmp_path / name
    SAVERS[name](path)
    request.getfixturevalue("_no_parsers")
    file_format = find_format(path)
    assert file_format.table is not None
    assert file_format.table(path, LogFormat()).numbers(["t"])[:, 0].tolist() == TIMES
    if name in ("a.parquet", "a.feather"):
        assert file_format.pieces is not None
        pieces = list(file_format.pieces(path, LogFormat(), 2))
        assert [piece.numbers(["t"])[:, 0].tolist() for piece in pieces] == [TIMES[:2], TIMES[2:]]


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_no_library_parses_a_bag_in_this_process(
    storage: str, tmp_path: Path, request: Any
) -> None:
    path = test_log_bag.write(tmp_path / "bag", test_log_bag.messages(), storage=storage)
    request.getfixturevalue("_no_parsers")
    test_log_bag.require_content(Log.read(path, test_log_bag.robot()))


@pytest.mark.skipif(not rights.get_landlock_version(), reason="needs Landlock")
def test_a_bag_names_no_file_outside_its_folder(tmp_path: Path) -> None:
    """Its metadata lists files, by any path."""
    other = test_log_bag.write(tmp_path / "other", test_log_bag.messages())
    bag = tmp_path / "bag"
    bag.mkdir()
    metadata = (other / "metadata.yaml").read_text(encoding="utf-8")
    (bag / "metadata.yaml").write_text(metadata.replace("- other", "- ../other/other"), "utf-8")
    assert "../other/other.db3" in (bag / "metadata.yaml").read_text(encoding="utf-8")
    with pytest.raises(LogError) as caught:
        read_bag(bag, test_log_bag.robot())
    assert caught.value.code == "file.unreadable"
    shutil.copyfile(other / "other.db3", bag / "other.db3")
    (bag / "metadata.yaml").write_text(metadata, encoding="utf-8")
    assert len(read_bag(bag, test_log_bag.robot()).t) == test_log_bag.N


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "log.h5"
    path.write_bytes(b"content")
    return path


@pytest.mark.skipif(not rights.get_landlock_version(), reason="needs Landlock")
@pytest.mark.skipif(not rights.has_seccomp(), reason="needs seccomp")
def test_a_parser_can_read_its_file_only(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(log.parent)
    secret = log.with_name("id_rsa")
    secret.write_bytes(b"secret")
    monkeypatch.setattr(parsed_file, "_PARSE", "attackers:yield_what_a_parser_can_do")
    with pytest.raises(LogError) as caught:
        list(parse_file(log, "a log", "hdf5:parse", ["json"], {"secret": str(secret)}))
    assert str(caught.value) == "read the log"
    assert {path.name: path.read_bytes() for path in log.parent.iterdir()} == {
        "log.h5": b"content",
        "id_rsa": b"secret",
    }
    # Each deed succeeds here, where it is permitted.
    (answer, _), *_ = attackers.yield_what_a_parser_can_do("", str(log), {"secret": str(log)})
    assert "read its neighbour" in answer["refusal"]["sentence"]


@pytest.mark.skipif(sys.platform == "win32", reason="limits are those of POSIX")
@pytest.mark.parametrize(
    ("way", "reason"),
    [
        ("crash", "SIGABRT"),
        ("exit", "exit code 3"),
        ("hang", "no answer within 0.3 s"),
        ("memory", "MemoryError"),
    ],
)
def test_a_parser_that_ends_gives_a_sentence(
    way: str, reason: str, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parsed_file, "_PARSE", "attackers:end_as_a_parser")
    if way == "hang":
        monkeypatch.setattr(parsed_file, "_SECONDS", 0.3)
        monkeypatch.setattr(parsed_file, "_SECONDS_PER_BYTE", 0.0)
    with pytest.raises(LogError, match=reason) as caught:
        list(parse_file(log, "a log", f"items:{way}", ["json"]))
    assert (caught.value.code, caught.value.where) == ("file.unreadable", str(log))


HEAD = {"name": "t", "type": "<f8", "shape": [2]}
WRONG: dict[str, tuple[Any, list[bytes]]] = {
    "no object": ([], []),
    "no columns": ({"columns": 5}, []),
    "unknown key": ({"column": []}, []),
    "objects": ({"columns": [HEAD | {"type": "|O", "shape": [1]}]}, [bytes(8)]),
    "records": ({"columns": [HEAD | {"type": "<f8,<f8", "shape": [1]}]}, [bytes(16)]),
    "another order": ({"columns": [HEAD | {"type": ">f8"}]}, [bytes(16)]),
    "no type": ({"columns": [HEAD | {"type": 8}]}, [bytes(16)]),
    "too short": ({"columns": [HEAD]}, [bytes(15)]),
    "too long": ({"columns": [HEAD]}, [bytes(17)]),
    "no buffer": ({"columns": [HEAD]}, []),
    "two buffers": ({"columns": [HEAD]}, [bytes(16), bytes(16)]),
    "negative": ({"columns": [HEAD | {"shape": [-2, -1]}]}, [bytes(16)]),
    "fractions": ({"columns": [HEAD | {"shape": [2.0]}]}, [bytes(16)]),
    "truths": ({"columns": [HEAD | {"shape": [True]}]}, [bytes(8)]),
    "huge": ({"columns": [HEAD | {"shape": [0, 10**30]}]}, [b""]),
    "too many axes": ({"columns": [HEAD | {"shape": [1] * 100}]}, [bytes(8)]),
    "no name": ({"columns": [HEAD | {"name": None}]}, [bytes(16)]),
    "negative rows": ({"row_count": -1}, []),
    "half a refusal": ({"refusal": {"sentence": "x"}}, []),
    "names": ({"names": [[1]]}, []),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_answers_of_another_form_are_refused(
    wrong: str, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, buffers = WRONG[wrong]

    def iterate(*_: Any, **__: Any) -> Iterator[tuple[Any, list[bytearray]]]:
        yield data, [bytearray(buffer) for buffer in buffers]

    monkeypatch.setattr(Child, "iterate", iterate)
    with pytest.raises(LogError, match="invalid answer") as caught:
        list(parse_file(log, "a log", "hdf5:parse", ["json"]))
    assert caught.value.code == "file.unreadable"


@pytest.mark.parametrize("sizes", [[-1], [1.0], [True], [1 << 60], "x", None, [1 << 20] * 400])
def test_sizes_are_checked_before_memory_is_taken(
    sizes: Any, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Child, "_exchange", lambda *_: {"item": {}, "sizes": sizes})
    with pytest.raises(LogError, match="invalid answer"):
        list(parse_file(log, "a log", "hdf5:parse", ["json"]))


def test_columns_of_every_type_arrive_as_they_are(
    log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    columns: list[tuple[str, Any]] = [
        ("floats", np.array([[1.0, np.nan], [np.inf, -0.0], [5e-324, 1e308]]).T),
        ("integers", np.array([2**63 - 1, -(2**63)])),
        ("bytes", np.arange(256, dtype=np.uint8)),
        ("big", np.arange(3, dtype=">i4")),
        ("times", np.array(["2020-01-01T00:00:00.123", "NaT"], "M8[ms]")),
        ("durations", np.array([1, 2], "m8[ns]")),
        ("scalar", np.array(3.0)),
        ("empty", np.empty((0, 3))),
        ("text", TextCell(index=3, text="\udc80 x")),
        ("\ud800", np.zeros(1)),
    ]
    data, buffers = items.build_item(columns, row_count=7, names=[["a"], []])

    def iterate(*_: Any, **__: Any) -> Iterator[tuple[Any, list[bytearray]]]:
        yield json.loads(json.dumps(data)), list(map(bytearray, buffers))

    monkeypatch.setattr(Child, "iterate", iterate)
    (item,) = parse_file(log, "a log", "hdf5:parse", ["json"])
    assert isinstance(item, ParsedItem)
    assert (item.row_count, item.names) == (7, [["a"], []])
    for (name, sent), (arrived_name, arrived) in zip(columns, item.columns, strict=True):
        assert arrived_name == name.replace("\ud800", "?")
        if isinstance(sent, TextCell):
            assert arrived == TextCell(index=3, text="? x")
        else:
            np.testing.assert_array_equal(arrived, sent, strict=name != "big")
