"""Every mistake in a robot file is reported with joint and likely cause; clean logs pass."""

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from _pytest.mark.structures import ParameterSet
from numpy.typing import NDArray

from hesr_model.errors import ConfigError
from hesr_model.findings import Finding
from hesr_model.health.examine import CHECKS, HealthError, check_logs, examine
from hesr_model.health.proposal import propose
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.robots.robot import Robot
from hesr_model.support.typed_files import from_json, to_json

Array = NDArray[np.float64]
DEGREE = np.pi / 180.0
Mistake = Callable[[Log], Log]


@pytest.fixture
def log(make_motion: Callable[..., Motion]) -> Log:
    """The arm with torque noise and low friction, so that its small gravity torque is visible."""
    motion = make_motion(name="run", friction=0.8)
    noise = np.random.default_rng(0).normal(0.0, 0.05, motion.tau.shape)
    return Log(name="run", t=motion.t, q=motion.q, dq=motion.dq, tau=motion.tau + noise)


def column(values: Array | None, joint: int, scale: float, shift: float = 0.0) -> Array:
    assert values is not None
    changed = values.copy()
    changed[:, joint] = scale * changed[:, joint] + shift
    return changed


def swapped(values: Array | None, *order: int) -> Array:
    assert values is not None
    return values[:, list(order)]


def spiked(log: Log) -> Log:
    q = log.q.copy()
    q[700, 1] += 0.5
    return replace(log, q=q)


def late(values: Array | None, rows: int) -> Array:
    assert values is not None
    return np.concatenate([np.repeat(values[:1], rows, axis=0), values[:-rows]])


def rate(log: Log, factor: float) -> Array:
    assert log.dq is not None
    return log.dq * factor


def stuck(values: Array | None, joint: int) -> Array:
    assert values is not None
    changed = values.copy()
    changed[600:900, joint] = changed[600, joint]
    return changed


def held(log: Log, rows: int) -> Log:
    return replace(log, tau=np.repeat(log.tau[::rows], rows, axis=0)[: len(log.t)])


MISTAKES: dict[str, tuple[Mistake, str, tuple[str, ...], str]] = {
    "q in degrees": (
        lambda log: replace(log, q=log.q / DEGREE), "velocity-scale", ("j1", "j2", "j3"),
        r"q changes 57\.3 times faster than dq: q is in deg; set \[log\.units\] q = 'deg'",
    ),
    "q and dq in degrees": (
        lambda log: replace(log, q=log.q / DEGREE, dq=rate(log, 1 / DEGREE)), "limits",
        ("j1", "j2", "j3"), r"set \[log\.units\] q = 'deg'",
    ),
    "dq in rpm": (
        lambda log: replace(log, dq=rate(log, 30 / np.pi)), "velocity-scale", ("j1", "j2", "j3"),
        r"9\.55 times slower .* dq is in rpm",
    ),
    "dq of the motor of one joint": (
        lambda log: replace(log, dq=column(log.dq, 1, 100.0)), "velocity-scale", ("j2",),
        r"q changes 100 times slower than dq",
    ),
    "dq of one joint backwards": (
        lambda log: replace(log, dq=column(log.dq, 2, -1.0)), "velocity-sign", ("j3",),
        r"set \[log\.units\] dq = \['rad/s', 'rad/s', '-rad/s'\]",
    ),
    "dq columns swapped": (
        lambda log: replace(log, dq=swapped(log.dq, 0, 2, 1)), "velocity-columns", ("j2",),
        r"is in the column of joint 'j3'.* dq = \[.dq1., .dq3., .dq2.\]",
    ),
    "dq late": (
        lambda log: replace(log, dq=late(log.dq, 30)), "velocity-lag", ("j1", "j2", "j3"),
        r"its velocity is 150 ms late",
    ),
    "no dq in its column": (
        lambda log: replace(log, dq=rate(log, 0.0)), "velocity-constant", ("j1", "j2", "j3"),
        "the velocity is not logged",
    ),
    "half the sample rate": (
        lambda log: replace(log, t=2.0 * log.t), "velocity-scale", ("j1", "j2", "j3"),
        r"q changes 2 times slower .* \(wrong sample rate\)",
    ),
    "time in milliseconds": (
        lambda log: replace(log, t=1e3 * log.t), "time-unit", (), r"set \[log\.units\] t = 'ms'",
    ),
    "torque of j2 backwards": (
        lambda log: replace(log, tau=column(log.tau, 1, -1.0)), "torque-sign", ("j2",),
        r"drives the motion .* torque counts backwards; set \[log\.units\] tau = \['N\.m', '-N",
    ),
    "torque of j1 backwards, without gravity": (
        lambda log: replace(log, tau=column(log.tau, 0, -1.0)), "torque-sign", ("j1",),
        "its torque counts backwards, or",
    ),
    "j2 counts backwards": (
        lambda log: replace(log, q=column(log.q, 1, -1.0), dq=column(log.dq, 1, -1.0)),
        "position-sign", ("j2",), r"its position and velocity count backwards; .* '-rad'",
    ),
    "torque of j2 a hundredth": (
        lambda log: replace(log, tau=column(log.tau, 1, 0.01)), "torque-scale", ("j2",),
        r"torque is 0\.01 \(\+- 0\.\d+\) times",
    ),
    "currents as torques": (
        lambda log: replace(log, tau=log.tau / 12.0), "torque-scale", ("j1", "j2", "j3"),
        r"stated as gear_ratio, or it holds a current",
    ),
    "mN.m": (
        lambda log: replace(log, tau=1e3 * log.tau), "torque-scale", ("j2", "j3"),
        r"torque is in mN\.m",
    ),
    "torque columns swapped": (
        lambda log: replace(log, tau=swapped(log.tau, 0, 2, 1)), "torque-columns", ("j2",),
        r"tau = \[.tau1., .tau3., .tau2.\]",
    ),
    "joints in another order": (
        lambda log: replace(
            log, **{name: swapped(getattr(log, name), 1, 0, 2) for name in ("q", "dq", "tau")}
        ),
        "joint-order", ("j1",), "swapped with those of joint 'j2'",
    ),
    "zero of j2 a quarter turn off": (
        lambda log: replace(log, q=column(log.q, 1, 1.0, np.pi / 2)), "zero", ("j2",),
        "zero is -90 degrees",
    ),
    "one torque for two joints": (
        lambda log: replace(log, tau=swapped(log.tau, 0, 1, 1)), "same-column", ("j3",),
        "torque equals that of joint 'j2'",
    ),
    "torque that never changes": (
        lambda log: replace(log, tau=column(log.tau, 1, 0.0, 3.0)), "torque-constant", ("j2",),
        "its torque is not logged",
    ),
    "angles that wrap": (
        lambda log: replace(log, q=(log.q + np.pi + 2.9) % (2 * np.pi) - np.pi), "wrap", ("j1",),
        "the log wraps angles",
    ),
    "a row far off": (spiked, "spikes", ("j2",), "a row is wrong"),
    "torque cut off": (
        lambda log: replace(log, tau=np.clip(log.tau, *np.quantile(log.tau, [0.1, 0.9], axis=0))),
        "saturation", ("j2",),
        "friction beyond is not learned",
    ),
    "torque of one joint late": (
        lambda log: replace(log, tau=np.column_stack([
            log.tau[:, 0], late(log.tau, 30)[:, 1], log.tau[:, 2]
        ])), "torque-lag", ("j2",), r"its torque is about 1(4[5-9]|5[0-5]) ms late",
    ),
    "a stuck encoder": (
        lambda log: replace(log, q=stuck(log.q, 1)), "stuck", ("j2",),
        "= 3 s, while its velocity",
    ),
    "a stuck torque sensor": (
        lambda log: replace(log, tau=stuck(log.tau, 2)), "stuck", ("j3",),
        "= 3 s, while it moves",
    ),
    "torques at another rate": (
        lambda log: held(log, 5), "held-samples", (), "80 % of the rows in motion",
    ),
    "a row of torque far off": (
        lambda log: replace(log, tau=log.tau + 500.0 * (np.arange(len(log.t)) == 700)[:, None]),
        "torque-spikes", ("j1", "j2", "j3"), r"single row, at t = 3\.5",
    ),
    "rounded positions": (
        lambda log: replace(log, q=np.round(log.q, 2)), "coarse", ("j1", "j2", "j3"),
        r"comes in steps of 0\.01: it was rounded",
    ),
    "all torques backwards": (
        lambda log: replace(log, tau=-log.tau), "torque-sign", (),
        r"all torques count backwards; set \[log\.units\] tau = \['-N\.m', '-N",
    ),
    "all of j2 backwards": (
        lambda log: replace(
            log, q=column(log.q, 1, -1.0), dq=column(log.dq, 1, -1.0), tau=column(log.tau, 1, -1.0)
        ),
        "position-sign", ("j2",), "position, velocity and torque count backwards",
    ),
    "joints shifted by one": (
        lambda log: replace(
            log, **{name: swapped(getattr(log, name), 2, 0, 1) for name in ("q", "dq", "tau")}
        ),
        "joint-order", (), r"in another order than the joints; set \[log\.columns\] q = "
        r"\[.q2., .q3., .q1.\]",
    ),
    "torques late": (
        lambda log: replace(log, tau=late(log.tau, 30)), "torque-lag", (),
        r"about 1(4[5-9]|5[0-5]) ms late .* \(\+- \d ms\)",
    ),
}  # fmt: skip


def test_motor_angles_are_not_taken_for_degrees(log: Log, arm_model: Robot) -> None:
    """50 turns per turn look like degrees; only the names of the columns tell them apart."""
    turned = replace(log, q=50.0 * log.q, dq=None)
    robot = arm_model.description
    for name, said, changes in (
        ("q{}", "set [log.units] q = 'deg'", {"log.units.q": "deg"}),
        (
            "qm{}",
            "columns such as 'qm1' are named",
            {},
        ),
    ):
        columns = robot.log.columns.model_copy(update={"q": name})
        own = robot.model_copy(update={"log": robot.log.model_copy(update={"columns": columns})})
        first, *others = examine([turned], own, Robot(own)).findings
        assert "speed-limit" not in {f.check for f in others}
        assert (first.check, first.severity, first.changes) == ("limits", "error", changes)
        assert said in first.sentence


def test_speeds_above_the_model_limits_are_reported(log: Log, arm_model: Robot) -> None:
    lower, upper, _ = arm_model.limits
    limited = Robot(arm_model.description)
    limited.__dict__["limits"] = (lower, upper, np.array([0.5, 5.0, 0.0]))
    (finding,) = examine([log], limited.description, limited).findings
    assert (finding.check, finding.joints) == ("speed-limit", ("j1",))
    assert "times the model's limit: the time" in finding.sentence


def test_inertia_against_gravity_reveals_the_time_stamp_rate(
    make_motion: Callable[..., Motion], arm_model: Robot
) -> None:
    motion = make_motion(name="run", seconds=30.0, friction=0.8)
    noise = np.random.default_rng(0).normal(0.0, 0.05, motion.tau.shape)
    tau = motion.tau + noise
    log = Log(name="run", t=motion.t, q=motion.q, dq=None, tau=tau)
    assert examine([log], arm_model.description, arm_model).findings == ()
    fast = examine([replace(log, t=0.5 * log.t)], arm_model.description, arm_model).findings
    (told,) = (finding for finding in fast if finding.check == "time-scale")
    assert re.search(r"a motion that is 2(\.\d)? times slower: .* sample rate", told.sentence)


def test_computed_torques_are_reported(
    make_motion: Callable[..., Motion], arm_model: Robot
) -> None:
    m = make_motion()
    (finding,) = examine(
        [Log(name="run", t=m.t, q=m.q, dq=m.dq, tau=m.tau)], arm_model.description, arm_model
    ).findings
    assert (finding.check, finding.joints) == ("no-friction", ("j1", "j2", "j3"))
    assert "they were computed or commanded instead" in finding.remedy


def test_torques_without_gravity_are_refused(log: Log, arm_model: Robot) -> None:
    nothing = np.zeros_like(log.q)
    gravity = arm_model.torque(arm_model.nominal_parameters, log.q, nothing, nothing)
    found = examine(
        [replace(log, tau=log.tau - gravity)], arm_model.description, arm_model
    ).findings
    assert [(f.check, f.joints) for f in found] == [("torque-scale", ("j2",))]
    assert "gravity was removed from it" in found[0].remedy


def test_a_clean_log_has_no_finding(log: Log, arm_model: Robot) -> None:
    assert check_logs([log], arm_model) == []
    assert check_logs([replace(log, dq=None)], arm_model) == []


REMAINS = {
    "dq late",  # dq = "" helps, but the velocity may be wanted
}


def select_mistakes() -> Iterator[ParameterSet]:
    """Yield mistakes as parameters of a test: the first of each check in every gate."""
    firsts = {check: what for what, (_, check, _, _) in reversed(MISTAKES.items())}
    for what in MISTAKES:
        in_gate = what in firsts.values() or what in REMAINS
        yield pytest.param(what, marks=() if in_gate else pytest.mark.nightly("studies"))


@pytest.mark.ci
@pytest.mark.parametrize("what", list(select_mistakes()))
def test_a_remedy_is_offered_only_where_it_helps(
    what: str, log: Log, arm_model: Robot, tmp_path: Path
) -> None:
    """Each change was applied: its finding is gone without a new one, or it is withdrawn."""
    robot, path = arm_model.description, tmp_path / "log.csv"
    MISTAKES[what][0](log).write(path)
    found = propose([path], robot, has_model=True)
    first = {(f.check, joint): f for f in found.first_findings for joint in f.joints or ("",)}
    assert all(f.changes for f in found.first_findings if "; set " in f.remedy)
    again = examine(
        [Log.read(path, found.description)], found.description, Robot(found.description)
    ).findings
    # A column that a correction no longer uses is left over, without a remedy to try.
    findings = [f for f in found.examination.findings if f.check != "left-over"]
    assert {f.check for f in again} == {f.check for f in findings}
    for finding in findings:
        assert set(first) & {(finding.check, joint) for joint in finding.joints or ("",)}
        offered = "; set " in finding.remedy
        assert offered == (what in REMAINS)
        assert offered or not finding.changes
    fixed = {f.check for f in found.first_findings if f.changes} - {f.check for f in again}
    assert bool(fixed) == (found.description != robot), (found.reasons, found.examination.findings)


@pytest.mark.parametrize("what", MISTAKES)
def test_a_mistake_is_reported_with_joint_and_cause(what: str, log: Log, arm_model: Robot) -> None:
    spoil, check, joints, sentence = MISTAKES[what]
    findings = examine([spoil(log)], arm_model.description, arm_model).findings
    named = [f for f in findings if f.check == check and set(joints) <= set(f.joints)]
    assert named, [f.sentence for f in findings]
    assert re.search(sentence, named[0].sentence), named[0].sentence


def test_a_wrong_gravity_direction_is_reported(log: Log, arm_model: Robot) -> None:
    for gravity, words in (((0.0, 0.0, 9.81), "upside down"), ((9.81, 0.0, 0.0), "another side")):
        other = Robot(arm_model.description.model_copy(update={"gravity": gravity}))
        (finding,) = examine([log], other.description, other).findings
        assert (finding.check, finding.changes["gravity"]) == ("gravity", (0.0, 0.0, -9.81))
        assert words in finding.remedy


def test_all_problems_are_reported_at_once_and_can_be_accepted(log: Log, arm_model: Robot) -> None:
    wrong = replace(log, dq=column(log.dq, 2, -1.0), tau=column(log.tau, 1, -1.0))
    with pytest.raises(HealthError, match=r"^2 errors in the data\.") as refused:
        check_logs([wrong], arm_model)
    message = str(refused.value)
    assert "joint 'j2'" in message
    assert "joint 'j3'" in message
    assert "accept=[" in message
    assert "'velocity-sign'" in message
    with pytest.raises(HealthError, match=r"To continue anyway: accept=\['torque-sign'\]\.$"):
        check_logs([wrong], arm_model, ["velocity-sign"])
    told = check_logs([wrong], arm_model, ["velocity-sign", "torque-sign"])
    assert {f.check for f in told} == {"velocity-sign", "torque-sign"}


def test_only_checks_can_be_accepted(log: Log, arm_model: Robot) -> None:
    with pytest.raises(ConfigError, match=r"'accept' is 'everything'; the checks are time-unit, "):
        check_logs([log], arm_model, ["everything"])


def test_a_finding_survives_json() -> None:
    finding = Finding(
        check=CHECKS[0], severity="warning", joints=("a",), logs=("x", "y"), found="f", remedy="c"
    )
    assert from_json(Finding, to_json(finding), Path("health.json"), "a finding") == finding
    assert finding.sentence == "log x and 1 more, joint 'a': f: c."


def limit_first_joint(robot: Robot, limits: str) -> Robot:
    """Return the arm with other limits of its first joint, whose axis is vertical."""
    path = robot.description.model
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('range="-3 3"', f'range="{limits}"'), encoding="utf-8")
    return Robot(robot.description)


@pytest.mark.parametrize(
    ("limits", "check", "key", "words"),
    [
        ("-1.6 3", "position-sign", "log.units.q", ""),
        ("-3 1.6", "torque-sign", "log.units.tau", ""),
        ("-3 3", "torque-sign", "log.units.tau", "position and velocity"),
    ],
)
def test_limits_decide_a_sign_that_gravity_does_not(
    limits: str, check: str, key: str, words: str, log: Log, arm_model: Robot
) -> None:
    """A position that is reversed beyond the limits is no torque that counts backwards."""
    spoilt = replace(log, q=column(log.q, 0, -1.0, -1.4), dq=column(log.dq, 0, -1.0))
    assert spoilt.q[:, 0].min() < -2.0
    robot = limit_first_joint(arm_model, limits)
    findings = examine([spoilt], robot.description, robot).findings
    sign_findings = [f for f in findings if f.check.endswith("-sign") and f.joints == ("j1",)]
    (finding,) = sign_findings
    assert finding.check == check
    assert key in finding.changes
    assert words in finding.remedy
    assert ("cannot show which" in finding.remedy) == bool(words)
