"""MATLAB logs: versions 5 and 7 with SciPy, 7.3 with h5py."""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from scipy.io import savemat

from hesr_model.errors import LogError
from hesr_model.logs.log_format import LogColumns, LogFormat
from hesr_model.logs.readers.matlab import read_matlab
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import RobotDescription

N = 40

HEADER_7_3 = (b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM").ljust(
    512, b"\0"
)

Save = Callable[[Path, Mapping[str, Any]], None]


def content() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(2)
    q, dq, tau = rng.normal(size=(3, N, 2))
    return {"t": 0.01 * np.arange(N)[:, None], "q": q, "dq": dq, "tau": tau}


def robot(columns: LogColumns | None = None, joints: tuple[str, ...] = ("a", "b")) -> Any:
    # No test here opens the model.
    log = LogFormat(columns=columns or LogColumns())
    return RobotDescription(name="two", model=Path("two.urdf"), joints=joints, log=log)


def save_classic(path: Path, data: Mapping[str, Any]) -> None:
    savemat(path, data)


def save_compressed(path: Path, data: Mapping[str, Any]) -> None:
    savemat(path, data, do_compression=True)


def save_hdf5(path: Path, data: Mapping[str, Any]) -> None:
    """Version 7.3: HDF5 after a MATLAB header, arrays transposed, structs as groups."""
    h5py = pytest.importorskip("h5py", reason="needs hesr[formats]")

    def put(group: Any, items: Mapping[str, Any]) -> None:
        for name, value in items.items():
            if isinstance(value, Mapping):
                group.create_group(name).attrs["MATLAB_class"] = np.bytes_("struct")
                put(group[name], value)
            elif isinstance(value, str):
                codes = np.array([[ord(letter)] for letter in value], dtype=np.uint16)
                group[name] = codes
                group[name].attrs["MATLAB_class"] = np.bytes_("char")
            else:
                group[name] = np.transpose(np.atleast_2d(value))
                group[name].attrs["MATLAB_class"] = np.bytes_("double")

    with h5py.File(path, "w", userblock_size=512) as file:
        put(file, data)
        file.create_group("#refs#")["a"] = np.zeros(3)
    with path.open("r+b") as raw:
        raw.write(HEADER_7_3)


SAVES = pytest.mark.parametrize("save", [save_classic, save_compressed, save_hdf5])


def require_content(log: Log) -> None:
    assert log.dq is not None
    np.testing.assert_array_equal(log.t, content()["t"].ravel())
    for name in ("q", "dq", "tau"):
        np.testing.assert_array_equal(getattr(log, name), content()[name])


@SAVES
def test_matrices_are_read_by_the_default_names(tmp_path: Path, save: Save) -> None:
    save(tmp_path / "run.mat", {**content(), "rate": 100.0, "note": "sample"})
    log = Log.read(tmp_path / "run.mat", robot())
    require_content(log)
    assert log.name == "run"
    assert len(log.sha256) == 64


@SAVES
def test_matrices_may_be_transposed(tmp_path: Path, save: Save) -> None:
    save(tmp_path / "run.mat", {name: value.T for name, value in content().items()})
    require_content(Log.read(tmp_path / "run.mat", robot()))


@SAVES
def test_fields_of_structs_are_named_as_in_matlab(tmp_path: Path, save: Save) -> None:
    data = content()
    # As Simulink's "structure with time": signals are n x 1 x N.
    signal = {"values": data["tau"].T[:, None, :]}
    log = {"time": data["t"], "arm": {"q": data["q"], "dq": data["dq"]}, "tau": signal}
    save(tmp_path / "run.mat", {"log": log})
    columns = LogColumns(
        t="log.time", q="log.arm.q{}", dq="log.arm.dq{}", tau=["log.tau.values1", "log.tau.values2"]
    )
    require_content(Log.read(tmp_path / "run.mat", robot(columns)))


def test_elements_of_a_struct_array_are_numbered(tmp_path: Path) -> None:
    data = content()
    signals = np.empty(3, dtype=[("values", object)])
    for k, name in enumerate(("q", "dq", "tau")):
        signals[k]["values"] = data[name]
    save_classic(tmp_path / "run.mat", {"out": {"time": data["t"], "signals": signals}})
    names = {
        name: f"out.signals({k}).values{{}}" for k, name in enumerate(("q", "dq", "tau"), start=1)
    }
    require_content(Log.read(tmp_path / "run.mat", robot(LogColumns(t="out.time", **names))))


@SAVES
def test_vectors_of_one_joint_are_named_one_by_one(tmp_path: Path, save: Save) -> None:
    data = {name: value[:, :1] for name, value in content().items()}
    save(tmp_path / "run.mat", data)
    columns = LogColumns(q=("q",), dq=("dq",), tau=("tau",))
    log = Log.read(tmp_path / "run.mat", robot(columns, ("a",)))
    np.testing.assert_array_equal(log.tau, content()["tau"][:, :1])


@SAVES
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda d: {"time": d["t"], "q": d["q"]},
            r"run\.mat: column 't' is missing; it has (time, q1, q2|q1, q2, time)\.$",
        ),
        (
            lambda d: {"note": f"nothing but {', '.join(d)}"},
            r"run\.mat: has no arrays of numbers",
        ),
        (
            lambda d: {**d, "q": d["q"][:-1]},
            r"run\.mat: column 'q1' is missing; it has .*tau1, tau2.*q \(39 x 2\)",
        ),
        (
            lambda d: {**d, "dq": np.where(np.arange(N)[:, None] == 3, np.nan, d["dq"])},
            "column 'dq1', row 4: an empty",
        ),
        (
            lambda d: {**d, "t": d["t"][::-1].copy()},
            r"run\.mat: column 't', row 2: .* 0\.38 s follows 0\.39 s; \[log\] restart = 'gap'",
        ),
    ],
)
def test_errors_name_the_mistake(
    tmp_path: Path, save: Save, change: Callable[[dict[str, Any]], dict[str, Any]], message: str
) -> None:
    save(tmp_path / "run.mat", change(content()))
    with pytest.raises(LogError, match=message):
        Log.read(tmp_path / "run.mat", robot())


@pytest.mark.parametrize("start", [b"", b"MATLAB 5.0", HEADER_7_3 + b"\x89HDF\r\n\x1a\n"])
def test_other_files_are_refused(tmp_path: Path, start: bytes) -> None:
    path = tmp_path / "run.mat"
    with pytest.raises(LogError, match=r"run\.mat: no such log file\.$"):
        Log.read(path, robot())
    if b"HDF" in start:
        pytest.importorskip("h5py", reason="needs hesr[formats]")
    path.write_bytes(start + bytes(range(256)) * 4)
    with pytest.raises(LogError, match=r"run\.mat: cannot be read as a MATLAB file\.$"):
        Log.read(path, robot())


def test_a_version_4_file_truncated_at_any_byte_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    savemat(path, {"t": np.arange(3.0), "q": np.ones((3, 2))}, format="4")
    assert read_matlab(path, time="t").numbers(["t"])[:, 0].tolist() == [0.0, 1.0, 2.0]
    whole = path.read_bytes()
    first = 20 + 2 + 3 * 8  # header, name, numbers: the rest is a complete file of its own
    for length in range(4, len(whole)):
        path.write_bytes(whole[:length])
        if length == first:
            continue
        with pytest.raises(LogError, match="cannot be read as a MATLAB file"):
            read_matlab(path, time="t")


WRITTEN_BY_MATLAB = Path(scipy.io.__file__).parent / "matlab" / "tests" / "data"
"""SciPy ships files written by MATLAB, of all versions, with objects, functions and damage."""


@pytest.mark.filterwarnings("ignore::scipy.io.matlab.MatReadWarning")  # from the damaged files
def test_matlab_files_are_read_or_refused_in_one_sentence() -> None:
    pytest.importorskip("h5py", reason="needs hesr[formats]")
    files = sorted(WRITTEN_BY_MATLAB.glob("*.mat"))
    if not files:
        pytest.skip("this SciPy was installed without its tests")
    assert len(files) > 50
    for file in files:
        with pytest.raises(LogError, match=r"(is missing|no arrays of numbers|cannot be read as)"):
            read_matlab(file, time="nothing").numbers(["nothing"])
    angles = np.linspace(0.0, 2 * np.pi, 9)
    for file in (*WRITTEN_BY_MATLAB.glob("testdouble_*"), *WRITTEN_BY_MATLAB.glob("testhdf5_*")):
        found = read_matlab(file, time="testdouble").numbers(["testdouble"])
        np.testing.assert_allclose(found[:, 0], angles)


def test_without_h5py_the_install_command_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "run.mat").write_bytes(HEADER_7_3 + b"\x89HDF\r\n\x1a\n")
    monkeypatch.setitem(sys.modules, "h5py", None)
    message = r"run\.mat: MATLAB files need h5py: pip install '.+\[formats\]'"
    with pytest.raises(LogError, match=message):
        Log.read(tmp_path / "run.mat", robot())
