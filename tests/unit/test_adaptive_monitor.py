"""Friction over days: changes found, the joint concerned and the likely cause."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_models import lugre, model, motion, truth
from containing import Containing

from hesr.extras.adaptive.component import TUNING
from hesr.extras.adaptive.monitor import Alarm, State, find_shared_signs, watch
from hesr.extras.adaptive.page import Monitoring
from hesr_model.rigid_body.friction_record import FrictionRecord

MODEL = model(lugre(), lugre(), lugre())


def day(
    log: str, seed: int, *, seconds: float = 45.0, worn: tuple[int, ...] = (), offset: float = 0.0
) -> list[FrictionRecord]:
    """Records of three joints; friction of worn joints rises by a quarter after 20 s."""
    found = []
    for k, joint in enumerate(MODEL.joints):
        rise = 0.25 * float(k in worn)
        record = truth(
            lugre(),
            *motion(seconds, seed + k),
            seed=10 * seed + k,
            level=lambda t, rise=rise: 1.0 + rise * (t > 20.0),
            viscosity=np.ones_like,
        )
        shifted = record.tau + offset * (k == 0) * (record.t > 20.0)
        found.append(replace(record, log=log, joint=joint, tau=shifted))
    return found


def test_wear_is_found_in_its_joint_and_carried_over() -> None:
    watched = watch(MODEL, [day("one", 0), day("two", 1, worn=(1,)), day("three", 2)])
    assert {(a.log, a.joint, a.kind, a.sign) for a in watched.alarms if a.log != "three"} == {
        ("two", "j2", "drift", 1)
    }
    [first] = [a for a in watched.alarms if a.log == "two"]
    assert 20.0 < first.time < 40.0
    assert "wear" in first.points_to
    level = {(s.log, s.joint): s.level for s in watched.states}
    assert level["two", "j2"] > 1.07
    assert abs(level["two", "j1"] - 1.0) < 0.05
    # The next log starts with half of the learned change.
    carried = watched.followed[2][1].outputs["level"][0] - 1.0
    assert carried == pytest.approx(TUNING.carried * (level["two", "j2"] - 1.0), abs=1e-12)
    assert all(0.9 < s.learning <= 1.0 for s in watched.states)


def test_a_change_common_to_all_joints_is_not_wear() -> None:
    watched = watch(MODEL, [day("one", 3, worn=(0, 1, 2))])
    assert {(a.kind, a.sign) for a in watched.alarms} == {("shared drift", 1)}


def test_a_load_is_not_taken_for_friction() -> None:
    watched = watch(MODEL, [day("one", 4, offset=3.0)])
    assert [(a.joint, a.kind, a.sign) for a in watched.alarms][:1] == [("j1", "shift", 1)]
    assert not any("drift" in a.kind for a in watched.alarms)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_common_change_needs_more_than_half_of_the_joints(sign: int) -> None:
    assert find_shared_signs([("j1", sign), ("j2", sign), ("j3", -sign)], 3) == [sign]
    assert find_shared_signs([("j1", sign), ("j1", sign)], 3) == []
    assert find_shared_signs([("j1", sign), ("j2", -sign)], 2) == []


def monitoring(alarms: int) -> Monitoring:
    def state(log: str, joint: str) -> State:
        return State(
            log=log,
            joint=joint,
            level=1.25,
            level_sd=0.01,
            viscosity=0.8,
            viscosity_sd=0.02,
            offset=-0.4321,
            offset_sd=0.15,
            learning=1.0,
            rmse_fixed=0.5,
            rmse=0.25,
        )

    return Monitoring(
        model=MODEL,
        followed=(),
        states=tuple(state(log, joint) for log in ("one", "two") for joint in MODEL.joints),
        alarms=tuple(
            Alarm(log="one", joint="j1", time=2.25, kind="shift", sign=(-1) ** k)
            for k in range(alarms)
        ),
    )


@pytest.mark.parametrize(
    ("count", "first", "more"),
    [
        (0, "0 changes of friction found.", None),
        (1, "1 change of friction found.", None),
        (12, "12 changes of friction found.", None),
        (15, "15 changes of friction found.", "3 more alarms: --verbose lists them."),
    ],
)
def test_an_answer_lists_twelve_alarms_and_the_last_states(
    count: int, first: str, more: str | None
) -> None:
    lines = monitoring(count).summary().splitlines()
    assert lines[0] == first
    for k, line in enumerate(lines[1 : 1 + min(count, 12)]):
        assert line == Containing(
            "one, j1, 2.2 s:", "less" if k % 2 else "more", "a payload, a gravity error"
        )
    assert (more in lines) is (more is not None)
    assert lines[-3:] == [
        f"{joint}: level 1.250 ± 0.020, viscous factor 0.800 ± 0.040, offset -0.432 ± 0.3"
        for joint in MODEL.joints
    ]
    assert len(lines) == 1 + min(count, 12) + (more is not None) + 3
