"""Tables of other programs: separators, column names and units."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from hesr_model.errors import LogError
from hesr_model.logs.guess import guess_columns
from hesr_model.logs.log_format import LogColumns, LogCylinder, LogFormat, LogUnits
from hesr_model.logs.robot_log import Log
from hesr_model.logs.tables import read_table, write_table
from hesr_model.robots.robot import RobotDescription

HEADER = ["t", "q1", "q2", "dq1", "dq2", "tau1", "tau2"]

Read = Callable[..., Log]


def rows(count: int = 20) -> np.ndarray:
    """Two joints at 100 Hz; all values differ."""
    values = np.random.default_rng(1).normal(size=(count, 7)).round(6)
    values[:, 0] = 0.01 * np.arange(count)
    return values


@pytest.fixture
def read(tmp_path: Path) -> Read:
    def read_text(text: str, log: LogFormat | None = None, joints: Sequence[str] = "ab") -> Log:
        path = tmp_path / "run.csv"
        path.write_bytes(text.encode())
        # No test here opens the model.
        model = Path("two.urdf")
        robot = RobotDescription(
            name="two", model=model, joints=tuple(joints), log=log or LogFormat()
        )
        return Log.read(path, robot)

    return read_text


def written(
    values: np.ndarray, header: Sequence[str] = HEADER, *, delimiter: str = ",", end: str = "\n"
) -> str:
    lines = [header, *([f"{x:.9g}" for x in row] for row in values)]
    return "".join(delimiter.join(line) + end for line in lines)


def require_equal(log: Log, values: np.ndarray) -> None:
    assert log.dq is not None
    np.testing.assert_array_equal(np.column_stack([log.t, log.q, log.dq, log.tau]), values)


@pytest.mark.parametrize("delimiter", [";", "\t", " "])
def test_other_separators_are_read(read: Read, delimiter: str) -> None:
    require_equal(read(written(rows(), delimiter=delimiter)), rows())


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_decimal_commas_are_read_with_other_separators(read: Read, delimiter: str) -> None:
    require_equal(read(written(rows(), delimiter=delimiter).replace(".", ",")), rows())


def test_decimal_commas_are_found_after_whole_numbers(read: Read) -> None:
    """As a spreadsheet writes a log that begins at rest."""
    values = rows()
    values[:3, 1:] = 0.0
    text = written(values, delimiter=";").replace(".", ",")
    assert "," not in text.splitlines()[1]
    require_equal(read(text), values)


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_names_may_contain_other_separators(read: Read, delimiter: str) -> None:
    values = np.column_stack([rows(), np.ones(len(rows()))])
    text = written(values, [*HEADER, "force, x (N m)"], delimiter=delimiter)
    require_equal(read(text), rows())
    require_equal(read(text.replace(".", ",")), rows())


def test_a_numpy_comment_header_is_read(read: Read, tmp_path: Path) -> None:
    np.savetxt(tmp_path / "saved.csv", rows(), header=" ".join(HEADER), fmt="%.9g")
    text = (tmp_path / "saved.csv").read_text()
    assert text.startswith("# t q1")
    require_equal(read(text), rows())
    require_equal(read("#" + written(rows())), rows())


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            lambda lines: [*lines[:3], lines[3] + ";9", *lines[4:]],
            r"run\.csv: row 4 has 8 cells",
        ),
        (
            lambda lines: [*lines[:3], lines[3].replace(",", "x", 1), *lines[4:]],
            "row 4: '0x02' where a number",
        ),
    ],
)
def test_errors_consider_the_separator(
    read: Read, spoil: Callable[[list[str]], list[str]], message: str
) -> None:
    lines = written(rows(), delimiter=";").replace(".", ",").splitlines()
    with pytest.raises(LogError, match=message):
        read("\n".join(spoil(lines)))


RTDE = [
    "timestamp",
    *(
        f"{quantity}_{k}"
        for quantity in ("actual_q", "actual_qd", "actual_current", "target_moment")
        for k in range(2)
    ),
]
"""As in Universal Robots' recordings: cells separated by blanks, joints counted from 0."""

UR = LogColumns(
    t="timestamp",
    q="actual_q_{0}",
    dq="actual_qd_{0}",
    tau="target_moment_{0}",
    current="actual_current_{0}",
)


def test_a_universal_robots_log_is_read_by_column_names(read: Read) -> None:
    values = np.column_stack([rows(), 2.0 * rows()[:, 5:]])
    text = written(values, RTDE, delimiter=" ", end="\r\n")
    currents = read(text, LogFormat(columns=UR, torque_per_ampere=(10.0, -4.0)))
    np.testing.assert_array_equal(currents.tau, rows()[:, 5:] * [10.0, -4.0])
    np.testing.assert_array_equal(currents.q, rows()[:, 1:3])
    moments = read(text, LogFormat(columns=UR))
    np.testing.assert_array_equal(moments.tau, values[:, 7:])


def test_messages_count_joints_from_zero_as_the_log(read: Read) -> None:
    values = np.column_stack([rows(), rows()[:, 5:]])
    log = LogFormat(columns=UR)
    text = written(values, [name.replace("actual_q_1", "q_1") for name in RTDE], delimiter=" ")
    message = "'actual_q_1' is missing; it has 1"
    with pytest.raises(LogError, match=message):
        read(text, log)
    with pytest.raises(LogError, match="column 'actual_q_1', but the robot"):
        read(written(values, RTDE, delimiter=" "), log, joints=["a"])


def test_temperatures_are_read_if_logged(read: Read, tmp_path: Path) -> None:
    warm = np.column_stack([np.full(len(rows()), 30.0), 25.0 + np.arange(len(rows()))])
    values = np.column_stack([rows(), warm])
    header = ["t", "q1", "q2", "dq1", "dq2", "tau1", "tau2", "temperature1", "temperature2"]
    assert read(written(rows(), header[:7])).temperature is None
    log = read(written(values, header))
    np.testing.assert_array_equal(log.temperature, warm)
    kelvin = LogFormat(units=LogUnits(temperature="K"))
    np.testing.assert_allclose(read(written(values, header), kelvin).temperature, warm - 273.15)
    log.write(tmp_path / "again.csv")
    assert "temperature2" in (tmp_path / "again.csv").read_text(encoding="utf-8")
    assert np.array_equal(log.rows(slice(0, 3)).temperature, warm[:3])
    # The names of Universal Robots' recorder; a named column must exist.
    own = LogFormat(columns=LogColumns(temperature="joint_temperatures_{0}"))
    named = [*header[:7], "joint_temperatures_0", "joint_temperatures_1"]
    np.testing.assert_array_equal(read(written(values, named), own).temperature, warm)
    with pytest.raises(LogError, match="column 'joint_temperatures_0' is missing"):
        read(written(rows(), header[:7]), own)


def test_temperature_columns_are_guessed(tmp_path: Path) -> None:
    names = [*RTDE, "joint_temperatures_0", "joint_temperatures_1"]
    path = tmp_path / "run.csv"
    values = np.column_stack([rows(), 2.0 * rows()[:, 5:], rows()[:, 5:]])
    path.write_text(written(values, names), encoding="utf-8")
    found = guess_columns(read_table(path)).columns
    assert found["temperature"] == ("joint_temperatures_0", "joint_temperatures_1")
    assert found["q"] == ("actual_q_0", "actual_q_1")


def test_columns_may_be_named_after_the_joints(read: Read) -> None:
    columns = LogColumns(q="{name}_pos", dq="{name}_vel", tau="{name}_eff")
    header = ["t", "lift_pos", "tilt_pos", "lift_vel", "tilt_vel", "lift_eff", "tilt_eff"]
    log = LogFormat(columns=columns)
    require_equal(read(written(rows(), header), log, ["lift", "tilt"]), rows())
    # A robot may use a subset of the logged joints.
    assert read(written(rows(), header), log, ["tilt"]).q.tolist() == rows()[:, 2:3].tolist()
    with pytest.raises(LogError, match=r"column 'turn_pos' is missing; it has t, lift_pos, tilt"):
        read(written(rows(), header), log, ["turn"])


UNITS = [
    (LogUnits(t="ms"), 0, 1e-3),
    (LogUnits(t="us"), 0, 1e-6),
    (LogUnits(t="ns"), 0, 1e-9),
    (LogUnits(q="deg"), slice(1, 3), np.pi / 180),
    (LogUnits(q="rev"), slice(1, 3), 2 * np.pi),
    (LogUnits(q=("mm", "deg")), slice(1, 3), [1e-3, np.pi / 180]),
    (LogUnits(dq="deg/s"), slice(3, 5), np.pi / 180),
    (LogUnits(dq="rpm"), slice(3, 5), 2 * np.pi / 60),
    (LogUnits(dq="rev/s"), slice(3, 5), 2 * np.pi),
    (LogUnits(dq=("mm/s", "m/s")), slice(3, 5), [1e-3, 1.0]),
    (LogUnits(tau="mN.m"), slice(5, 7), 1e-3),
    (LogUnits(tau=("N", "N.m")), slice(5, 7), 1.0),
]


@pytest.mark.parametrize(("units", "columns", "factor"), UNITS)
def test_units_are_converted_to_si(
    read: Read, units: LogUnits, columns: int | slice, factor: float | list[float]
) -> None:
    expected = rows()
    expected[:, columns] *= factor
    log = read(written(rows()), LogFormat(units=units))
    assert log.dq is not None
    found = np.column_stack([log.t, log.q, log.dq, log.tau])
    np.testing.assert_allclose(found, expected, rtol=1e-15)


def test_milliamperes_are_converted_to_torques(read: Read) -> None:
    header = [name.replace("tau", "i") for name in HEADER]
    log = LogFormat(units=LogUnits(current="mA"), torque_per_ampere=(10.0, -4.0))
    expected = rows()[:, 5:] * [0.01, -0.004]
    np.testing.assert_allclose(read(written(rows(), header), log).tau, expected, rtol=1e-15)


def test_an_odd_rate_suggests_another_time_unit(read: Read) -> None:
    values = rows()
    values[:, 0] *= 1e3
    with pytest.raises(LogError, match=r"; give the unit of time, 'log\.units\.t'\.$"):
        read(written(values), LogFormat(sample_rate=100.0))
    log = read(written(values), LogFormat(sample_rate=100.0, units=LogUnits(t="ms")))
    assert log.period == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("header", "columns"),
    [
        ("t,pos,i_q,i_d", {"t": "t", "q": ("pos",), "current": ("i_q",)}),
        ("time,angle,iq", {"t": "time", "q": ("angle",), "current": ("iq",)}),
        (
            "Zeit,Winkel,Drehzahl,Drehmoment",
            {"t": "Zeit", "q": ("Winkel",), "dq": ("Drehzahl",), "tau": ("Drehmoment",)},
        ),
    ],
)
def test_names_of_single_motors_are_guessed(
    header: str, columns: dict[str, object], tmp_path: Path
) -> None:
    path = tmp_path / "motor.csv"
    rows = [",".join([f"{0.01 * k:.2f}", *["0.5"] * header.count(",")]) for k in range(20)]
    path.write_text("\n".join([header, *rows]), encoding="utf-8")
    assert guess_columns(read_table(path)).columns == columns


def test_a_column_of_dates_is_the_time(tmp_path: Path) -> None:
    path = tmp_path / "motor.csv"
    rows = [f"2026-01-02T03:04:{k:02d}.5,0.1,0.2" for k in range(20)]
    path.write_text("\n".join(["datetime,q,tau", *rows]), encoding="utf-8")
    assert guess_columns(read_table(path)).columns["t"] == "datetime"


def test_types_follow_from_all_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stamp, a number with gaps, a truth value, quoted cells, and text late in the file."""
    monkeypatch.setattr("hesr_model.logs.csv_text._CHUNK_CELLS", 25)
    stamps = 1_700_000_000_123_456_789 + 10_000_000 * np.arange(40)
    path = tmp_path / "run.csv"
    rows = [f"{s},{'' if k == 21 else k / 8},{k % 2},{k}" for k, s in enumerate(stamps)]
    rows[8] = rows[8].replace(",0,", ",false,")
    rows[33] += "x"
    rows[17] = rows[17].replace(",17", ',"17"')
    path.write_text("\n".join(["t,q,on,word", *rows, "# end"]) + "\n", encoding="utf-8")
    table = read_table(path)
    assert table.rows == 40
    np.testing.assert_array_equal(table.times("t", 1e-9), (stamps - stamps[0]) * 1e-9, strict=True)
    assert table.times("t", 1e-9)[1] == 0.01
    numbers = np.where(np.arange(40) == 21, np.nan, np.arange(40) / 8)
    found = table.numbers(["q", "on"], missing=True)
    np.testing.assert_array_equal(found, np.column_stack([numbers, np.arange(40) % 2]))
    with pytest.raises(LogError, match=r"column 'q', row 23: an empty cell or NaN"):
        table.numbers(["q"])
    with pytest.raises(LogError, match=r"'word', row 35: '33x' where a number"):
        table.numbers(["word"])
    path.write_text('t,q,on,word\n0,1,2,3\n1,2,3,"4\n"\n2,3,4,5\n', encoding="utf-8")
    with pytest.raises(LogError, match=r"run\.csv: cannot be read as CSV text\.$"):
        read_table(path)


@pytest.mark.parametrize(
    "stamps",
    [
        ["2026-01-01 10:00:00", "2026-01-01 10:00:01", "2026-01-01 10:00:03"],
        ["2026-01-01T10:00:00.25Z", "2026-01-01T10:00:01.25Z", "2026-01-01T10:00:03.25Z"],
        ["2026-01-01T10:00+01:00", "2026-01-01T09:00:01Z", "2026-01-01T10:00:03+01"],
    ],
)
def test_dates_may_have_zones_and_gaps(stamps: list[str], tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    rows = [f"{stamp},1.5,2.5" for stamp in (*stamps[:2], "", stamps[2])]
    path.write_text("\n".join(["t,q1,dq1", *rows]) + "\n", encoding="utf-8")
    table = read_table(path)
    np.testing.assert_array_equal(table.times("t", 1.0, missing=True), [0.0, 1.0, np.nan, 3.0])
    with pytest.raises(LogError, match="column 't', row 4: an empty cell or NaN"):
        table.times("t", 1.0)
    with pytest.raises(LogError, match=r"column 't', row 2: '2026-01-01T.*' where a number"):
        table.numbers(["t"])


def test_only_dates_are_times(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t,q1,dq1\nnow,1.5,2.5\ntoday,1.5,2.5\n", encoding="utf-8")
    with pytest.raises(LogError, match="column 't', row 2: 'now' where a number"):
        read_table(path).times("t", 1.0)


def test_written_names_and_numbers_are_read_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A name with a comma, as FMI arrays have, and numbers of all sizes, in several blocks."""
    monkeypatch.setattr("hesr_model.logs.tables._CHUNK_ROWS", 7)
    random = np.random.default_rng(1)
    sizes = 10.0 ** random.integers(-300, 300, 20)
    columns = {"t": np.arange(20), "a.q[1,2]": random.normal(size=20) * sizes, 'the "y"': -sizes}
    write_table(tmp_path / "out.csv", columns)
    table = read_table(tmp_path / "out.csv")
    assert table.names == tuple(columns)
    np.testing.assert_array_equal(
        table.numbers(table.names), np.column_stack(list(columns.values()))
    )


@pytest.mark.parametrize("unit", ["Pa", "kPa", "bar", "MPa"])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_each_cylinder_has_the_force_of_its_two_pressures(unit: str, count: int) -> None:
    names = [(f"a{i}", f"b{i}") for i in range(count)]
    areas = [(1e-3 * (i + 2), 1e-3 * (i + 1)) for i in range(count)]
    cylinder = LogCylinder.model_validate({"pressures": names, "areas": areas, "unit": unit})
    pressures = np.random.default_rng(2).uniform(1.0, 200.0, (5, 2 * count))
    forces, loads = cylinder.forces(pressures)
    pascals = {"Pa": 1.0, "kPa": 1e3, "bar": 1e5, "MPa": 1e6}[unit] * pressures
    assert forces.shape == loads.shape == (5, count)
    for i, (first, second) in enumerate(areas):
        one, other = pascals[:, 2 * i], pascals[:, 2 * i + 1]
        np.testing.assert_allclose(forces[:, i], first * one - second * other, rtol=1e-9)
        mean = (first + second) / 2.0
        np.testing.assert_allclose(loads[:, i], mean * (one - other), rtol=1e-9)
