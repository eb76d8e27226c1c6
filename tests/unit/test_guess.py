"""Columns of a log are recognised by their names, and the unit of time by the rate of rows."""

from pathlib import Path

import numpy as np
import pytest

from hesr_model.errors import LogError
from hesr_model.logs.guess import ColumnGuess, guess_columns
from hesr_model.logs.log_table import build_table

PLAIN = "time,q1,q2,dq1,dq2,tau1,tau2"


def guessed(
    header: str, joints: tuple[str, ...] = (), *, period: float = 0.01, jitter: float = 0.0
) -> ColumnGuess:
    rows = np.arange(40)
    names = header.split(",")
    columns = {names[0]: period * rows + jitter * (rows % 2)}
    columns |= {name: np.full(40, 1.5) for name in names[1:]}
    return guess_columns(build_table(Path("run.csv"), columns), joints)


# Header, joints, columns by quantity, units that are not SI.
TABLES: dict[str, tuple[str, tuple[str, ...], dict[str, str], dict[str, str]]] = {
    "plain": (PLAIN, (), {"t": "time", "q": "q1 q2", "dq": "dq1 dq2", "tau": "tau1 tau2"}, {}),
    "identifiers that are no joints": (
        "time,q1234567890,q1234567891,q1,q2", (), {"t": "time", "q": "q1 q2"}, {},
    ),
    "targets": (
        "t,target_q_0,target_q_1,actual_q_0,actual_q_1,actual_current_0,actual_current_1", (),
        {
            "t": "t", "q": "actual_q_0 actual_q_1", "q_cmd": "target_q_0 target_q_1",
            "current": "actual_current_0 actual_current_1",
        }, {},
    ),
    "measured rather than short": (
        "t,pos_meas_1,pos_meas_2,pos_1,pos_2", (), {"t": "t", "q": "pos_meas_1 pos_meas_2"}, {},
    ),
    "as many as joints": (
        "t,q1,q2,q3,q4,pos1,pos2", ("a", "b"), {"t": "t", "q": "pos1 pos2"}, {},
    ),
    "names of joints in another order": (
        "t,shoulder_pos,elbow_pos,shoulder_vel,elbow_vel", ("elbow", "shoulder"),
        {"t": "t", "q": "elbow_pos shoulder_pos", "dq": "elbow_vel shoulder_vel"}, {},
    ),
    "one joint": ("t,q_arm,tau_arm", ("arm",), {"t": "t", "q": "q_arm", "tau": "tau_arm"}, {}),
    "joints as positions": (
        "stamp,joint1,joint2,axis_speed_1,axis_speed_2", (),
        {"t": "stamp", "q": "joint1 joint2", "dq": "axis_speed_1 axis_speed_2"}, {},
    ),
    "units": (
        "t,angle_deg_1,angle_deg_2,speed_rpm_1,speed_rpm_2,cur_mA_1,cur_mA_2", (),
        {
            "t": "t", "q": "angle_deg_1 angle_deg_2", "dq": "speed_rpm_1 speed_rpm_2",
            "current": "cur_mA_1 cur_mA_2",
        }, {"q": "deg", "dq": "rpm", "current": "mA"},
    ),
    "further units": (
        "t,theta1,theta2,torque_mNm_1,torque_mNm_2,temp_kelvin1,temp_kelvin2", (),
        {
            "t": "t", "q": "theta1 theta2", "tau": "torque_mNm_1 torque_mNm_2",
            "temperature": "temp_kelvin1 temp_kelvin2",
        }, {"tau": "mN.m", "temperature": "K"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("table", TABLES)
def test_columns_are_recognised(table: str) -> None:
    header, joints, columns, units = TABLES[table]
    found = guessed(header, joints)
    shown = {
        key: names if isinstance(names, str) else " ".join(names)
        for key, names in found.columns.items()
    }
    assert shown == columns
    assert dict(found.units) == units | {"t": "s"}


@pytest.mark.parametrize(
    ("name", "period", "unit"),
    [
        ("time", 0.15, "s"),
        ("time", 0.9, "ms"),
        ("time", 160.0, "us"),
        ("time", 250.0, "us"),
        ("time", 5e6, "ns"),
        ("time_ms", 0.15, "ms"),
        ("time_ms", 5.0, "ms"),
        ("t_us", 0.001, "s"),
        ("t_us", 0.9, "ms"),
        ("t_us", 250.0, "us"),
    ],
)
def test_the_unit_of_time_gives_a_usual_rate(name: str, period: float, unit: str) -> None:
    found = guessed(PLAIN.replace("time", name), period=period)
    assert found.units["t"] == unit


@pytest.mark.parametrize(
    ("header", "joints", "jitter", "named"),
    [
        ("x,q1,q2", (), 0.0, "log.columns.t"),
        (PLAIN, (), 0.02, "log.columns.t"),  # not in order
        ("t,tau1,tau2", (), 0.0, "positions or velocities of a joint"),
        ("t,tau1,tau2", ("a", "b", "c"), 0.0, "all 3 joints"),
    ],
)
def test_tables_without_time_or_positions_are_refused(
    header: str, joints: tuple[str, ...], jitter: float, named: str
) -> None:
    with pytest.raises(LogError, match=named):
        guessed(header, joints, jitter=jitter)
