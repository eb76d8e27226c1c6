"""Logs as recorders, scopes, controllers and spreadsheets write them: read, or refused by content.

Angles are in radians unless a header, a row of units or a cell says otherwise.
"""

import datetime
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from containing import OneSentence

from hesr_model.errors import LogError
from hesr_model.health.joints import apply_changes
from hesr_model.health.proposal import inspect_logs
from hesr_model.logs.robot_log import Log

ROWS = 400
EPOCH = 1_700_000_000
T = np.round(0.01 * np.arange(ROWS), 6)
Q = np.round(np.sin(2.0 * T) + 0.4 * np.sin(5.1 * T), 6)
DQ = np.round(2.0 * np.cos(2.0 * T) + 2.04 * np.cos(5.1 * T), 6)
TAU = np.round(0.3 * np.tanh(DQ / 0.05) + 0.02 * DQ + 0.01 * np.sin(97.0 * T), 6)
OTHER = np.column_stack([0.7 * Q + 0.1, 0.7 * DQ, 0.2 * np.tanh(DQ / 0.05) + 0.03 * DQ])
DEGREES = 180.0 / np.pi
START = datetime.datetime(2024, 1, 1, tzinfo=datetime.UTC)


@dataclass(frozen=True)
class Row:
    """Numbers of a row: time, and the motion of one joint and of a second one."""

    k: int
    t: float
    q: float
    dq: float
    tau: float
    q2: float
    dq2: float
    tau2: float

    @property
    def seconds(self) -> str:
        return str(EPOCH + int(self.t + 1e-9))

    @property
    def nanoseconds(self) -> str:
        return str(round(self.t % 1.0 * 1e9))

    @property
    def date(self) -> str:
        return (
            (START + datetime.timedelta(seconds=self.t)).isoformat(sep=" ").removesuffix("+00:00")
        )


TABLE = [
    Row(k, *(round(float(value), 6) for value in numbers))
    for k, numbers in enumerate(np.column_stack([T, Q, DQ, TAU, OTHER]))
]


def write(
    header: str, cells: Callable[[Row], Sequence[Any]], delimiter: str = ",", above: str = ""
) -> str:
    """Return a text with a row of cells for each row of the table."""
    lines = [delimiter.join(format_cell(cell) for cell in cells(row)) for row in TABLE]
    return above + "\n".join([*filter(None, [header]), *lines]) + "\n"


def format_cell(cell: Any) -> str:
    return f"{cell:.6f}" if isinstance(cell, float) else str(cell)


def plain(row: Row) -> list[float]:
    return [row.t, row.q, row.dq, row.tau]


def in_degrees(row: Row) -> list[float]:
    return [1e3 * row.t, DEGREES * row.q, DEGREES * row.dq, row.tau]


def of_two(row: Row) -> list[float]:
    return [row.q, row.q2, row.dq, row.dq2, row.tau, row.tau2]


def name_two(pattern: str) -> str:
    """Return six names of a pattern with the quantity in braces and # for the number."""
    names = ("position", "velocity", "effort")
    return ",".join(pattern.format(name).replace("#", number) for name in names for number in "01")


def as_list(opening: str, closing: str, *values: float) -> str:
    return f'"{opening}{", ".join(map(format_cell, values))}{closing}"'


# Text, the number of its joints, and what is left over.
READ: dict[str, tuple[str, int, set[str]]] = {
    "rostopic echo.csv": (
        write(
            "%time,field.header.seq,field.header.frame_id," + name_two("field.{}#"),
            lambda row: [f"{EPOCH + row.t:.2f}".replace(".", "") + "0000000", row.k, "base",
                         *of_two(row)],
        ), 2, {"field.header.seq", "field.header.frame_id"}),
    "a plot of topics.csv": (
        write(
            "__time,/states/j1/position,/states/j2/position,/states/j1/velocity,"
            "/states/j2/velocity,/states/j1/effort,/states/j2/effort",
            lambda row: [float(EPOCH + row.t), *of_two(row)],
        ), 2, set()),
    "seconds and nanoseconds.csv": (
        write(
            "topic,header.stamp.sec,header.stamp.nsec," + name_two("{}[#]"),
            lambda row: ["/states", row.seconds, row.nanoseconds, *of_two(row)],
        ), 2, {"topic"}),
    "tuples of a bag.csv": (
        write(
            "stamp,name,position,velocity,effort",
            lambda row: [float(EPOCH + row.t), "\"('j1', 'j2')\"",
                         as_list("(", ")", row.q, row.q2), as_list("(", ")", row.dq, row.dq2),
                         as_list("(", ")", row.tau, row.tau2)],
        ), 2, {"name"}),
    "arrays of a topic.csv": (
        write(
            "time;position;velocity;effort",
            lambda row: [row.t, as_list("array('d', [", "])", row.q, row.q2),
                         as_list("array('d', [", "])", row.dq, row.dq2),
                         as_list("array('d', [", "])", row.tau, row.tau2)],
            ";",
        ), 2, set()),
    "a timetable.csv": (
        write("Time,q_1,qd_1,tau_1", lambda row: [f"{row.t:g} sec", *plain(row)[1:]]), 1, set()),
    "durations.csv": (
        write("Time,q1,dq1,tau1", lambda row: [f"10:59:{57 + row.t:06.3f}" if row.t < 3.0
                                               else f"11:00:{row.t - 3.0:06.3f}", *plain(row)[1:]]),
        1, set()),
    "a controller's recorder.csv": (
        write(
            "timestamp actual_q_0 actual_q_1 actual_qd_0 actual_qd_1 actual_current_0 "
            "actual_current_1 robot_mode",
            lambda row: [row.t + 1000.0, *of_two(row), 7], " ",
        ), 2, {"robot_mode"}),
    "a trace with decimal commas.dat": (
        write(
            "Zeit[s]\tAxisAct A1 [Grad]\tAxisVel A1 [Grad/s]\tMotorMoment A1 [Nm]",
            lambda row: [row.t, *in_degrees(row)[1:]], "\t", "Trace\n[Kanal 1]\n",
        ).replace(".", ","), 1, set()),
    "torques and their estimates.csv": (
        write(
            "time,q[0],q[1],dq[0],dq[1],tau_J[0],tau_J[1],tau_ext_hat[0]",
            lambda row: [row.t, *of_two(row), 0.01],
        ), 2, {"tau_ext_hat[0]"}),
    "an index without a name.csv": (
        write(",t,q1,dq1,tau1", lambda row: [row.k, *plain(row)]), 1, {"Unnamed: 0"}),
    "dates without a name.csv": (
        write(",q1,dq1,tau1", lambda row: [row.date, *plain(row)[1:]]), 1, set()),
    "a spreadsheet.csv": (
        write(
            "Zeit [s];Position [°];Geschwindigkeit [°/s];Drehmoment [Nm]",
            lambda row: [row.t, *in_degrees(row)[1:]], ";", "\ufeffsep=;\n",
        ).replace(".", ","), 1, set()),
    "a row of units in brackets.csv": (
        write("time,pos,vel,trq\n[ms],[deg],[deg/s],[Nm]", in_degrees), 1, set()),
    "a row of units.csv": (
        write("time,pos,vel,trq\nms,deg,deg/s,Nm", in_degrees), 1, set()),
    "units above names.csv": (
        write("[ms],[deg],[deg/s],[Nm]\ntime,pos,vel,trq", in_degrees), 1, set()),
    "units above descriptions.csv": (
        write("time,pos,vel,trq\nms,deg,deg/s,Nm\ntime,axis angle,axis speed,axis torque",
              in_degrees), 1, set()),
    "a row of units of some columns.csv": (
        write("time,pos,vel,trq,mode\nms,deg,deg/s,,-", lambda row: [*in_degrees(row), 1]),
        1, {"mode"}),
    "a comment of units.csv": (
        write("# time,pos,vel,trq\n# ms,deg,deg/s,Nm", in_degrees), 1, set()),
    "units behind slashes.csv": (
        write("time / ms,angle / deg,speed / (deg/s),torque / Nm", in_degrees), 1, set()),
    "units in angle brackets.csv": (
        write("time <ms>,angle <deg>,speed <deg/s>,torque <Nm>", in_degrees), 1, set()),
    "units in braces.csv": (
        write("time {ms},angle {deg},speed {deg/s},torque {Nm}", in_degrees), 1, set()),
    "units behind underscores.csv": (
        write("time_ms,angle_deg,speed_deg_s,torque_Nm", in_degrees), 1, set()),
    "units behind commas.csv": (
        write('"time, ms";"angle, deg";"speed, deg/s";"torque, Nm"', in_degrees, ";"), 1, set()),
    "signals of axes.log": (
        write(
            "Time [s]\tSignal 1: position, axis 1 [rad]\tSignal 2: speed, axis 1 [rad/s]"
            "\tSignal 3: torque, axis 1 [Nm]", plain, "\t", "Signal viewer\nDate: today\n\n",
        ), 1, set()),
    "a simulator.csv": (
        write("step,sim_time,qpos_0,qvel_0,qfrc_actuator_0", lambda row: [row.k, *plain(row)]),
        1, {"step"}),
    "a time series database.csv": (
        write(
            ",result,table,_time,pos,vel,torque",
            lambda row: ["", "_result", 0, f"{row.date.replace(' ', 'T')}Z", *plain(row)[1:]],
            above="#group,false,false,true,true\n#default,_result,,,\n",
        ), 1, {"result", "table"}),
}  # fmt: skip

# Text, and what the refusal names.
REFUSED: dict[str, tuple[str, tuple[str, ...]]] = {
    "a topic without a header.csv": (
        write("", lambda row: [row.seconds, row.nanoseconds, "", "j1", *plain(row)[1:]]),
        ("has no header", "j1, 0.000000", "name its 7 columns")),
    "thousands.csv": (
        write("t;q1;dq1;tau1", lambda row: [*plain(row)[:3], f"{2000.0 + row.tau:,.2f}"], ";"),
        ("column 'tau1', row 2", "'2,000.38'")),
    "two rows of names.csv": (
        write("t,q,q,dq,dq,tau,tau\n,j1,j2,j1,j2,j1,j2", lambda row: [row.t, *of_two(row)]),
        ("column 'j1' occurs twice",)),
    "names in cells.log": (
        write("", lambda row: [f"q={row.q:.6f}", f"dq={row.dq:.6f}", f"tau={row.tau:.6f}"]),
        ("no column looks like time", "q=0.000000")),
    "a time for each signal.csv": (
        write("Name;Pos;Name;Vel", lambda row: [row.t, row.q, row.t, row.dq], ";"),
        ("column 'Name' occurs twice",)),
}  # fmt: skip


@pytest.mark.parametrize("name", READ)
def test_a_recorded_file_is_read(name: str, tmp_path: Path) -> None:
    text, joint_count, left_over = READ[name]
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    proposal = inspect_logs([path])
    (log,) = proposal.logs
    np.testing.assert_allclose(log.t - log.t[0], T, atol=2e-6)
    q = [Q, OTHER[:, 0]][:joint_count]
    dq = [DQ, OTHER[:, 1]][:joint_count]
    tau = [TAU, OTHER[:, 2]][:joint_count]
    for signal, expected in ((log.q, q), (log.dq, dq), (log.tau, tau)):
        np.testing.assert_allclose(signal, np.column_stack(expected), atol=2e-6)
    shown = {left_name.partition(" (no numbers)")[0] for left_name in log.left_over}
    assert left_over <= shown
    assert not [finding for finding in proposal.examination.findings if finding.severity == "error"]


@pytest.mark.parametrize("name", REFUSED)
def test_a_refusal_names_the_content(name: str, tmp_path: Path) -> None:
    text, parts = REFUSED[name]
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    with pytest.raises(LogError) as refusal:
        inspect_logs([path])
    assert str(refusal.value) == OneSentence(*parts)


@pytest.mark.parametrize("key", ["t", "q", "dq"])
def test_a_row_of_units_outranks_no_robot_file(key: str, tmp_path: Path) -> None:
    """A robot file with other units is refused; before, the row was skipped."""
    path = tmp_path / "run.csv"
    path.write_text(READ["a row of units.csv"][0], encoding="utf-8")
    description = inspect_logs([path]).description
    assert Log.read(path, description).q.shape == (ROWS, 1)
    default = {"t": "s", "q": "rad", "dq": "rad/s"}[key]
    with pytest.raises(LogError) as refusal:
        Log.read(path, apply_changes(description, {f"log.units.{key}": default}))
    assert (refusal.value.code, refusal.value.key) == ("log.unit_of_cells", f"log.units.{key}")


def test_a_size_in_the_robot_file_outranks_a_row_of_units(tmp_path: Path) -> None:
    """It may contain the gear of a motor."""
    path = tmp_path / "run.csv"
    path.write_text(READ["a row of units.csv"][0], encoding="utf-8")
    description = inspect_logs([path]).description
    geared = apply_changes(description, {"log.units.q": 0.01 / DEGREES})
    np.testing.assert_allclose(Log.read(path, geared).q[:, 0], 0.01 * Q, atol=1e-7)


def test_names_of_the_robot_file_keep_the_row_of_units(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(READ["a row of units.csv"][0], encoding="utf-8")
    description = inspect_logs([path]).description
    columns = description.log.columns.model_copy(
        update={"names": ("time", "pos", "vel", "trq"), "q": ("pos",)}
    )
    log_format = description.log.model_copy(update={"columns": columns})
    named = description.model_copy(update={"log": log_format})
    np.testing.assert_allclose(Log.read(path, named).q[:, 0], Q, atol=1e-7)
    with pytest.raises(LogError) as refusal:
        Log.read(path, apply_changes(named, {"log.units.q": "rad"}))
    assert refusal.value.code == "log.unit_of_cells"


def test_units_of_data_sets_are_read(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="needs hesr[formats]")
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file["time"] = T
        for name, values, unit in (
            ("position", DEGREES * np.column_stack([Q, OTHER[:, 0]]), "deg"),
            ("velocity", DEGREES * np.column_stack([DQ, OTHER[:, 1]]), np.bytes_("deg/s")),
            ("effort", np.column_stack([TAU, OTHER[:, 2]]), "percent"),
        ):
            file[name] = values
            file[name].attrs["units"] = unit
    proposal = inspect_logs([path])
    units = proposal.description.log.units
    assert (units.q, units.dq, units.tau) == ("deg", "deg/s", "N.m")
    np.testing.assert_allclose(proposal.logs[0].q, np.column_stack([Q, OTHER[:, 0]]), atol=1e-9)
    with pytest.raises(LogError) as refusal:
        Log.read(path, apply_changes(proposal.description, {"log.units.q": "rad"}))
    assert refusal.value.code == "log.unit_of_cells"
