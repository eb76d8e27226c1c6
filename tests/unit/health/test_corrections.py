"""Corrections of a robot file, findings that follow from others, and results that are odd."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from faulty_logs import SOUND_TORQUE, two_joints, with_units
from planted_mistakes import MISTAKES, from_columns, to_columns
from sound_benches import BENCHES

from hesr_model.findings import Finding
from hesr_model.fitting.estimator import registry
from hesr_model.friction.law import FrictionLaw
from hesr_model.health.evidence import TorqueFit
from hesr_model.health.examine import (
    HealthError,
    _remove_followers,
    _replace_symptoms,
    check_body,
    check_laws,
    check_owner,
    is_hopeless,
    merge_findings,
    require_sound,
)
from hesr_model.health.joints import apply_changes
from hesr_model.health.mistakes import SupposedRows, _snap_to_axis, generate_mistakes
from hesr_model.health.proposal import (
    _estimate_constants,
    _limit_cutoff,
    _merge_changes,
    propose,
)
from hesr_model.health.referee import Estimate
from hesr_model.health.torque import find_sign_change
from hesr_model.logs.log_format import column_names
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.robots.robot import Robot, RobotDescription


def finding(check: str, joint: str = "", severity: str = "warning", **changes: object) -> Finding:
    return Finding(
        check=check,
        severity=severity,
        joints=(joint,) if joint else (),
        logs=("one",),
        found=f"{check} of {joint}",
        remedy="cause",
        changes={key.replace("_", "."): value for key, value in changes.items()},
    )


SIGN = finding("torque-sign", "a", "error")
SIGNS: dict[str, tuple[dict[str, object], int | None, bool, dict[str, tuple[object, ...]]]] = {
    "one torque": ({}, 1, False, {"log.units.tau": ("N.m", "-N.m", "N.m")}),
    "all torques": ({}, None, False, {"log.units.tau": ("-N.m", "-N.m", "-N.m")}),
    "a torque that counts backwards": (
        {"tau": ("N.m", "-mN.m", -3.0)}, 1, False, {"log.units.tau": ("N.m", "mN.m", -3.0)},
    ),
    "a current": (
        {"torque_per_ampere": (1.0, -2.5, 3.0)}, 1, False,
        {"log.torque_per_ampere": (1.0, 2.5, 3.0)},
    ),
    "a position": (
        {"q": ("rad", "-deg", 2.0)}, 2, True,
        {"log.units.q": ("rad", "-deg", -2.0), "log.units.dq": ("rad/s", "rad/s", "-rad/s")},
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", SIGNS)
def test_a_sign_is_corrected_in_the_unit_that_is_declared(case: str, arm: RobotDescription) -> None:
    units, joint, position, changes = SIGNS[case]
    assert find_sign_change(with_units(arm, **units), joint, position=position) == changes


COUPLED = ((20.0, 0.0, 0.0), (0.0, -30.0, 0.0), (0.0, 10.0, 40.0))
DESCRIPTIONS: dict[str, dict[str, object]] = {
    "joints": {},
    "zeros and units": {
        "log.zero": (0.5, -1.0, 2.0), "log.units.q": ("deg", "rad", -1.0),
        "log.units.tau": ("N.m", "mN.m", "-N.m"),
    },
    "currents": {"log.torque_per_ampere": (2.0, -3.0, 0.5), "log.zero": (0.0, 1.0, 0.0)},
    "coupled motors": {
        "transmission": {"matrix": COUPLED, "logs": "motor", "friction": "motor"},
        "log.zero": (0.1, 0.2, -0.3),
    },
}  # fmt: skip


@pytest.mark.parametrize("case", DESCRIPTIONS)
def test_a_mistake_is_tried_on_the_rows_that_the_changed_file_reads(
    case: str, arm: RobotDescription
) -> None:
    """Units, gears and zeros belong to the places of columns, not to what they hold."""
    description = apply_changes(arm, DESCRIPTIONS[case])
    robot = Robot(description)
    q, v, a, tau = np.random.default_rng(0).normal(size=(4, 50, 3))
    log = Log(name="run", t=np.arange(50.0), q=q, dq=v, tau=tau)
    logged = description.logged
    rows = SupposedRows(
        q=q, v=v, a=a, tau=tau if logged is None else logged.torque(tau), gravity=robot.gravity
    )
    checks = set()
    for mistake in generate_mistakes(rows, robot, np.ones(3, dtype=bool)):
        changed = apply_changes(description, mistake.changes)
        raw = to_columns(log, description)
        orders = {
            key: [_name(description, key).index(name) for name in _name(changed, key)]
            for key in ("q", "tau", "current")
        }
        effort = "tau" if description.log.torque_per_ampere is None else "current"
        read = from_columns(
            replace(raw, q=raw.q[:, orders["q"]], tau=raw.tau[:, orders[effort]]), changed
        )
        read_tau = read.tau if logged is None else logged.torque(read.tau)
        np.testing.assert_allclose(mistake.corrected.q, read.q, atol=1e-9, err_msg=mistake.remedy)
        np.testing.assert_allclose(mistake.corrected.tau, read_tau, atol=1e-9)
        # Both are derivatives of the position.
        change = np.linalg.lstsq(q - q.mean(0), read.q - read.q.mean(0), rcond=None)[0]
        np.testing.assert_allclose(mistake.corrected.v, v @ change, atol=1e-9)
        np.testing.assert_allclose(mistake.corrected.a, a @ change, atol=1e-9)
        checks.add(mistake.check)
    assert {"torque-sign", "position-sign", "torque-columns", "joint-order", "zero"} <= checks


def _name(description: RobotDescription, key: str) -> list[str]:
    return column_names(getattr(description.log.columns, key), description.joints)


def test_changes_of_several_findings_are_combined(arm: RobotDescription) -> None:
    sign = finding("velocity-sign", "j1", log_units_dq=("-rad/s", "rad/s", "rad/s"))
    scale = finding("velocity-scale", "j2", log_units_dq=("rad/s", "rpm", "rad/s"))
    useless = finding("zero", "j2", log_units_q="rad")
    changes, reasons = _merge_changes(arm, [sign, scale, useless])
    assert changes == {"log.units.dq": ("-rad/s", "rpm", "rad/s")}
    assert reasons == {"log.units.dq": "sure: velocity-sign of j1; velocity-scale of j2"}
    assert _merge_changes(arm, [scale])[1]["log.units.dq"].startswith("likely: ")


def test_equal_findings_of_several_logs_and_joints_are_one() -> None:
    both_logs = [SIGN, replace(SIGN, logs=("two",)), replace(SIGN, joints=("b",))]
    found = merge_findings([finding("gaps"), *both_logs])
    assert found[0].check == "torque-sign"
    assert {log for f in found for log in f.logs} == {"one", "two"}
    assert {joint for f in found for joint in f.joints} == {"a", "b"}


def test_errors_are_refused_unless_they_are_accepted() -> None:
    lag = finding("torque-lag", "a")
    with pytest.raises(HealthError) as caught:
        require_sound([lag, SIGN])
    assert [f.check for f in caught.value.findings] == ["torque-sign"]
    assert {f.check for f in require_sound([lag, SIGN], ["torque-sign"])} == {
        "torque-lag",
        "torque-sign",
    }


@pytest.mark.parametrize(
    ("cause", "left"),
    [
        (None, {"torque-sign", "torque-lag", "torque-scale", "gaps"}),
        (finding("zero", "c"), {"gaps", "zero"}),  # any symptom can follow from it
        (finding("torque-sign", severity="error"), {"gaps", "torque-sign"}),
        (SIGN, {"torque-lag", "gaps", "torque-sign"}),  # of joint a alone
    ],
)
def test_symptoms_of_a_cause_are_left_out(cause: Finding | None, left: set[str]) -> None:
    symptoms = [SIGN, finding("torque-lag", "b"), finding("torque-scale", "a"), finding("gaps")]
    found = _replace_symptoms(symptoms, [cause] if cause else [])
    assert {f.check for f in found} == left


@pytest.mark.parametrize(
    ("other", "left"),
    [
        (finding("gaps"), {"velocity-match", "speed-limit"}),
        (finding("velocity-columns", "a"), {"speed-limit"}),
        (finding("same-column", "a"), {"speed-limit"}),
        (finding("same-column", "b"), {"velocity-match", "speed-limit"}),
        (finding("velocity-scale", "b", log_units_dq="rpm"), {"velocity-match"}),
        (finding("coarse", "c"), {"velocity-match"}),
    ],
)
def test_findings_that_follow_from_others_are_left_out(other: Finding, left: set[str]) -> None:
    followers = [finding("velocity-match", "a", "error"), finding("speed-limit", "b")]
    found = _remove_followers([*followers, other])
    assert {f.check for f in found} - {other.check} == left


def test_wrong_positions_and_times_hide_other_mistakes() -> None:
    hiding = [
        *(finding(check, "a", "error") for check in ("limits", "wrap", "spikes")),
        finding("time-unit", "", "error", log_units_t="ms"),
        finding("velocity-scale", "", "error", log_units_q="deg"),
    ]
    assert all(is_hopeless([f]) for f in hiding)
    assert not any(is_hopeless([replace(f, severity="warning")]) for f in hiding)
    assert not is_hopeless([finding("zero", "a", "error"), SIGN])
    assert not is_hopeless([finding("velocity-scale", "", "error", log_units_dq="rpm")])


GRAVITY = replace(
    SOUND_TORQUE,
    gravity=Estimate(value=2.0, error=0.01),
    inertia=Estimate(value=1.0, error=0.1),
    friction_size=1.0,
)


def of_gravity(value: float, error: float = 0.01) -> TorqueFit:
    return replace(GRAVITY, gravity=Estimate(value=value, error=error))


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)])
def test_a_gravity_near_an_axis_is_along_it(axis: tuple[float, ...]) -> None:
    """Nobody mounts a robot obliquely by 8 degrees."""
    sideways = np.roll(axis, 1)
    for degrees, snaps in ((8.0, True), (16.0, False)):
        angle = np.radians(degrees)
        oblique = np.cos(angle) * np.array(axis) + np.sin(angle) * sideways
        expected = axis if snaps else oblique
        np.testing.assert_allclose(_snap_to_axis(oblique), expected, rtol=1e-15)


def test_torque_constants_are_proposed_from_gravity(arm: RobotDescription) -> None:
    """A joint without gravity gets the median of the others."""
    amperes = apply_changes(arm, {"log.torque_per_ampere": (1.0, 2.0, -3.0)})

    def constants(*explained: dict[int, TorqueFit]) -> tuple[float, ...] | None:
        found = _estimate_constants(amperes, SimpleNamespace(fits=explained), {})
        return found.get("log.torque_per_ampere")

    assert constants({0: of_gravity(0.2), 1: of_gravity(-0.5)}, {0: of_gravity(0.3)}) == (
        pytest.approx((4.0, 4.0, -9.0))
    )
    assert constants({0: of_gravity(2.0)}) == pytest.approx((0.5, 1.0, -1.5))
    assert constants({0: of_gravity(1.15)}) is None
    assert constants({0: of_gravity(2.0, error=0.25)}) is None


@pytest.mark.parametrize(
    ("period", "cutoff"), [(0.02, 15.0), (0.03, 10.0), (0.1, 3.0), (0.5, 0.6), (2.0, 15.0)]
)
def test_the_cutoff_suits_the_slowest_log(
    period: float, cutoff: float, arm: RobotDescription
) -> None:
    logs = [two_joints(50, step) for step in (0.001, period)]
    stated = arm.log.filter_cutoff
    limited = _limit_cutoff(arm, logs, {}, stated)
    assert limited.log.filter_cutoff == pytest.approx(cutoff, rel=0.01)
    # The rate was one in another unit of time.
    assert _limit_cutoff(limited, logs[:1], {}, stated).log.filter_cutoff == stated


@pytest.mark.parametrize(
    ("bench_name", "rate", "what", "key", "unit"),
    [
        # A sliding joint has no speed in rpm.
        ("cylinder", 50.0, "dq in rpm", "dq", "rad/s"),
        ("cylinder", 50.0, "dq in mm/s", "dq", "mm/s"),
        # Of stamps in ms the rate is 1 Hz or 2 Hz, which is no reason for a slower low pass.
        ("500 Hz", 1000.0, "t in milliseconds", "t", "ms"),
        ("500 Hz", 2000.0, "t in milliseconds", "t", "ms"),
    ],
)
def test_units_are_mended_in_the_file(
    bench_name: str, rate: float, what: str, key: str, unit: str, tmp_path: Path
) -> None:
    bench = replace(BENCHES[bench_name], rate=rate, seconds=5.0 if rate > 50.0 else 60.0)
    robot = Robot(bench.write_description(tmp_path))
    log = bench.record(0)[0]
    assert log.dq is not None
    spoilt = replace(log, dq=1e3 * log.dq)
    if what in MISTAKES:
        spoilt = MISTAKES[what].apply(log, 0, robot)
    path = tmp_path / "run.csv"
    spoilt.write(path)
    proposal = propose([path], robot.description, has_model=True)
    assert getattr(proposal.description.log.units, key) == unit
    assert proposal.description.log.filter_cutoff == robot.description.log.filter_cutoff
    assert bool(proposal.examination.findings) == (what == "dq in rpm")


@pytest.mark.parametrize(
    ("rotor", "coulomb", "checks"),
    [
        (0.1, 1.0, []),
        (-0.5, 1.0, ["mass-matrix"]),
        (0.1, -0.45, []),
        (0.1, -0.55, ["negative-friction"]),
    ],
)
def test_an_impossible_body_is_reported(
    rotor: float, coulomb: float, checks: list[str], arm_model: Robot
) -> None:
    parameters = np.append(arm_model.nominal_parameters[:-1], rotor)
    friction = np.array([[1.0, 2.0, 0.0], [coulomb, 2.0, 0.0], [1.0, 2.0, 0.0]])
    body = SimpleNamespace(parameters=parameters, friction=friction, rmse=[1.0, 1.0, 1.0])
    assert [f.check for f in check_body(body, arm_model)] == checks


@pytest.mark.parametrize(
    ("speed", "checks"), [(0.0, ["negative-friction"]), (0.3, ["negative-friction"]), (0.8, [])]
)
def test_friction_must_brake_at_the_speeds_seen(
    speed: float, checks: list[str], arm_model: Robot
) -> None:
    """Over a few speeds, friction that grows faster than they do has a line below 0 at rest."""
    friction = np.array([[1.0, 2.0, 0.0], [-1.2, 2.0, 0.0], [1.0, 2.0, 0.0]])
    body = SimpleNamespace(
        parameters=arm_model.nominal_parameters, friction=friction, rmse=[1.0, 1.0, 1.0]
    )
    motions = [SimpleNamespace(dq=np.full((9, 3), speed))] if speed else []
    assert [f.check for f in check_body(body, arm_model, motions)] == checks


@pytest.mark.parametrize(
    ("rmse", "ratio", "checks"),
    [
        (0.9, 1.5, []),
        (1.0, 1.5, ["no-better-than-nothing"]),
        (0.1, 0.2, ["bound"]),
        (0.1, 0.21, []),
        (0.1, 4.8, []),
        (0.1, 5.0, ["bound"]),
    ],
)
def test_an_odd_law_is_reported(rmse: float, ratio: float, checks: list[str]) -> None:
    t = 0.01 * np.arange(200)
    tau = np.where(t < 1.0, 1.0, -1.0)
    dq = (1.0 + t) * tau
    q = 0.01 * np.cumsum(dq)
    record = FrictionRecord(
        log="run", joint="a", t=t, dq=dq, q=q, tau_load=tau, tau=tau, gear_ratio=None
    )
    numbers = {"sigma_0": 1e4, "sigma_1": 10.0, "v_s": 0.1, "sigma_2": 0.0, "tau_0": 0.0}
    law = FrictionLaw(
        name="lugre",
        form=registry()["lugre"].form({}),
        values={**numbers, "F_c": 2.0, "F_s": 2.0 * ratio},
    )
    model = SimpleNamespace(joints=("a",), training_rmse=[rmse], laws=[law])
    assert [f.check for f in check_laws({"lugre": model}, [[record]])] == checks


@pytest.mark.parametrize(
    ("robot", "joints", "checks"),
    [
        ("arm", ("j1", "j2", "j3"), []),
        ("other", ("j1", "j2", "j3"), ["other-robot"]),
        ("other", ("j1",), []),  # refused elsewhere
    ],
)
def test_a_law_of_another_robot_is_reported(
    robot: str, joints: tuple[str, ...], checks: list[str], arm_model: Robot
) -> None:
    owner = SimpleNamespace(robot=robot, joints=joints, law="lugre")
    assert [f.check for f in check_owner(owner, arm_model)] == checks
