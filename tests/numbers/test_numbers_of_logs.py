"""Logs: reading, guessed columns, splitting, display, smoothing and sampling."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from limits_found import TWO, at, edge, two_joints
from pytest_regressions.data_regression import DataRegressionFixture
from unchanged import Unchanged

from hesr_model.errors import HesrError, LogError
from hesr_model.logs.guess import guess
from hesr_model.logs.log_table import listed, most_bytes
from hesr_model.logs.readers.samples import LogSamples
from hesr_model.logs.robot_log import (
    Log,
    _require_reasonable,
    parts_of,
    require_different,
    require_moving,
)
from hesr_model.logs.sample import Sample, _uniform
from hesr_model.logs.signals import Motion, _before, moving, near_reversals, reversals, smooth
from hesr_model.logs.tables import read_table
from hesr_model.robots.robot import RobotDescription


def refusal(make: Callable[[], object], path: Path = Path("nowhere")) -> str:
    try:
        make()
    except HesrError as error:
        return str(error).replace(f"{path}/", "")
    return "none"


def with_gaps(*rows: int, by: float = 1.0) -> Log:
    log = two_joints(1000)
    later = sum((np.arange(1000) >= row for row in rows), np.zeros(1000))
    return replace(log, t=log.t + by * later)


def test_stamps_and_parts(unchanged: Unchanged) -> None:
    rng = np.random.default_rng(4)
    uneven = replace(two_joints(1000), t=np.cumsum(rng.choice([0.008, 0.01, 0.015], 1000)))
    lossy = with_gaps(300, 410, 500).rows(np.flatnonzero(rng.random(1000) < 0.6))
    logs = {"even": two_joints(), "uneven": uneven, "lossy": lossy, "gaps": with_gaps(300, 500)}
    unchanged(
        {
            name: [log.period, log.longest_step, log.rate, log.jitter, len(log.t), log.gaps.sum()]
            for name, log in logs.items()
        }
        | {
            "parts": [len(part.t) for part in parts_of([*logs.values(), with_gaps(50, 949)])],
            "cut": [[len(p.t) for p in with_gaps(300, n).parts()] for n in (399, 400, 401, 402)],
            "gap": edge(lambda x: len(with_gaps(500, by=x).gaps), 0.01, 0.5),
            "travel": edge(
                lambda x: (
                    refusal(lambda: require_moving([two_joints()], "ab")) == "none"
                    and refusal(
                        lambda: require_moving([replace(two_joints(), q=x * two_joints().q)], "ab")
                    )
                    == "none"
                ),
                1e-4,
                0.1,
            ),
        },
        rtol=1e-6,
    )


def test_logs_are_shown_and_refused(
    arm_log: Log, arm: RobotDescription, data_regression: DataRegressionFixture
) -> None:
    warm = replace(two_joints(), temperature=25.0 + np.zeros((1000, 2)), robot=TWO)
    hashed = [replace(with_gaps(300), sha256=x) for x in ("a", "a", "b")]
    other = hashed[0].parts()

    def large(what: str, value: float) -> str:
        log = two_joints(5)
        own = {"q": log.q, "dq": log.dq, "effort": log.tau, "t": log.t, "temperature": None}
        own[what] = (
            np.where(np.arange(5) == 3, value, log.t)
            if what == "t"
            else at(0.0 * log.q, 3, 1, value)
        )
        samples = LogSamples(**own, is_current=False, time="time", place=lambda k: f"place {k}")
        return refusal(lambda: _require_reasonable(Path("run.csv"), samples, "ab"))

    data_regression.check(
        {
            "repr": [repr(arm_log), repr(warm), repr(replace(warm, dq=None))],
            "html": [x._repr_html_() for x in (arm_log, warm, replace(warm, dq=None))],
            "joints": [list(arm_log.joints), list(warm.joints)],
            "where": [warm.where, replace(warm, path=Path("a.csv")).where],
            "columns": [list(x._columns) for x in (arm_log, warm, replace(warm, dq=None))],
            "rows": [str(warm.rows(slice(0, 5)).temperature is None), repr(arm_log.rows(slice(7)))],
            "moving": refusal(lambda: require_moving([replace(warm, q=1e-4 * warm.q)], "ab")),
            "no parts": refusal(lambda: with_gaps(*range(90, 1000, 90)).parts()),
            "twice": [
                refusal(lambda: require_different(hashed)),
                refusal(lambda: require_different([hashed[0], hashed[2]])),
                refusal(lambda: require_different([*other, hashed[0]])),
                refusal(lambda: require_different([*other, other[1]])),
                refusal(lambda: require_different([two_joints(), two_joints()])),
            ],
            "large": [
                large(what, x)
                for what in ("q", "dq", "effort", "t", "temperature")
                for x in (1e20, -1.01e20, np.nan)
            ],
            "smooth": [
                refusal(lambda: smooth(with_gaps(300), 15.0)),
                *(refusal(lambda n=n: smooth(two_joints(n), 15.0)) for n in (20, 21, 22, 23)),
                *(refusal(lambda c=c: smooth(two_joints(), c)) for c in (39.9, 40.1)),
            ],
        }
    )


def test_smoothed_motions(unchanged: Unchanged) -> None:
    rng = np.random.default_rng(4)
    log = two_joints(400)
    noisy = replace(
        log, t=log.t + 0.002 * rng.random(400), q=log.q + 1e-3 * rng.normal(size=log.q.shape)
    )
    unchanged(
        {
            "smooth": {str(c): smooth(noisy, c) for c in (3.0, 15.0, 39.0)},
            "default": smooth(noisy),
            "derived": smooth(replace(noisy, dq=None), 10.0),
            "before": [_before(noisy.q[:40], n) for n in (2, 3, 5, 12)],
            "rows": smooth(noisy).rows(slice(3, 9)),
        },
        rtol=1e-6,
    )


def test_phases(unchanged: Unchanged) -> None:
    dq = np.array([0.1, 0.02, 0.021, -0.01, 0.005, -0.015, -0.03, -0.5, -0.02, 0.0, 0.019, -0.021,
                   0.0201, 0.3])  # fmt: skip
    t = 0.05 * np.arange(len(dq))
    fine = 0.01 * np.arange(60)
    unchanged(
        {
            "moving": [moving(dq), moving(-dq)],
            "reversals": [reversals(dq), reversals(-dq), reversals(dq[::-1])],
            "near": near_reversals(t, dq),
            "window": near_reversals(fine, np.where(fine < 0.3, 1.0, -1.0)),
            "edge": edge(lambda x: moving(np.array([x]))[0], 0.01, 0.03),
        }
    )


def test_samples(unchanged: Unchanged) -> None:
    def motion(k: int) -> Motion:
        rng = np.random.default_rng(k)
        t = np.arange(round(100 * (3.0 + 0.6 * k))) / 100.0
        dq = np.column_stack([np.sin((1 + k) * t) * 10.0 ** (k - 2), np.cos(0.3 * t)])
        dq[40:90] = 0.0
        tau = rng.normal(size=dq.shape) * 4.0 ** (k - 1)
        return Motion(name=f"m{k}", t=t, q=dq, dq=dq, ddq=dq, tau=tau, q_raw=dq)

    found: dict[str, object] = {"draws": [_uniform(s, "a", t) for s in (0, 1) for t in (0.0, 2.5)]}
    for most in (50, 100, 150, 450, 900, 2000):
        sample = Sample(most, 3)
        for k in range(5):
            sample.add(motion(k))
        kept = sample.motions()
        found[f"kept {most}"] = [[len(m.t), m.t[0], m.t[-1], int(m.name[1])] for m in kept]
    (window, rows), *others = _cut(motion(4))
    found["rows"] = sorted(rows.values())
    found["strata"] = [[j, code, len(what)] for j, what, code in sorted(rows)]
    found["windows"] = [len(window.t), *(len(w.t) for w, _ in others)]
    unchanged(found)


def _cut(motion: Motion) -> list[tuple[Motion, dict[tuple[int, str, int], int]]]:
    sample = Sample(10**6, 0)
    sample.add(motion)
    return list(sample._cut(motion))


def test_guessed_columns(tmp_path: Path, data_regression: DataRegressionFixture) -> None:
    path = tmp_path / "run.csv"

    def told(
        header: str,
        period: float = 0.01,
        joints: tuple[str, ...] = (),
        *,
        jitter: float = 0.0,
        empty: int = 0,
    ) -> list[str]:
        names = header.split(",")
        rows = [
            [str(period * k + jitter * (k % 2)), *("1.5" for _ in names[1:])] for k in range(40)
        ]
        for row in rows[:empty]:
            row[0] = ""
        path.write_text("\n".join([header, *map(",".join, rows)]) + "\n", encoding="utf-8")
        try:
            found = guess(read_table(path), joints)
        except LogError as error:
            return [str(error).replace(str(tmp_path), "")]
        return [str(dict(x)) for x in (found.columns, found.units, found.reasons)]

    plain = "time,q1,q2,dq1,dq2,tau1,tau2"
    tables = {
        "plain": told(plain),
        "many digits": told("time,q1234567890,q1234567891,q1,q2"),
        "nine digits": told("time,q123456789,q123456790"),
        "actual": told("t,target_q_0,target_q_1,actual_q_0,actual_q_1,actual_current_0,"
                       "actual_current_1"),
        "measured or short": told("t,pos_meas_1,pos_meas_2,pos_1,pos_2,p_position_1,p_position_2"),
        "more joints": told("t,q1,q2,q3,q4,pos1,pos2", joints=("a", "b")),
        "of three": told("t,q1,q2,q3,dq1,dq2"),
        "units": told("time_ms,angle_deg_1,angle_deg_2,speed_rpm_1,speed_rpm_2,cur_mA_1,cur_mA_2"),
        "milli torque": told("t,theta1,theta2,torque_mNm_1,torque_mNm_2,temp_kelvin1,temp_kelvin2"),
        "only the first says": told("t,axis_deg_2_1,axis_deg_2_2,joint1_rpm,joint2_rpm"),
        "by joints": told("t,shoulder_pos,elbow_pos,shoulder_vel,elbow_vel",
                          joints=("elbow", "shoulder")),
        "one joint": told("t,q_arm,tau_arm", joints=("arm",)),
        "one column": told("t,q1,tau1"),
        "places": told("stamp,joint1,joint2,axis_speed_1,axis_speed_2"),
        "no time": told("x,q1,q2"),
        "no positions": told("t,tau1,tau2"),
        "no positions of three": told("t,tau1,tau2", joints=("a", "b", "c")),
        "two times": told("timestamp,time,q1,q2"),
        "missing stamps": told(plain, empty=3),
        "jumping": told(plain, jitter=0.02),
    }  # fmt: skip
    periods = (1e-9, 4e-5, 6e-5, 1e-3, 0.15, 0.21, 0.9, 5.0, 40.0, 160.0, 250.0, 5e3, 2e5, 5e8, 1e9)
    for name in ("time", "time_ms", "t_us"):
        tables |= {
            f"{name} {period:g}": told(plain.replace("time", name), period) for period in periods
        }
    data_regression.check(tables)


def test_listed_names(tmp_path: Path, data_regression: DataRegressionFixture) -> None:
    path = tmp_path / "of.csv"
    path.write_bytes(b"x" * 17)
    counts = tmp_path / "counts.csv"
    counts.write_text(f"t,q\n0,{2**53 + 1}\n1,7\n", encoding="utf-8")
    data_regression.check(
        {
            "counts of more digits than a float has": read_table(counts).numbers(["q"]).tolist(),
            "short": listed(["a" * 60, "b" * 61]),
            "many": [listed([f"c{k}" for k in range(n)]) for n in (29, 30, 31, 32)],
            "bytes": most_bytes(path),
        }
    )
