"""The motion planned after a first log of 60 s, against the first motion once more, on the twin.

The first motion is the Fourier motion for the body. `pytest -m soak
tests/benchmarks/test_next_motion_study.py -s` prints all figures; SEEDS limits the seeds.
"""

import os
from pathlib import Path

import numpy as np
import pytest
from test_motion_study import LAWS, LIMITS, TRUTHS, Twins

from cosim.loop.excite import load_arm, record
from hesr.extras.excite.planner import Guard, MotionSettings, Planner
from hesr.extras.excite.sequel import MIXES, Knowledge, build_joint_rows
from hesr_model.fitting.fit import fit_models

SEEDS = int(os.environ.get("SEEDS", "20"))

pytestmark = pytest.mark.soak


@pytest.mark.timeout(0)
def test_the_next_motion_pays_more_than_the_first_one_again(tmp_path: Path) -> None:
    gains, widths = [], []
    for truth in TRUTHS:
        folder = tmp_path / str(truth)
        folder.mkdir()
        twin = Twins(truth, folder)
        for seed in range(SEEDS):
            planners = [
                Planner(Guard(twin.robot, settings), settings)
                for settings in (
                    MotionSettings(limits=LIMITS, seed=seed),
                    MotionSettings(limits=LIMITS, seed=seed + 1000),
                )
            ]
            guard, first = planners[0].guard, planners[0].plan("body", 60.0)
            with load_arm(twin.plant, fmu=twin.fmu) as arm:
                logs = [
                    twin.records(record(arm, first, 10 + seed, name=name))
                    for name in ("first", "again")
                ]
            fits = {
                name: fit_models(
                    LAWS,
                    [list(rows) for rows in zip(*some, strict=True)],
                    robot="r",
                    seed=0,
                    workers=1,
                )
                for name, some in (("first", logs[:1]), ("again", logs))
            }
            known = [
                Knowledge(
                    laws={law: fits["first"][law].laws[j] for law in LAWS},
                    logs=[{"t": r.t, "dq": r.dq, "q": r.q, "tau_load": r.tau_load}],
                    torques=[r.tau],
                    speed=float(guard.stated_limits.velocity[j]),
                )
                for j, r in enumerate(logs[0])
            ]
            rows = [
                build_joint_rows(next(planners[1].strokes(60.0, [mix] * 3)), guard) for mix in MIXES
            ]
            best = [
                MIXES[int(np.argmax([one.score(of_mix[j]) for of_mix in rows]))]
                for j, one in enumerate(known)
            ]
            second = planners[1].friction(60.0, best)
            with load_arm(twin.plant, fmu=twin.fmu) as arm:
                pair = (logs[0], twin.records(record(arm, second, 10 + seed, name="second")))
            records = [list(of_joint) for of_joint in zip(*pair, strict=True)]
            fits["second"] = fit_models(LAWS, records, robot="r", seed=0, workers=1)
            planned = build_joint_rows(second, guard)
            before, again, after = (
                float(np.exp(np.mean([np.log(twin.errors(fits[name][law])) for law in LAWS])))
                for name in ("first", "again", "second")
            )
            found = []
            for j, one in enumerate(known):
                law, then = one.laws["lugre"], fits["second"]["lugre"].laws[j].standard_errors
                expected = one.predict_ratios(law, planned[j])
                found += [
                    then[name] / (error * expected[name])
                    for name, error in law.standard_errors.items()
                    if then.get(name) and name in expected
                ]
            gains.append((before - after) / max(before - again, 1e-3 * before))
            widths.append(float(np.median(found)))
            print(  # noqa: T201  # the study's table
                f"{truth} seed {seed}: {', '.join(mix.reason for mix in best)}; "
                f"error {before:.3f}, again {again:.3f}, planned {after:.3f} N.m; "
                f"widths {widths[-1]:.2f}",
                flush=True,
            )
    print(f"gain {np.median(gains):.2f}, widths {np.median(widths):.2f}")  # noqa: T201  # its summary
    assert np.median(gains) >= 1.5
    assert abs(np.median(widths) - 1.0) <= 0.25
