"""Logs that are read in pieces, against the same logs in memory."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from long_logs import long_table, write_robot

import hesr
from cosim.workflow import arguments
from hesr_model.errors import LogError
from hesr_model.logs import long_log
from hesr_model.logs.log_format import LogFormat
from hesr_model.logs.long_log import LongLog, StepCounts
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smooth_logs
from hesr_model.logs.tables import import_arrow
from hesr_model.rigid_body.accumulation import identify_long
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody, identify
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.arrays import get_arrays

KINDS = ["csv", "npz", "npy", "parquet", "feather"]


@pytest.fixture
def robot(tmp_path: Path) -> RobotDescription:
    return RobotDescription.read(write_robot(tmp_path, joints=2))


def with_gap(robot: RobotDescription, folder: Path, rows: int) -> np.ndarray:
    """Return a table with jitter of the stamps and a gap."""
    table = long_table(folder / "robot.toml", rows)
    table[:, 0] += np.random.default_rng(1).uniform(-2e-4, 2e-4, rows)
    table[int(0.6 * rows) :, 0] += 2.0
    return table


def written(path: Path, table: np.ndarray) -> Path:
    """Write a table in the format of the suffix."""
    names = ["t", *(f"{what}{k}" for what in ("q", "dq", "tau") for k in (1, 2))]
    columns = dict(zip(names, table.T, strict=True))
    if path.suffix == ".csv":
        np.savetxt(path, table, "%.17g", ",", header=",".join(names), comments="")
    elif path.suffix == ".npz":
        np.savez(path, **columns)
    elif path.suffix == ".npy":
        np.save(path, table)
    elif path.suffix == ".parquet":
        pytest.importorskip("pyarrow.parquet").write_table(import_arrow().table(columns), path)
    else:
        pytest.importorskip("pyarrow.feather").write_feather(import_arrow().table(columns), path)
    return path


def assert_same(found: RigidBody, expected: RigidBody) -> None:
    for name in ("parameters", "standard_errors", "friction", "rmse", "condition", "ridge"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=1e-9, err_msg=name
        )
    assert found.covariance is not None
    assert expected.covariance is not None
    size = np.outer(expected.standard_errors, expected.standard_errors)
    difference = found.covariance.matrix - expected.covariance.matrix
    assert np.max(np.abs(difference) / size) < 1e-9
    for name in ("base", "rows", "logs", "names", "method", "weighting"):
        assert getattr(found, name) == getattr(expected, name), name


@pytest.mark.parametrize("kind", KINDS)
def test_a_body_identified_in_pieces(kind: str, robot: RobotDescription, tmp_path: Path) -> None:
    path = written(tmp_path / f"log.{kind}", with_gap(robot, tmp_path, 2500))
    whole, model = Log.read(path, robot), Robot(robot)
    log = LongLog(path, robot, max_rows=400)
    motions, expected = list(log.motions()), smooth_logs([whole], model)
    assert len(motions) > len(expected) == 2
    for name in get_arrays(expected[0]):
        found, own = (np.concatenate([getattr(m, name) for m in s]) for s in (motions, expected))
        np.testing.assert_allclose(found, own, rtol=1e-9, atol=1e-12)
    assert_same(identify_long([log], model), identify([whole], model))


@pytest.mark.ci
@pytest.mark.parametrize("kind", ["csv", "npz"])
def test_six_joints_in_pieces(kind: str, tmp_path: Path) -> None:
    robot = RobotDescription.read(write_robot(tmp_path, joints=6))
    paths, model = [], Robot(robot)
    for k in range(2):
        log = Log.read(written_six(tmp_path, k), robot)
        paths.append(tmp_path / f"log{k}.{kind}")
        if kind == "csv":
            log.write(paths[-1])
        else:
            np.savez(paths[-1], t=log.t, q=log.q, dq=log.dq, tau=log.tau)
    whole = identify([Log.read(path, robot) for path in paths], model)
    assert_same(
        identify_long([LongLog(path, robot, max_rows=3000) for path in paths], model), whole
    )


def written_six(folder: Path, seed: int) -> Path:
    path = folder / f"raw{seed}.npy"
    np.save(path, long_table(folder / "robot.toml", 15_000 + 1000 * seed, seed))
    return path


def test_identify_reads_long_logs_in_pieces(
    robot: RobotDescription, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [tmp_path / "one.npz", tmp_path / "two.csv"]
    for k, path in enumerate(paths):
        written(path, long_table(tmp_path / "robot.toml", 2000, seed=k))
    file = tmp_path / "robot.toml"
    expected = hesr.identify(paths, robot=file, body="free")
    physical = hesr.identify(paths, robot=file, physical=True)
    monkeypatch.setattr(arguments, "MAX_NUMBERS", 1000)
    monkeypatch.setattr(long_log, "PIECE_ROWS", 500)
    used: list[LongLog] = []
    make = long_log.LongLog
    monkeypatch.setattr(
        long_log, "LongLog", lambda *given: used.append(make(*given, max_rows=500)) or used[-1]
    )
    found = hesr.identify(paths, robot=file)
    assert [len(log.checked_pieces) for log in used] == [4, 4]
    assert_same(found, expected)
    assert found.provenance == expected.provenance
    from_memory = hesr.identify([Log.read(path, robot) for path in paths])
    assert len(used) == 4
    assert_same(from_memory, expected)
    at_once = hesr.identify(paths, robot=file, physical=True)
    assert len(used) == 4
    assert_same(at_once, physical)


def test_fit_takes_whole_stretches_of_long_logs(
    robot: RobotDescription,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    path = written(tmp_path / "log.npz", with_gap(robot, tmp_path, 2500))
    file, body = tmp_path / "robot.toml", hesr.identify(path, robot=robot)
    make = long_log.LongLog
    monkeypatch.setattr(long_log, "LongLog", lambda *given: make(*given, max_rows=400))

    def records() -> list[list[FrictionRecord]]:
        return arguments.read_checked_logs([path], file, (), in_pieces=True).compute_records(body)

    expected = records()
    monkeypatch.setattr(arguments, "MAX_NUMBERS", 1000)
    found = records()
    assert "The logs have" not in caplog.text
    assert caplog.messages[0] == caplog.messages[1]
    for part, own in zip(found, expected, strict=True):
        for name in ("t", "dq", "q", "tau", "tau_load", "dq_causal"):
            values = [getattr(one[1], name) for one in (part, own)]
            np.testing.assert_allclose(*values, rtol=1e-9, atol=1e-12)
    law = hesr.fit(path, law="stribeck", robot=file)
    files = list(map(str, law.provenance["files"]))
    for name, one in zip(("robot.toml", "chain.urdf", "log.npz"), files, strict=True):
        assert name in one
    monkeypatch.setattr(arguments, "MAX_ROWS", 1500)
    some = records()
    assert 1000 < sum(len(part[0].t) for part in some) <= 1500
    assert "The logs have 2500 rows; " in caplog.text
    assert all(np.ptp(np.diff(part[0].t)) < 1e-3 for part in some)


def test_laws_are_tested_on_long_logs(
    robot: RobotDescription, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path / "log.npz", with_gap(robot, tmp_path, 2500))
    body, make = hesr.identify(path, robot=robot), long_log.LongLog
    law = hesr.fit(path, law="stribeck", robot=robot, rigid_body=body)
    monkeypatch.setattr(long_log, "LongLog", lambda *given: make(*given, max_rows=400))

    def errors() -> list[float]:
        found = hesr.test({"law": law}, on=path, kind="prediction", robot=robot, rigid_body=body)
        assert found.scores is not None
        assert found.positions is not None
        return list(found.scores.zero_phase["law"])

    expected = errors()
    monkeypatch.setattr(arguments, "MAX_NUMBERS", 1000)
    np.testing.assert_allclose(errors(), expected, rtol=1e-9)
    monkeypatch.setattr(arguments, "MAX_ROWS", 1500)
    assert max(np.abs(np.array(errors()) / expected - 1.0)) > 1e-9


def test_arrays_stored_by_column_are_read_as_a_whole(
    robot: RobotDescription, tmp_path: Path
) -> None:
    table = long_table(tmp_path / "robot.toml", 1500)
    np.save(tmp_path / "log.npy", np.asfortranarray(table))
    log = LongLog(tmp_path / "log.npy", robot, max_rows=400)
    np.testing.assert_array_equal(np.concatenate([m.t for m in log.motions()]), table[:, 0])
    assert log.checked_pieces[0].rows(slice(0, 3)).path == tmp_path / "log.npy"


def test_dates_and_rates_go_on_from_piece_to_piece(tmp_path: Path) -> None:
    file = write_robot(tmp_path, joints=2)
    table = long_table(file, 1000)
    dated = np.datetime64("2024-05-06T00:00:00", "us") + (1e6 * table[:, 0]).astype(int)
    with (tmp_path / "dated.csv").open("w", encoding="utf-8") as log:
        log.write("t,q1,q2,dq1,dq2,tau1,tau2\n")
        for stamp, row in zip(dated, table, strict=True):
            log.write(",".join([str(stamp), *map(repr, row[1:].tolist())]) + "\n")
    robot = RobotDescription.read(file)
    motions = LongLog(tmp_path / "dated.csv", robot, max_rows=300).motions()
    np.testing.assert_allclose(np.concatenate([m.t for m in motions]), table[:, 0], atol=1e-9)
    text = file.read_text(encoding="utf-8").replace("[log]\n", "[log]\nrate = 250.0\n")
    file.write_text(text.replace("'t'", "'time'"), encoding="utf-8")
    np.save(tmp_path / "even.npy", table)
    motions = LongLog(tmp_path / "even.npy", RobotDescription.read(file), max_rows=300).motions()
    np.testing.assert_allclose(np.concatenate([m.t for m in motions]), table[:, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.__setitem__((600, 0), t[599, 0]), r"row 602: time must increase"),
        (lambda t: t.__setitem__((750, 3), np.nan), r"column 'dq1', row 752: an empty cell or NaN"),
        (lambda t: t.__setitem__((slice(None), 2), 0.5), r"position of joint 'j2' is constant"),
        (lambda t: t.__setitem__((slice(None), 0), 0.2 * np.arange(900)), r"filter_cutoff can be"),
    ],
)
def test_errors_name_the_row_of_the_file(
    change: Callable[[np.ndarray], None], message: str, robot: RobotDescription, tmp_path: Path
) -> None:
    table = long_table(tmp_path / "robot.toml", 900)
    change(table)
    path = written(tmp_path / "log.csv", table)
    with pytest.raises(LogError, match=message):
        identify_long([LongLog(path, robot, max_rows=300)], Robot(robot))


def test_the_median_of_the_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.001, 0.003, 5000))
    log = Log(name="log", t=t, q=t[:, None], dq=None, tau=t[:, None])

    def steps() -> StepCounts:
        found = StepCounts()
        for part in np.array_split(np.diff(t), 7):
            found.add(part)
        return found

    assert steps().period == log.period
    assert steps().longest == pytest.approx(log.longest_step, rel=1e-12, abs=0.0)
    monkeypatch.setattr(long_log, "_MAX_DISTINCT_STEPS", 1000)
    assert steps().period == pytest.approx(log.period, rel=2e-5)
    assert len(steps().values) < 4999


def with_settings(robot: RobotDescription, **settings: object) -> RobotDescription:
    return robot.model_copy(update={"log": robot.log.model_copy(update=settings)})


def test_the_rate_is_that_of_the_whole_log(robot: RobotDescription, tmp_path: Path) -> None:
    """A piece of one row follows a long step."""
    table = long_table(tmp_path / "robot.toml", 801)
    table[-1, 0] += 0.4 * (table[1, 0] - table[0, 0])
    path = written(tmp_path / "log.csv", table)
    rate = 1.0 / float(table[1, 0] - table[0, 0])
    same = with_settings(robot, sample_rate=rate)
    assert len(Log.read(path, same).t) == 801
    assert LongLog(path, same, max_rows=200).gaps == 0
    other = with_settings(robot, sample_rate=2.0 * rate)
    with pytest.raises(LogError) as expected:
        Log.read(path, other)
    with pytest.raises(LogError) as found:
        LongLog(path, other, max_rows=200)
    assert str(found.value) == str(expected.value)


def test_rows_without_numbers_are_left_out(robot: RobotDescription, tmp_path: Path) -> None:
    """Only one row of the first piece is complete."""
    table, drop = long_table(tmp_path / "robot.toml", 1001), with_settings(robot, missing="drop")
    table[:199, 1] = np.nan
    path = written(tmp_path / "log.csv", table)
    assert Log.read(path, drop).dropped == 199
    assert sum(log.dropped for log in LongLog(path, drop, max_rows=200).checked_pieces) == 199
    table[:, 1] = np.nan
    path = written(tmp_path / "log.csv", table)
    with pytest.raises(LogError, match=r"q1 \(no numbers\)"):
        Log.read(path, drop)
    with pytest.raises(LogError, match="1001 rows lack a number of q"):
        LongLog(path, drop, max_rows=200)


def test_a_log_that_changes_is_refused(robot: RobotDescription, tmp_path: Path) -> None:
    table = long_table(tmp_path / "robot.toml", 1001)
    path = written(tmp_path / "log.csv", table)
    log = LongLog(path, robot, max_rows=200)
    written(path, table[:700])
    with pytest.raises(LogError, match=r"log\.csv: was changed while"):
        list(log.motions())


@pytest.mark.parametrize(
    "settings",
    [
        {"sort": True},
        {"wrap": 256.0},
        {"restart": "gap"},
        {"duplicates": "spread"},
        {"missing": "interpolate"},
    ],
)
def test_rows_that_depend_on_others_are_read_at_once(settings: dict[str, Any]) -> None:
    assert LogFormat(**settings).needs_all_rows
    assert not LogFormat(duplicates="first", missing="drop").needs_all_rows
