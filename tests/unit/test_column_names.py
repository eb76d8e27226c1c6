"""Names of other loggers, languages and units: the data decide where names leave a choice."""

from pathlib import Path

import numpy as np
import pytest
from rotor import signals

from hesr_model.logs.column_names import read_name
from hesr_model.logs.guess import ColumnGuess, guess_columns
from hesr_model.logs.kinematics import match_derivative
from hesr_model.logs.log_table import build_table

SIGNALS = signals()


def guess(header: str) -> ColumnGuess:
    pairs = [column.rpartition("=") for column in header.split(";")]
    columns = {name: SIGNALS[signal] for name, _, signal in pairs}
    return guess_columns(build_table(Path("run.csv"), columns), ("motor",))


# Header with the signal of each column; signals that must be found; units that are not SI.
HEADERS: dict[str, tuple[str, str, dict[str, str | float]]] = {
    "amperes of the q axis": (
        "time [s]=t;m q-axis [A]=amperes;m position [rad]=q;m velocity [rad/s]=dq;"
        "m torque [Nm]=tau",
        "t q dq tau", {},
    ),
    "a current called q": (
        "time=t;position=q;velocity=dq;q_current=amperes;torque=tau", "t q dq tau", {},
    ),
    "a voltage called q": ("time=t;v_q=volts;pos=q;vel=dq;torque=tau", "t q dq tau", {}),
    "current as an adjective": (
        "stamp=t;current_position=q;current_velocity=dq;current_torque=tau", "t q dq tau", {},
    ),
    "German": (
        "Zeit [s]=t;Winkel [°]=deg;Drehzahl [1/min]=rpm;Drehmoment [Nm]=tau;Strom [A]=amperes",
        "t deg rpm tau", {"q": "deg", "dq": "rpm"},
    ),
    "French": ("temps=t;position=q;vitesse=dq;couple=tau;courant=amperes", "t q dq tau", {}),
    "Spanish": ("tiempo=t;posición=q;velocidad=dq;fuerza=tau", "t q dq tau", {}),
    "Japanese": ("時間=t;位置=q;速度=dq;トルク=tau;電流=amperes", "t q dq tau", {}),
    "letters": ("t=t;x=q;v=dq;F=tau", "t q dq tau", {}),
    "letters with units": ("t [ms]=ms;n [1/min]=rpm;M [Nm]=tau;phi [°]=deg",
                           "ms deg rpm tau", {"q": "deg", "dq": "rpm"}),
    "units as suffixes": (
        "t_us=us;pos_deg=deg;vel_rad_s=dq;torque_mNm=tau", "us deg dq tau",
        {"q": "deg", "tau": "mN.m"},
    ),
    "desired signals": ("t=t;q=q;q_d=command;dq=dq;tau_J=tau;tau_J_d=noise", "t q dq tau", {}),
    "servos": (
        "time_ms=ms;goal_position=command;present_position=q;present_velocity=dq;"
        "present_torque=tau", "ms q dq tau", {},
    ),
    "derivatives": (
        "t=t;theta=q;theta_dot=dq;theta_ddot=ddq;u=volts;tau=tau", "t q dq tau", {},
    ),
    "another angle": (
        "time=t;angle=noise;encoder=q;speed=dq;torque=tau", "t q dq tau", {},
    ),
    "another speed": (
        "time=t;pos=q;velocity=noise;omega=dq;torque=tau", "t q dq tau", {},
    ),
    "an error": ("time=t;position error [rad]=error;position=q;velocity=dq;torque=tau",
                 "t q dq tau", {}),
}  # fmt: skip


@pytest.mark.parametrize("case", HEADERS)
def test_columns_of_other_loggers_are_found(case: str) -> None:
    header, expected, units = HEADERS[case]
    found = guess(header)
    signal_of_name = {
        name: signal for name, _, signal in (c.rpartition("=") for c in header.split(";"))
    }
    columns = [found.columns[key] for key in ("t", "q", "dq", "tau")]
    names = [column if isinstance(column, str) else column[0] for column in columns]
    assert [signal_of_name[name] for name in names] == expected.split()
    assert {key: unit for key, unit in found.units.items() if key != "t"} == units


def test_a_log_of_speed_and_torque_has_no_position() -> None:
    found = guess("time [s]=t;motor speed [rpm]=rpm;motor torque [Nm]=tau")
    assert found.columns["q"] == ""
    assert found.joint_count == 1
    assert "integral" in found.reasons["q"]


@pytest.mark.parametrize(
    ("name", "quantity"),
    [
        ("velocity [A]", "current"),
        ("position [V]", ""),
        ("torque [deg]", "q"),
        ("q-axis", ""),
        ("axis 1", "q"),
        ("q3_tau_J", "tau"),
        ("power [W]", ""),
        ("d_current", "current"),
        ("target_torque", ""),
        ("acc [rad/s^2]", ""),
    ],
)
def test_a_unit_outranks_any_word(name: str, quantity: str) -> None:
    readings = read_name(name)
    assert (readings[0].quantity if readings else "") == quantity


def test_stamps_in_seconds_and_nanoseconds_are_one_time() -> None:
    t = SIGNALS["t"]
    seconds = 1_700_000_000 + t.astype(np.int64)
    nanoseconds = np.rint((t % 1.0) * 1e9).astype(np.int64)
    columns = {"stamp.sec": seconds, "stamp.nanosec": nanoseconds, "q1": SIGNALS["q"]}
    table = build_table(Path("run.csv"), columns)
    found = guess_columns(table)
    assert found.columns["t"] == ("stamp.sec", "stamp.nanosec")
    np.testing.assert_allclose(table.times(("stamp.sec", "stamp.nanosec"), 1.0), t, atol=1e-9)


def test_a_derivative_is_found_in_noise_and_at_constant_speeds() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(4000) / 200.0
    dq = np.where(t < 10.0, 0.4, -0.4)
    q = np.cumsum(dq) / 200.0 + 5e-4 * rng.standard_normal(t.size)
    noisy = dq + 0.06 * rng.standard_normal(t.size)
    match = match_derivative(t, q[:, None], noisy[:, None])
    other = match_derivative(t, q[:, None], rng.standard_normal((t.size, 1)))
    assert match.explains
    assert match.factor == pytest.approx(1.0, rel=0.02)
    assert match.beats(other)
    assert not other.explains
    assert not other.beats(match)
