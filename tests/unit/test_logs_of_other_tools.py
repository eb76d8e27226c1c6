"""Logs as other tools write them are read with the values of the plain log, or say what they hold.

Each case failed, was refused without a reason, or lost rows before it was in this table.
"""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from containing import Containing, OneSentence

from hesr_model.errors import LogError
from hesr_model.health.joints import apply_changes
from hesr_model.health.proposal import Proposal, inspect_logs
from hesr_model.logs.robot_log import Log

ROWS = 600
T = np.round(0.01 * np.arange(ROWS), 6)
Q = np.round(np.sin(2.0 * T) + 0.4 * np.sin(5.1 * T), 6)
DQ = np.round(2.0 * np.cos(2.0 * T) + 2.04 * np.cos(5.1 * T), 6)
TAU = np.round(0.3 * np.tanh(DQ / 0.05) + 0.02 * DQ + 0.01 * np.sin(97.0 * T), 6)
VALUES = np.column_stack([T, Q, DQ, TAU])
HEADER = "t,q1,dq1,tau1"
LINES = [",".join(f"{value:.6f}" for value in row) for row in VALUES]
PLAIN = "\n".join([HEADER, *LINES]) + "\n"
RECORDS = [dict(zip(HEADER.split(","), row, strict=True)) for row in VALUES.tolist()]


def join_lines(lines: list[str], header: str = HEADER) -> str:
    return "\n".join([header, *lines]) + "\n"


def write_lists(opening: str, between: str, closing: str) -> str:
    """A semicolon between cells of lists of one number and a constant one."""
    rows = [
        ";".join(
            [f"{row[0]:.6f}", *(f"{opening}{x:.6f}{between}{x:.6f}{closing}" for x in row[1:])]
        )
        for row in VALUES
    ]
    return join_lines(rows, "t;position;velocity;effort")


def align(row: Any) -> str:
    return "".join(f"{value:14.6f}" for value in row)


# Files with all 600 rows.
WHOLE: dict[str, str] = {
    "empty cells at row ends.csv": join_lines([f"{line},," for line in LINES]),
    "a comma at row ends.csv": join_lines([f"{line}," for line in LINES]),
    "a tab at row ends.txt": join_lines([f"{line},".replace(",", "\t") for line in LINES],
                                        HEADER.replace(",", "\t")),
    "blanks at row ends.txt": join_lines([f"{line}  ".replace(",", " ") for line in LINES],
                                         HEADER.replace(",", " ")),
    "aligned columns.txt": join_lines([align(row) for row in VALUES],
                                      "".join(f"{name:>14}" for name in HEADER.split(","))),
    "rows of commas at the end.csv": f"{PLAIN},,,\n,,,\n",
    "a repeated header.csv": join_lines([*LINES[:300], HEADER, *LINES[300:]]),
    "seconds.csv": join_lines([line.replace(",", " sec,", 1) for line in LINES]),
    "milliseconds.csv": join_lines(
        [f"{1e3 * row[0]:.0f}ms,{line.partition(',')[2]}"
         for row, line in zip(VALUES, LINES, strict=True)]),
    "an empty velocity.csv": join_lines([f"{a:.6f},{b:.6f},,{c:.6f}" for a, b, _, c in VALUES]),
    "an empty temperature.csv": join_lines([f"{line},nan" for line in LINES],
                                           f"{HEADER},temperature1"),
    "lists without commas.csv": write_lists("[", " ", "]"),
    "tuples.csv": write_lists("(", ", ", ")"),
    "arrays of Python.csv": write_lists("array('d', [", ", ", "])"),
    "braces.csv": write_lists("{", ", ", "}"),
    "lines.jsonl": "\n".join(map(json.dumps, RECORDS)),
    "lines.log": "\n".join(map(json.dumps, RECORDS)) + "\n\0\0\0\0",
    "nested.ndjson": "\n".join(
        json.dumps({"t": t, "joint": {"q": [q], "dq": [dq], "tau": [tau]}})
        for t, q, dq, tau in VALUES.tolist()),
    "records.json": json.dumps({"robot": "arm", "data": RECORDS}, indent=1),
    "columns.json": json.dumps(
        {"rate": 100, **dict(zip(HEADER.split(","), VALUES.T.tolist(), strict=True))}),
    "bursts.csv": join_lines(
        [f"{0.05 * (k // 5):.6f},{line.partition(',')[2]}" for k, line in enumerate(LINES)]),
    "bursts with a short step.csv": join_lines(
        [f"{0.05 * (k // 5) + 1e-5 * (k % 5):.6f},{line.partition(',')[2]}"
         for k, line in enumerate(LINES)]),
    "a coarse clock.csv": join_lines(
        [f"{0.25 * (k // 25):.6f},{line.partition(',')[2]}" for k, line in enumerate(LINES)]),
}  # fmt: skip


def inspect(path: Path, text: str) -> Proposal:
    path.write_text(text, encoding="utf-8")
    return inspect_logs([path])


def require_values(log: Log, rows: Any = slice(None)) -> None:
    np.testing.assert_allclose(np.diff(log.t), np.diff(T[rows]), atol=2e-4)
    np.testing.assert_allclose(log.q[:, 0], Q[rows], atol=1e-12)
    np.testing.assert_allclose(log.tau[:, 0], TAU[rows], atol=1e-12)


@pytest.mark.parametrize("name", WHOLE)
def test_all_rows_are_read(name: str, tmp_path: Path) -> None:
    proposal = inspect(tmp_path / name, WHOLE[name])
    (log,) = proposal.logs
    require_values(log)
    assert log.dropped == 0
    checks = {finding.check for finding in proposal.examination.findings}
    # Both entries of a list are one number.
    assert checks <= {"same-column", "left-over"}


@pytest.mark.parametrize(
    "word",
    ["None", "none", "-", "--", "?", "<NA>", "(null)", "undefined", "#DIV/0!", "-1.#IND",
     "1.#QNAN0", "-nan(ind)", "<missing>"],
)  # fmt: skip
def test_a_word_for_no_number_leaves_out_its_rows(word: str, tmp_path: Path) -> None:
    """Also if the first row has it in all columns but the time."""
    lines = [line if k % 50 else f"{line.split(',')[0]},{word},{word},{word}"
             for k, line in enumerate(LINES)]  # fmt: skip
    proposal = inspect(tmp_path / "run.csv", join_lines(lines))
    (log,) = proposal.logs
    require_values(log, np.flatnonzero(np.arange(ROWS) % 50))
    (finding,) = [f for f in proposal.first_findings if f.check == "dropped-rows"]
    assert finding.found == "12 rows lack a number of q, dq and tau"


def test_a_number_cut_in_the_last_row_is_left_out(tmp_path: Path) -> None:
    for cut in (2, 5, 7):
        (log,) = inspect(tmp_path / "run.csv", PLAIN[:-cut]).logs
        require_values(log, slice(ROWS - 1))
    (log,) = inspect(tmp_path / "run.jsonl", "\n".join(map(json.dumps, RECORDS))[:-3]).logs
    require_values(log, slice(ROWS - 1))


def test_cells_of_two_topics_are_joined(tmp_path: Path) -> None:
    """Torques come 4 ms after positions; the slower topic gives the rows."""
    lines = []
    for k, (t, q, dq, _) in enumerate(VALUES):
        lines.append(f"{t:.6f},{q:.6f},{dq:.6f},")
        if k % 2 == 0:
            lines.append(f"{t + 0.004:.6f},,,{TAU[k]:.6f}")
    proposal = inspect(tmp_path / "run.csv", join_lines(lines))
    assert proposal.description.log.missing == "interpolate"
    (log,) = proposal.logs
    np.testing.assert_allclose(log.t, T[::2] + 0.004, atol=1e-9)
    np.testing.assert_array_equal(log.tau[:, 0], TAU[::2])
    np.testing.assert_allclose(log.q[:, 0], np.interp(log.t, T, Q), atol=1e-12)
    # A pause of one topic is no line between its ends.
    pause = []
    for line in lines:
        is_position = line.endswith(",")
        if not is_position or not 2.0 < float(line.split(",")[0]) < 3.0:
            pause.append(line)
    proposal = inspect(tmp_path / "pause.csv", join_lines(pause))
    (log,) = proposal.logs
    assert not np.any((log.t > 2.005) & (log.t < 2.995))
    (finding,) = [f for f in proposal.first_findings if f.check == "dropped-rows"]
    assert finding.found == Containing(" rows lack a number of q and dq")


def test_a_printed_line_joins(tmp_path: Path) -> None:
    lines = []
    for t, q, dq, tau in VALUES:
        lines += [f"{t:.6f},{q:.6f},{dq:.6f},", f"{t + 0.004:.6f},,,{tau:.6f}"]
    log = tmp_path / "run.csv"
    proposed = inspect(log, join_lines(lines)).description
    robot = apply_changes(proposed, {"log.missing": "refuse"})
    with pytest.raises(LogError) as caught:
        Log.read(log, robot)
    ((key, value),) = re.findall(r"\[log\] (\w+) = '(\w+)'", str(caught.value))
    joined = Log.read(log, apply_changes(robot, {f"log.{key}": value}))
    assert len(joined.t) > 0.9 * len(VALUES)


def write_units(q: str, dq: str, tau: str, scale: float = 1.0) -> str:
    """Cells of numbers and units; positions and velocities times a scale."""
    rows = [
        f"{row[0]:.6f},{scale * row[1]!r}{q},{scale * row[2]!r}{dq},{row[3]!r}{tau}"
        for row in VALUES.tolist()
    ]
    return join_lines(rows)


DEGREES = 180.0 / np.pi
# Text, and the units that a robot file then has, but SI.
UNITS: dict[str, tuple[str, dict[str, Any]]] = {
    "SI": (write_units(" rad", " rad/s", " Nm"), {}),
    "without blanks": (write_units("rad", "rad/s", "N.m"), {}),
    "degrees": (write_units(" deg", " deg/s", " N m", DEGREES), {"q": "deg", "dq": "deg/s"}),
    "signs": (write_units("°", "°/s", " N·m", DEGREES), {"q": "deg", "dq": "deg/s"}),
    "a size": (write_units(" mrad", " mrad/s", " Nm", 1e3), {"q": 1e-3, "dq": 1e-3}),
    "decimal commas": (
        write_units(" deg", " deg/s", " Nm", DEGREES).replace(",", ";").replace(".", ","),
        {"q": "deg", "dq": "deg/s"},
    ),
}


@pytest.mark.parametrize("name", UNITS)
def test_units_in_cells_are_read(name: str, tmp_path: Path) -> None:
    """The robot file then states them, and a robot file with others is refused with the line."""
    text, units = UNITS[name]
    path = tmp_path / "run.csv"
    proposal = inspect(path, text)
    (log,) = proposal.logs
    np.testing.assert_allclose(log.q[:, 0], Q, atol=1e-9)
    np.testing.assert_allclose(log.dq[:, 0], DQ, atol=1e-9)
    np.testing.assert_allclose(log.tau[:, 0], TAU, atol=1e-9)
    stated = {key: getattr(proposal.description.log.units, key) for key in units}
    assert stated == units
    for key in ("q", "dq"):
        wrong = apply_changes(
            proposal.description, {f"log.units.{key}": "rev" + "/s" * (key != "q")}
        )
        with pytest.raises(LogError) as refusal:
            Log.read(path, wrong)
        assert refusal.value.code == "log.unit_of_cells"
        assert refusal.value.key == f"log.units.{key}"
        ((line, value),) = re.findall(r"\[log\.units\] (\w+) = '?([^' ]+)", str(refusal.value))
        right = float(value) if value[0].isdigit() else value
        np.testing.assert_array_equal(
            Log.read(path, apply_changes(wrong, {f"log.units.{line}": right})).q, log.q
        )


def test_units_in_cells_tell_the_quantity(tmp_path: Path) -> None:
    """A current is not a torque, whatever its column is called."""
    text = write_units(" rad", " rad/s", " A")
    with pytest.raises(LogError) as refusal:
        inspect(tmp_path / "run.csv", text)
    assert (refusal.value.code, refusal.value.key) == ("log.unit_of_cells", "log.units.tau")
    renamed = text.replace("tau1", "motor")
    (log,) = inspect(tmp_path / "other.csv", renamed).logs
    np.testing.assert_array_equal(log.tau[:, 0], TAU)  # with 1 N.m/A


# Files with the sentence that names what they hold.
REFUSED: dict[str, tuple[str, tuple[str, ...]]] = {
    "no torque in any row.csv": (
        join_lines([f"{line.rpartition(',')[0]},nan" for line in LINES]),
        ("'tau1' (torque)", "is missing", "tau1 (no numbers)")),
    "an unknown unit in a cell.csv": (
        join_lines([line.replace(",", " vis,", 2).replace(" vis,", " s,", 1) for line in LINES]),
        ("column 'q1'", " vis' where")),
    "two units.csv": (
        join_lines([line.replace(",", " deg," if k > 99 else " rad,", 2).replace(
            " deg," if k > 99 else " rad,", ",", 1) for k, line in enumerate(LINES)]),
        ("column 'q1', row 102", " deg' where", "in 'rad'")),
    "a unit in some cells.csv": (
        join_lines([f"{line} Nm" if k > 99 else line for k, line in enumerate(LINES)]),
        ("column 'tau1', row 102", " Nm' where", "without a unit")),
    "quoted decimal commas.csv": (
        join_lines([f'{line.rpartition(",")[0]},"{TAU[k]:.6f}"'.replace(
            f"{TAU[k]:.6f}", f"{TAU[k]:.6f}".replace(".", ",")) for k, line in enumerate(LINES)]),
        ("column 'tau1', row 2", "'0,380", "decimal point")),
    "infinity.csv": (
        join_lines([line if k % 9 else f"{line.rpartition(',')[0]},1.#INF00"
                    for k, line in enumerate(LINES)]),
        ("column 'tau1', row 2", "infinity")),
    "words as time.csv": (
        join_lines([f"now,{line.partition(',')[2]}" for line in LINES]),
        ("no column looks like time", "'t' holds 'now'")),
    "constant time.csv": (
        join_lines([f"0.0,{line.partition(',')[2]}" for line in LINES]),
        ("no column looks like time", "'t' does not rise")),
    "broken.jsonl": ("\n".join([*map(json.dumps, RECORDS[:9]), "oops", "{}"]),
                     ("row 10", "'oops'")),
    "text.json": (json.dumps({"t": "no list"}), ("no list of records",)),
    "deep.json": ('{"t": ' + "[" * 200_000, ("no list of records",)),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_refusal_names_what_the_file_holds(name: str, tmp_path: Path) -> None:
    text, parts = REFUSED[name]
    with pytest.raises(LogError) as refusal:
        inspect(tmp_path / name, text)
    assert str(refusal.value) == OneSentence(*parts)


def save_data_set(path: Path, episode_rows: int, kind: Any) -> None:
    """A data set of LeRobot: lists in cells, stamps that begin again with each episode."""
    rows = np.arange(ROWS)
    table = {
        "observation.state": pa.array(np.column_stack([Q, DQ]).tolist(), kind),
        "observation.effort": pa.array(np.column_stack([TAU, -Q]).tolist(), kind),
        "action": pa.array(np.column_stack([Q, DQ]).tolist(), kind),
        "timestamp": T[rows % episode_rows],
        "frame_index": rows % episode_rows,
        "episode_index": rows // episode_rows,
        "next.done": rows % 2 == 0,
    }
    pyarrow.parquet.write_table(pa.table(table), path)


@pytest.mark.parametrize("kind", [pa.list_(pa.float64(), 2), pa.list_(pa.float64())])
@pytest.mark.parametrize("episode_rows", [600, 300, 256])
def test_episodes_of_a_data_set_are_parts(episode_rows: int, kind: Any, tmp_path: Path) -> None:
    save_data_set(tmp_path / "run.parquet", episode_rows, kind)
    proposal = inspect_logs([tmp_path / "run.parquet"])
    columns = proposal.description.log.columns
    assert columns.q == ("observation.state_1", "observation.state_2")
    assert columns.q_cmd == ("action_1", "action_2")
    (log,) = proposal.logs
    np.testing.assert_array_equal(log.tau[:, 0], TAU)
    lengths = [len(part.t) for part in log.parts()]
    full, last = divmod(ROWS, episode_rows)
    assert lengths == [episode_rows] * full
    if last:  # shorter than 1 s
        (finding,) = [f for f in proposal.first_findings if f.check == "gaps"]
        assert finding.found == Containing(f"{last} rows in parts shorter than 1 s")


def test_lists_of_other_lengths_are_named_only_if_they_are_needed(tmp_path: Path) -> None:
    lists = pa.array([[1.0] * (1 + k % 2) for k in range(ROWS)])
    table = dict(zip(HEADER.split(","), VALUES.T, strict=True))
    structs = pa.array([{"x": value} for value in TAU])
    table["q1"] = pa.array(Q[:, None].tolist())  # of one entry, without a number in its name
    path = tmp_path / "run.parquet"
    pyarrow.parquet.write_table(pa.table({**table, "image": lists, "extra": structs}), path)
    require_values(inspect_logs([path]).logs[0])
    table.pop("tau1")
    pyarrow.parquet.write_table(pa.table({**table, "tau1": lists}), path)
    with pytest.raises(LogError, match="'lists of 1 to 2 values' where"):
        inspect_logs([path])


def test_a_missing_column_gets_a_near_name_of_its_kind(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(PLAIN.replace("tau1", "torque_1"), encoding="utf-8")
    description = inspect_logs([path]).description
    wrong_log = description.log.model_copy(
        update={"columns": description.log.columns.model_copy(update={"q": ("q_1",)})}
    )
    with pytest.raises(LogError) as refusal:
        Log.read(path, description.model_copy(update={"log": wrong_log}))
    assert str(refusal.value) == OneSentence("column 'q_1' is missing", "did you mean 'q1'")
