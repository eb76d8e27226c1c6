"""Observer on the twin: false alarms in free motion, coverage of its limits, and pushes found."""

from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from observer_bench import EDGE, LATE, STEP, TRUTHS, arm, bench, moved, pushed, pushes, seeds_within

from hesr.extras.observer.observation import ObservedLog, compute_limits, observe_logs

CALIBRATION = 20  # motions of half a minute


def cases() -> Iterator[object]:
    """Yield truth, minutes of free motion, and motions with pushes."""
    yield pytest.param(None, 10, 10, marks=pytest.mark.ci, id="ten minutes")
    for truth in TRUTHS:
        yield pytest.param(truth, 60, 20, marks=pytest.mark.soak, id=f"an hour of {truth}")


def alarms(run: ObservedLog) -> int:
    return int(np.count_nonzero(run.contact[1:] & ~run.contact[:-1]))


@pytest.mark.parametrize(("truth", "minutes", "pushed_motions"), list(cases()))
def test_contacts_are_found_without_false_alarms(
    truth: str | None, minutes: int, pushed_motions: int, tmp_path: Path
) -> None:
    own = bench(tmp_path / "arm", truth, "parfam_s")
    found, tried, shares = Counter[str](), Counter[str](), []
    with ExitStack() as cleanup:
        fmu = cleanup.enter_context(arm(own))
        unseen = [moved(fmu, seed)[0] for seed in seeds_within(own, 1000, CALIBRATION)]
        limits = compute_limits(own.law, own.plant, unseen)
        seeds = seeds_within(own, 2000, 2 * minutes)
        free = [moved(fmu, seed) for seed in seeds]
        runs = observe_logs(own.law, own.plant, limits, [log for log, _ in free])
        assert sum(map(alarms, runs)) <= 1
        inside = np.concatenate(
            [
                (run.outputs["tau_ext_lower"] <= 0.0) & (run.outputs["tau_ext_upper"] >= 0.0)
                for run in runs
            ]
        )
        speed = np.abs(np.concatenate([dq for _, dq in free]))
        for some in (speed >= 0.0, speed > 0.05, speed < EDGE):  # all, in motion, at rest
            shares += (np.sum(inside & some, axis=0) / np.sum(some, axis=0)).tolist()
        assert 0.93 <= min(shares) <= max(shares) <= 0.97, shares
        rng, plans, logs = np.random.default_rng(5), [], []
        for seed, (log, dq), run in list(zip(seeds, free, runs, strict=True))[:pushed_motions]:
            plans.append(pushes(rng, dq, run.outputs["contact_threshold"]))
            logs.append(moved(fmu, seed, pushed(plans[-1], len(log.t) - 1))[0])
    for plan, run in zip(plans, observe_logs(own.law, own.plant, limits, logs), strict=True):
        for one in plan:
            tried[one.kind] += 1
            found[one.kind] += bool(run.contact[one.row + 1 :][: round(LATE / STEP)].any())
    print(truth, sum(map(alarms, runs)), np.round(shares, 3), found, tried)  # noqa: T201  # the figures
    assert min(tried["motion"], tried["rest"], tried["reversal"]) >= 10, tried
    assert found.total() >= 0.95 * tried.total(), (found, tried)
    assert found["reversal"] >= 0.95 * tried["reversal"], (found, tried)


@pytest.mark.ci
def test_a_wrong_payload_is_external_and_noise_is_not(tmp_path: Path) -> None:
    own = bench(tmp_path / "arm", None, "parfam_s")
    seeds, mass = seeds_within(own, 3000, 4), 3.0
    with arm(own) as fmu:
        unseen = [moved(fmu, seed)[0] for seed in seeds_within(own, 1000, CALIBRATION)]
        limits = compute_limits(own.law, own.plant, unseen)
        loaded = [moved(fmu, seed, payload=mass)[0] for seed in seeds]
        noisy = [moved(fmu, seed, noise=1.5)[0] for seed in seeds]
    for run, log in zip(observe_logs(own.law, own.plant, limits, loaded), loaded, strict=True):
        assert run.contact.mean() > 0.5
        # Its weight at the end of the arm acts on joints 2 and 3, not on the upright joint 1.
        moving = np.abs(run.outputs["tau_ext"][200:]).mean(axis=0)
        assert moving[1] > 10.0 * moving[0]
        assert np.ptp(log.q[:, 1]) > 0.1
    for run in observe_logs(own.law, own.plant, limits, noisy):
        assert alarms(run) <= 1
        inside = (
            np.abs(run.outputs["tau_ext"]) <= run.outputs["tau_ext_upper"] - run.outputs["tau_ext"]
        )
        assert inside.mean() > 0.75
