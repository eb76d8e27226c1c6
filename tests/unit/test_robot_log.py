from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from hesr_model.errors import ArtifactError, LogError
from hesr_model.logs.log_format import LogColumns, LogFormat, LogUnits
from hesr_model.logs.robot_log import Log, require_different, require_moving
from hesr_model.robots.robot import RobotDescription
from hesr_model.support.files import sha256

HEADER = "t,q1,q2,dq1,dq2,tau1,tau2"


def row(k: int, **cells: str) -> str:
    """One row of a two-joint log at 100 Hz, with some cells replaced."""
    values = dict.fromkeys(HEADER.split(","), "0.5") | {"t": f"{0.01 * k:.3f}"} | cells
    return ",".join(values.values())


def lines(count: int = 20) -> list[str]:
    return [HEADER, *(row(k) for k in range(count))]


@pytest.fixture
def robot() -> RobotDescription:
    # No test here opens the model.
    return RobotDescription(name="two", model=Path("two.urdf"), joints=("a", "b"))


@pytest.fixture
def read(tmp_path: Path, robot: RobotDescription) -> Callable[..., Log]:
    def read_lines(text: list[str], log: LogFormat | None = None) -> Log:
        path = tmp_path / "run.csv"
        path.write_text("\n".join(text) + "\n", encoding="utf-8")
        return Log.read(path, robot.model_copy(update={"log": log or LogFormat()}))

    return read_lines


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_written_log_is_read_back_bit_for_bit(
    suffix: str, tmp_path: Path, arm_log: Log, arm: RobotDescription
) -> None:
    path = tmp_path / f"out{suffix}"
    arm_log.write(path)
    back = Log.read(path, arm)
    assert back.dq is not None
    for name in ("t", "q", "dq", "tau"):
        np.testing.assert_array_equal(getattr(back, name), getattr(arm_log, name))
    assert (back.name, back.path, back.sha256) == ("out", path, sha256(path))


def test_a_log_without_velocity_is_written_and_read_back(
    tmp_path: Path, arm_log: Log, arm: RobotDescription
) -> None:
    path = tmp_path / "out.csv"
    replace(arm_log, dq=None).write(path)
    log = LogFormat(columns=LogColumns(dq=""))
    assert Log.read(path, arm.model_copy(update={"log": log})).dq is None


def test_an_unwritable_log_names_its_path(tmp_path: Path, arm_log: Log) -> None:
    (tmp_path / "taken").write_text("", encoding="utf-8")
    with pytest.raises(ArtifactError, match=r"taken/out\.csv: cannot be written there"):
        arm_log.write(tmp_path / "taken" / "out.csv")


def test_gains_convert_currents_to_torques(read: Callable[..., Log]) -> None:
    text = [line.replace("tau", "i") for line in lines()]
    log = read(text, LogFormat(torque_per_ampere=(10.0, -4.0)))
    np.testing.assert_array_equal(log.tau[0], [5.0, -2.0])


def test_gains_do_not_change_a_log_of_torques(read: Callable[..., Log]) -> None:
    log = read(lines(), LogFormat(torque_per_ampere=(10.0, -4.0)))
    np.testing.assert_array_equal(log.tau[0], [0.5, 0.5])


def test_columns_can_be_named_one_by_one(read: Callable[..., Log]) -> None:
    text = [HEADER.replace("q1", "q_lift") + ",mode", *(row(k) + ",run" for k in range(20))]
    log = read(text, LogFormat(columns=LogColumns(q=("q_lift", "q2"), dq=("dq_lift", "dq2"))))
    assert log.q.shape == (20, 2)


def test_a_late_decimal_in_an_integer_column_is_read(read: Callable[..., Log]) -> None:
    # Types must not be inferred from the first block of a large file alone.
    count = 40_000
    text = [HEADER, *(row(k, q1="1") for k in range(count)), row(count, q1="0.25")]
    assert read(text).q[-1, 0] == 0.25


def test_blanks_and_byte_order_marks_do_not_matter(read: Callable[..., Log]) -> None:
    text = ["\ufeff" + HEADER.replace(",", ", "), "", *(row(k) for k in range(5)), "", ""]
    assert len(read(text).t) == 5


def test_other_files_are_refused(tmp_path: Path, robot: RobotDescription) -> None:
    path = tmp_path / "run.csv"
    with pytest.raises(LogError, match=r"run\.csv: no such log file\.$"):
        Log.read(path, robot)
    path.write_bytes(b"")
    with pytest.raises(LogError, match="log needs a header and rows"):
        Log.read(path, robot)
    path.write_bytes(b"\n\n")
    with pytest.raises(LogError, match="log needs a header and rows"):
        Log.read(path, robot)
    path.write_bytes(b"t")
    with pytest.raises(LogError, match=r"run\.csv: has no rows of data"):
        Log.read(path, robot)
    path.write_bytes(bytes(range(256)) * 4)
    with pytest.raises(LogError, match=r"run\.csv: cannot be read as CSV text\.$"):
        Log.read(path, robot)
    parquet = tmp_path / "run.parquet"
    parquet.write_bytes(b"not parquet")
    with pytest.raises(LogError, match=r"run\.parquet: cannot be read as Parquet\.$"):
        Log.read(parquet, robot)


MESSAGES = [
    (lambda t: t[:1], "rows of data below its header"),
    (lambda t: t[:2], "has 1 rows of data"),
    (
        lambda t: [HEADER.replace("dq2", "v"), *t[1:]],
        "column 'dq2' is missing; it has",
    ),
    (
        lambda t: [HEADER.replace("dq", "v"), *t[1:]],
        r"column 'dq1' is missing; it has t, q1, q2, v1, v2, tau1, tau2\.$",
    ),
    (
        lambda t: [HEADER.replace("q1", "q3"), *t[1:]],
        r"column 'q1' is missing; it has t, q3, q2",
    ),
    (
        lambda t: [HEADER.replace("t,", "time,"), *t[1:]],
        r"column 't' is missing; it has time, q1",
    ),
    (
        lambda t: [HEADER.replace("q2", "q1"), *t[1:]],
        r"column 'q1' occurs twice; names must differ\.$",
    ),
    (
        lambda t: [HEADER + ",q3", *(line + ",0" for line in t[1:])],
        "column 'q3', but the robot",
    ),
    (
        lambda t: [HEADER.replace("tau", "m"), *t[1:]],
        r"column 'tau1' \(torque\) or 'i1' \(current\)",
    ),
    (
        lambda t: [HEADER.replace("tau", "i"), *t[1:]],
        r"currents in 'i1' add 'log\.torque_per_ampere'",
    ),
    (lambda t: [*t[:4], "0.03,1,2", *t[4:]], "row 5 has 3 cells"),
    (lambda t: [*t[:4], row(3) + ",9", *t[4:]], "row 5 has 8 cells"),
    (
        lambda t: [*t[:4], row(3, q2="nan"), *t[5:]],
        "column 'q2', row 5: an empty",
    ),
    (lambda t: [*t[:4], row(3, tau1=""), *t[5:]], r"column 'tau1', row 5: an empty cell or NaN"),
    (lambda t: [*t[:4], row(3, dq1="-inf"), *t[5:]], r"column 'dq1', row 5: infinity where"),
    (
        lambda t: [*t[:4], row(3, q2="0_5"), *t[5:]],
        "row 5: '0_5' where a number",
    ),
    (
        lambda t: [t[0], "", *t[1:4], row(3, q2="x"), *t[5:]],
        "row 6: 'x' where a number",
    ),
    (
        lambda t: [*t[:4], row(2), *t[5:]],
        r"row 5: .* 0\.02 s follows 0\.02 s; \[log\]",
    ),
]


@pytest.mark.parametrize(("spoil", "message"), MESSAGES)
def test_an_error_names_the_file_the_column_and_the_row(
    spoil: Callable[[list[str]], list[str]], message: str, read: Callable[..., Log]
) -> None:
    with pytest.raises(LogError, match=r"run\.csv: .*" + message):
        read(spoil(lines()))


def test_two_logs_in_one_file_are_reported(read: Callable[..., Log]) -> None:
    text = [HEADER, *(row(k) for k in [*range(50), *range(50)])]
    with pytest.raises(LogError, match=r"\[log\] restart = 'gap'"):
        read(text)


def test_a_log_is_split_at_missing_rows(read: Callable[..., Log]) -> None:
    text = [HEADER, *(row(k) for k in [*range(150), *range(200, 220), *range(240, 350)])]
    first, last = read(text).parts()
    assert (first.t[-1], last.t[0]) == pytest.approx((1.49, 2.40))
    assert len(last.t) == 110  # the 20 rows between the gaps are too few


def test_a_log_of_gaps_is_refused(read: Callable[..., Log]) -> None:
    text = [HEADER, *(row(k) for k in [*range(20), *range(40, 60)])]
    with pytest.raises(LogError, match=r"0\.1 s, 10 usual steps, leave"):
        read(text).parts()


def test_randomly_lost_rows_are_not_gaps(read: Callable[..., Log]) -> None:
    """Half of the steps then are one period long, and some longer than ten."""
    kept = np.flatnonzero(np.random.default_rng(1).random(9000) < 0.5)
    log = read([HEADER, *(row(int(k)) for k in kept)])
    assert np.max(np.diff(log.t)) > 10 * log.period
    assert len(log.parts()) == 1
    assert log.rate == pytest.approx(50.0, rel=0.03)


def test_rows_without_a_number_or_a_new_stamp_are_dropped(read: Callable[..., Log]) -> None:
    text = [HEADER, *(row(k) for k in range(20))]
    text[4], text[7], text[9] = row(3, q2="nan"), row(6, tau1=""), row(7)
    log = read(text, LogFormat(missing="drop"))
    assert log.dropped == 3
    assert log.t == pytest.approx([0.01 * k for k in range(20) if k not in (3, 6, 8)])


@pytest.mark.parametrize(("scale", "unit"), [(1e9, "ns"), (1.0, "s")])
def test_stamps_since_1970_are_counted_from_the_first_row(
    scale: float, unit: str, read: Callable[..., Log]
) -> None:
    stamps = [
        str(round((1_600_000_000 + 0.01 * k) * scale))
        if unit == "ns"
        else f"{1.6e9 + 0.01 * k:.4f}"
        for k in range(20)
    ]
    text = [HEADER, *(row(k, t=stamp) for k, stamp in enumerate(stamps))]
    log = read(text, LogFormat(units=LogUnits(t=unit)))
    assert log.t == pytest.approx(0.01 * np.arange(20), abs=1e-6)


def test_dates_are_accepted_as_stamps(read: Callable[..., Log]) -> None:
    text = [HEADER, *(row(k, t=f"2026-01-01 10:00:0{0.01 * k:.3f}") for k in range(20))]
    assert read(text).t == pytest.approx(0.01 * np.arange(20), abs=1e-9)


def test_comments_and_units_around_a_header_are_skipped(read: Callable[..., Log]) -> None:
    data = [row(k) for k in range(20)]
    text = ["# recorder 3, cell 5", "% robot: arm", HEADER, "[s],rad,rad,rad/s,rad/s,N.m,N.m"]
    log = read([*text, *data[:5], "# the operator came in", *data[5:]])
    assert log.t == pytest.approx(0.01 * np.arange(20))
    with pytest.raises(LogError, match="column 'q2', row 12: 'x' where a number"):
        read([*text, *data[:5], "# the operator", data[5], row(6, q2="x"), *data[7:]])


def test_joints_may_count_backwards_or_from_another_number(read: Callable[..., Log]) -> None:
    text = [HEADER, *(row(k, q1="2", q2="90") for k in range(20))]
    log = read(text, LogFormat(units=LogUnits(q=(0.5, "-deg")), zero=(1.0, 0.0)))
    assert log.q[0] == pytest.approx([2.0, -np.pi / 2])


def test_time_in_milliseconds_is_detected(read: Callable[..., Log]) -> None:
    text = [HEADER, *(row(k, t=str(10 * k)) for k in range(20))]
    message = r"94 Hz means 0\.01064 s"
    with pytest.raises(LogError, match=message):
        read(text, LogFormat(sample_rate=94.0))


def test_rows_of_parquet_are_counted_from_one(tmp_path: Path, robot: RobotDescription) -> None:
    columns = {name: np.full(5, 0.5) for name in HEADER.split(",")}
    columns["t"] = 0.01 * np.arange(5)
    columns["q2"][3] = np.nan
    path = tmp_path / "run.parquet"
    pyarrow.parquet.write_table(pyarrow.table(columns), path)
    with pytest.raises(LogError, match=r"run\.parquet: column 'q2', row 4: an empty cell or NaN"):
        Log.read(path, robot)


def test_a_parquet_column_of_another_type_is_refused(
    tmp_path: Path, robot: RobotDescription
) -> None:
    columns = {name: [[0.5], [0.5, 1.0]] * 5 for name in HEADER.split(",")}
    path = tmp_path / "run.parquet"
    pyarrow.parquet.write_table(pyarrow.table(columns), path)
    with pytest.raises(
        LogError, match=r"run\.parquet: column 't', row 1: 'lists of 1 to 2 .* where a"
    ):
        Log.read(path, robot)


def test_a_joint_at_rest_in_all_logs_is_named(arm_log: Log) -> None:
    still = replace(arm_log, q=arm_log.q * [1.0, 0.0, 1.0], path=Path("still.csv"))
    require_moving([still, arm_log], ("j1", "j2", "j3"))
    with pytest.raises(LogError, match=r"^still\.csv: the position of joint 'j2' is constant"):
        require_moving([still], ("j1", "j2", "j3"))


def test_a_file_counts_once_although_its_parts_are_several_logs(read: Callable[..., Log]) -> None:
    log = read(lines())
    parts = [log.rows(slice(8)), log.rows(slice(8, None))]
    require_different(parts)
    require_different([replace(log, sha256=""), replace(log, sha256="")])  # without a file
    with pytest.raises(LogError, match=r"same content as .*run\.csv"):
        require_different([*parts, parts[0]])
