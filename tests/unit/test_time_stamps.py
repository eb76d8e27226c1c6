"""Stamps that begin again, and seconds with their fractions: printed lines let time go on."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from hesr_model.errors import LogError
from hesr_model.health.joints import apply_changes
from hesr_model.health.proposal import inspect_logs
from hesr_model.logs.long_log import LongLog
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import RobotDescription

Array = np.ndarray
ROWS = 1200
T = 0.01 * np.arange(ROWS)
MICROSECONDS = np.round(1e6 * T).astype(np.int64)
NANOSECONDS = 1000 * MICROSECONDS
EPOCH = 1_700_000_000
BILLION = 1_000_000_000


def write(path: Path, columns: dict[str, Array], digits: int = 4) -> Path:
    """Write a log of a joint with given stamps."""
    q = 2.0 * np.sin(3.0 * T)
    dq = 6.0 * np.cos(3.0 * T)
    signals = {"q1": q, "dq1": dq, "tau1": 0.3 * np.tanh(10.0 * dq) + 0.1 * dq}
    rows = [",".join((*columns, *signals))]
    for k in range(ROWS):
        stamps = [
            str(values[k]) if values.dtype.kind == "i" else f"{values[k]:.{digits}f}"
            for values in columns.values()
        ]
        rows.append(",".join((*stamps, *(f"{values[k]:.6f}" for values in signals.values()))))
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("columns", "line"),
    [
        ({"time_us": (MICROSECONDS + 2**32 - 4_000_000) % 2**32}, "wrap = 4294967296"),
        ({"t": (MICROSECONDS + 2**32 - 4_000_000) % 2**32 - 2**31}, "wrap = 4294967296"),
        ({"t_ms": (MICROSECONDS // 1000 + 60_000) % 2**16}, "wrap = 65536"),
        ({"nanosec_of_stamp": NANOSECONDS % BILLION}, "wrap = 1000000000"),
        *(
            ({"time": (T + seconds - 4.0) % seconds}, f"wrap = {seconds}")
            for seconds in (60, 3600, 43_200, 86_400)
        ),
        *(
            ({"t_ms": (MICROSECONDS // 1000 + size - 4000) % size}, f"wrap = {size}")
            for size in (10**6, 2**24, 10**9, 2**31)
        ),
        ({"time": np.where(T < 7.0, T, T - 7.0)}, "restart = 'gap'"),
        ({"time_us": np.where(T < 7.0, MICROSECONDS, MICROSECONDS - 6_900_000)}, "restart = 'gap'"),
        ({"time": T[[*range(500), 501, 500, *range(502, ROWS)]]}, "sort = true"),
    ],
)
def test_stamps_that_begin_again_go_on(
    columns: dict[str, Array], line: str, tmp_path: Path
) -> None:
    path = write(tmp_path / "run.csv", columns)
    proposal = inspect_logs([path])
    settings = tomllib.loads(line)
    log_format = proposal.description.log
    assert {key: getattr(log_format, key) for key in settings} == settings
    (log,) = proposal.logs
    parts = log.parts()
    assert len(parts) == (2 if "restart" in line else 1)
    assert sum(len(part.t) for part in parts) == ROWS
    for part in parts:
        np.testing.assert_allclose(np.diff(part.t), 0.01, atol=1e-6)
    # Without the line the refusal prints it; with it long logs are read alike.
    defaults = {"log.wrap": None, "log.restart": "refuse", "log.sort": False}
    with pytest.raises(LogError) as refusal:
        Log.read(path, apply_changes(proposal.description, defaults))
    assert f"[log] {line} " in str(refusal.value)
    assert refusal.value.code == "log.order"
    pieces = list(LongLog(path, proposal.description, 100).motions())
    assert sum(len(motion.t) for motion in pieces) == ROWS


@pytest.mark.parametrize(
    "names",
    [
        ("header.stamp.sec", "header.stamp.nanosec"),
        ("Header.Stamp.Secs [s]", "Header.Stamp.NSecs [ns]"),
        ("tv_sec", "tv_usec"),
        ("stamp_s", "stamp_ms"),
    ],
)
def test_whole_seconds_and_their_fraction_are_one_time(
    names: tuple[str, str], tmp_path: Path
) -> None:
    divisors = {"tv_usec": 1000, "stamp_ms": 1_000_000}
    fraction = NANOSECONDS % BILLION // divisors.get(names[1], 1)
    path = write(
        tmp_path / "run.csv", {names[0]: EPOCH + NANOSECONDS // BILLION, names[1]: fraction}
    )
    proposal = inspect_logs([path])
    assert proposal.description.log.columns.t == names
    np.testing.assert_allclose(proposal.logs[0].t, T, atol=1e-12)


def test_one_time_in_two_units_is_no_pair(tmp_path: Path) -> None:
    path = write(tmp_path / "run.csv", {"t_s": T, "t_ns": NANOSECONDS})
    proposal = inspect_logs([path])
    assert proposal.description.log.columns.t == "t_s"
    description = apply_changes(proposal.description, {"log.columns.t": ("t_s", "t_ns")})
    with pytest.raises(LogError) as refusal:
        Log.read(path, description)
    assert (refusal.value.code, refusal.value.key) == ("log.seconds", "log.columns.t")


def test_two_clocks_are_not_taken_for_one_counter(tmp_path: Path) -> None:
    """Each fall must be that of the counter, and no stamp may exceed it."""
    t = (MICROSECONDS + 2**32 - 4_000_000) % 2**32
    path = write(tmp_path / "run.csv", {"time_us": np.where(T < 8.0, t, t - 3_000_000)})
    description = RobotDescription(
        name="arm", model=Path("none"), joints=("j",),
        log={"columns": {"t": "time_us"}, "units": {"t": "us"}},
    )  # fmt: skip
    with pytest.raises(LogError) as refusal:
        Log.read(path, description)
    assert re.search(r"\[log\] wrap", str(refusal.value)) is None
