"""Robots and logs of many kinds: inspected without edits or false findings, and fitted."""

import gzip
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import openpyxl
import pytest
import scipy.io
from small_study import Hesr, hesr_here

import hesr as api
from hesr_model.robots.robot import Robot, RobotDescription

Arrays = dict[str, np.ndarray]
COULOMB, KNEE, VISCOUS = np.array([3.0, 2.0]), 0.02, np.array([1.5, 1.0])
NOISE = 0.05
RATE = 100.0

INERTIAL = '<inertial pos="0.25 0.02 0" mass="3" diaginertia="0.02 0.03 0.03"/>'
LINK = """<link name="{}"><inertial><mass value="{}"/><origin xyz="0.25 0.02 0"/>
<inertia ixx="0.02" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/>
<origin xyz="{} 0 0"/><axis xyz="{}"/><limit lower="-3" upper="3" velocity="4" effort="90"/>{}
</joint>"""


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def chain(names: tuple[str, str], *, frame: str = "", ref: float = 0.0) -> str:
    """Bodies of two joints, the second with a reference position."""
    own = f'<joint name="{names[0]}" axis="0 1 0" range="-3 3"/>{INERTIAL}'
    other = f'<joint name="{names[1]}" axis="0 1 0" range="-3 3" ref="{ref}"/>{INERTIAL}'
    inner = f'<body pos="0.5 0 0">{other}</body>'
    return f'<body name="{names[0]}_base" {frame}><body>{own}{inner}</body></body>'


def mjcf(folder: Path, *bodies: str, more: str = "") -> Path:
    path = folder / "arm.xml"
    text = f'<mujoco><compiler angle="radian"/><worldbody>{"".join(bodies)}</worldbody>{more}'
    path.write_text(f"{text}</mujoco>", encoding="utf-8")
    return path


def urdf(folder: Path, *, mass: str = "3", axis: str = "0 1 0") -> Path:
    """Two joints; a link has the name of a joint."""
    parts = (
        '<link name="base"/>',
        LINK.format("elbow", "3"),
        LINK.format("tool", mass),
        JOINT.format("shoulder", "base", "elbow", 0, "0 1 0", ""),
        JOINT.format("elbow", "elbow", "tool", 0.5, axis, ""),
    )
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="arm">{"".join(parts)}</robot>', encoding="utf-8")
    return path


def followers(folder: Path) -> Path:
    """Follow a leader through a follower; `b` = -`a` + 0.1 and `c` = 0.5 `b`."""
    mimics = [
        f'<mimic joint="{j}" multiplier="{k}" offset="{b}"/>'
        for j, k, b in (("a", -1, 0.1), ("b", 0.5, 0.0))
    ]
    kinds = zip(("a", "b", "c", "last"), ("", *mimics, ""), strict=True)
    links, joints, parent = ['<link name="base"/>'], [], "base"
    for name, mimic in kinds:
        links.append(LINK.format(f"{name}_link", "2"))
        place = 0.0 if parent == "base" else 0.4
        joints.append(JOINT.format(name, parent, f"{name}_link", place, "0 1 0", mimic))
        parent = f"{name}_link"
    path = folder / "chain.urdf"
    path.write_text(f'<robot name="chain">{"".join(links + joints)}</robot>', encoding="utf-8")
    return path


def friction(dq: np.ndarray) -> np.ndarray:
    return np.asarray(COULOMB * np.tanh(dq / KNEE) + VISCOUS * dq)


def motion(robot: Robot | None = None, inertia: float = 0.2) -> Arrays:
    """A motion of two joints for 40 s, with torques of a robot or of separate inertias."""
    t = np.arange(0.0, 40.0, 1.0 / RATE)
    sizes, rates = (
        np.array([1.2, 0.8, 0.5]),
        2 * np.pi * np.array([[0.1, 0.23, 0.37], [0.13, 0.19, 0.41]]),
    )
    angle = t[:, None, None] * rates + np.arange(3)
    q = np.sum(sizes / rates * np.sin(angle), axis=2) / 2.0 + 0.2
    dq = np.sum(sizes * np.cos(angle), axis=2) / 2.0
    ddq = -np.sum(sizes * rates * np.sin(angle), axis=2) / 2.0
    body = inertia * ddq if robot is None else robot.torque(robot.nominal_parameters, q, dq, ddq)
    noise = np.random.default_rng(3).normal(0.0, NOISE, q.shape)
    return {"t": t, "q": q, "dq": dq, "tau": body + friction(dq) + noise}


def csv(path: Path, data: Arrays, names: tuple[str, ...], form: str = "%.7g") -> Path:
    head = f"t,{','.join(k.format(j) for k in ('q_{}', 'dq_{}', 'tau_{}') for j in names)}"
    table = np.column_stack([data["t"], data["q"], data["dq"], data["tau"]])
    np.savetxt(path, table, form, ",", header=head, comments="")
    return path


@dataclass(frozen=True, kw_only=True)
class Given:
    """A log, and options of `hesr inspect`, or of the bench that reads it."""

    log: Path
    options: tuple[object, ...] = ()
    new: tuple[object, ...] = ()
    scale: float = 1.0  # of speeds


def mounted(folder: Path) -> Given:
    path = mjcf(folder, chain(("j1", "j2"), frame='euler="1.5707963 0.4 0" pos="0 0 1"'))
    log = csv(folder / "log.csv", motion(Robot(path)), ("j1", "j2"))
    return Given(log=log, options=("--robot", path))


def two_arms(folder: Path) -> Given:
    left, right = chain(("l1", "l2")), chain(("r1", "r2"), frame='euler="0 0.9 0"')
    path = mjcf(folder, left, right)
    own = RobotDescription(name="right", model=path, joints=("r1", "r2"), locked={})
    log = csv(folder / "log.csv", motion(Robot(own)), ("r1", "r2"))
    return Given(log=log, options=("--robot", path, "--joints", "r1,r2"))


def references(folder: Path) -> Given:
    path = mjcf(folder, chain(("j1", "j2"), ref=0.6))
    return Given(
        log=csv(folder / "log.csv", motion(Robot(path)), ("1", "2")), options=("--robot", path)
    )


def mixed_names(folder: Path) -> Given:
    """Names of joints and links are the same, units are in the header, separated by blanks."""
    path = urdf(folder)
    data = motion(Robot(path))
    log = folder / "log.csv"
    head = [
        f"{joint}_{what}"
        for what in ("position_deg", "velocity_deg", "effort")
        for joint in ("shoulder", "elbow")
    ]
    table = np.column_stack([data["t"], *np.degrees([data["q"], data["dq"]]), data["tau"]])
    np.savetxt(log, table, "%.7g", "\t", header="\t".join(["stamp", *head]), comments="")
    return Given(log=log, options=("--robot", path))


def mimic_chain(folder: Path) -> Given:
    path = followers(folder)
    log = csv(folder / "log.csv", motion(Robot(path)), ("a", "last"))
    return Given(log=log, options=("--robot", path))


def archive(folder: Path) -> Given:
    """No time, and two joints as an N x 2 array."""
    data = motion()
    np.savez(folder / "log.npz", position=data["q"], velocity=data["dq"], torque=data["tau"])
    new = ("rotary", "--joints", "a,b", "--log", f"rate={RATE:g}")
    return Given(log=folder / "log.npz", new=new)


def matlab(folder: Path) -> Given:
    """Matrices with a row per joint."""
    data = motion()
    arrays = {"time": data["t"][None], **{k: data[k].T for k in ("q", "dq", "tau")}}
    scipy.io.savemat(folder / "log.mat", arrays)
    return Given(log=folder / "log.mat", new=("rotary", "--joints", "a,b", "--inertia", "0.2"))


def wide_text(folder: Path) -> Given:
    """UTF-16, semicolons and decimal commas."""
    data = motion()
    head = "Zeit;Winkel 1;Winkel 2;Drehzahl 1;Drehzahl 2;Drehmoment 1;Drehmoment 2"
    table = np.column_stack([data["t"], data["q"], data["dq"], data["tau"]])
    rows = [";".join(f"{x:.7g}" for x in row).replace(".", ",") for row in table]
    (folder / "log.csv").write_text("\n".join([head, *rows]), encoding="utf-16")
    return Given(log=folder / "log.csv", new=("rotary", "--joints", "a,b"))


def packed(folder: Path) -> Given:
    """A packed table in ms and mm, without a header."""
    data = motion(inertia=40.0)
    table = np.column_stack([1e3 * data["t"], 1e2 * data["q"], 1e2 * data["dq"], data["tau"]])
    text = "\n".join(" ".join(f"{x:.7g}" for x in row) for row in table)
    (folder / "log.txt.gz").write_bytes(gzip.compress(text.encode()))
    names = '["t","q1","q2","dq1","dq2","tau1","tau2"]'
    units = 'units={t="ms",q="mm",dq="mm/s"}'
    options = ("--log", f"columns={names}", "--log", units)
    return Given(log=folder / "log.txt.gz", new=("sliding", "--joints", "x,y", *options), scale=0.1)


def workbook(folder: Path) -> Given:
    """A sheet with lines above the header."""
    data, book = motion(), openpyxl.Workbook()
    sheet = book.active
    assert sheet is not None
    sheet.append(["Bench 3", "recorded by A"])
    sheet.append([])
    sheet.append(["time", "pos1", "pos2", "vel1", "vel2", "torque1", "torque2"])
    for row in np.column_stack([data["t"], data["q"], data["dq"], data["tau"]]):
        sheet.append([float(x) for x in row])
    book.save(folder / "log.xlsx")
    return Given(log=folder / "log.xlsx", new=("rotary", "--joints", "a,b"))


KINDS: dict[str, Callable[[Path], Given]] = {
    "mounted": mounted,
    "two arms": two_arms,
    "references": references,
    "mixed names": mixed_names,
    "mimic chain": mimic_chain,
    "npz without time": archive,
    "mat": matlab,
    "UTF-16": wide_text,
    "gz without header": packed,
    "xlsx with preamble": workbook,
}


AT_ONCE = ("two arms", "mixed names", "npz without time", "UTF-16")


@pytest.mark.parametrize(
    "kind", [k if k in AT_ONCE else pytest.param(k, marks=pytest.mark.ci) for k in KINDS]
)
def test_a_log_is_inspected_without_a_finding_and_fitted(
    kind: str, tmp_path: Path, hesr: Hesr, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    given, robot = KINDS[kind](tmp_path), tmp_path / "robot.toml"
    options = given.options
    if given.new:
        answer = hesr("new", tmp_path / "bench", "--bench", *given.new)
        assert (answer.code, answer.err) == (0, "")
        robot = tmp_path / "bench" / "robot.toml"
        options = ("--robot", robot)
    answer = hesr("inspect", given.log, *options, "--write", robot)
    assert (answer.code, answer.err) == (0, "")
    advice, sound, _ = answer.out.partition("Nothing wrong or unusual was found.\n")
    assert sound, answer.out
    # Velocities in degrees, which is the unit of an angle, are not taken for either.
    assert [line for line in advice.splitlines() if not line.endswith("[left-over]")] == []
    assert bool(advice) == (kind == "mixed names")
    law = api.fit(given.log, robot=robot, law="stribeck")
    t, dq = np.arange(100) / RATE, np.linspace(0.1, 1.0, 6)
    for speed in (*dq, *-dq):
        found = law.predict(t=t, dq=np.full((100, 2), given.scale * speed))[-1]
        np.testing.assert_allclose(found, friction(np.full(2, speed)), rtol=0.03)
    assert not list(Path().iterdir())  # as MuJoCo's log


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (partial(urdf, mass="2,5"), "'2,5'"),
        (partial(urdf, axis="0 0 0"), "axis"),
    ],
)
def test_unreadable_robots_are_refused_with_the_element(
    make: Callable[[Path], Path], said: str, tmp_path: Path, hesr: Hesr
) -> None:
    answer = hesr("inspect", "--robot", make(tmp_path))
    assert answer.code == 2
    assert said in answer.err
    assert "elbow" in answer.err or "tool" in answer.err
    assert len(answer.err.splitlines()) == 1


@pytest.mark.parametrize("logged", [True, False], ids=["with velocity", "without velocity"])
def test_counts_of_an_encoder_are_an_error(logged: bool, tmp_path: Path) -> None:
    """No change is proposed, and nothing is sure: the counts per turn are unknown."""
    data = motion()
    names = ["time", "pos1", "pos2", *["vel1", "vel2"] * logged, "torque1", "torque2"]
    parts = [data["t"], np.rint(data["q"] * 4096 / (2 * np.pi)), *[data["dq"]] * logged]
    table = np.column_stack([*parts, data["tau"]])
    log, robot = tmp_path / "log.csv", tmp_path / "bench" / "robot.toml"
    np.savetxt(log, table, "%.7g", ",", header=",".join(names), comments="")
    api.new(robot.parent, bench="rotary", joints=["a", "b"])
    found = api.inspect(log, robot=robot, write=tmp_path / "robot.toml")
    (counts,) = [f for f in found.findings if f.check == "coarse"]
    assert (counts.severity, counts.joints) == ("error", ("a", "b"))
    assert "positions are whole numbers, as counts" in counts.found
    assert not [why for why in found.proposal.reasons.values() if why.startswith("sure")]
    assert found.proposal.description.log.units.q == "rad"
    # With the size of a count, as stated by the message, the log is sound.
    units = f"[log.units]\nq = {2 * np.pi / 4096}\n"
    robot.write_text(robot.read_text(encoding="utf-8") + units, encoding="utf-8")
    assert not [f for f in api.inspect(log, robot=robot).findings if f.severity == "error"]


def test_turns_are_likely_with_one_witness(tmp_path: Path) -> None:
    """Only the velocity is a witness; the positions stay within the limits."""
    path = mjcf(tmp_path, chain(("j1", "j2")))
    data = motion(Robot(path))
    log = csv(tmp_path / "log.csv", data | {"q": data["q"] / (2 * np.pi)}, ("1", "2"))
    found = api.inspect(log, robot=path, write=tmp_path / "robot.toml")
    assert found.proposal.description.log.units.q == "rev"
    assert found.proposal.reasons["log.units.q"].startswith("likely: ")
    assert not found.findings


def test_millimetres_of_two_axes_are_those_of_their_names(tmp_path: Path) -> None:
    data = motion(inertia=40.0)
    head = "time,pos1_mm,pos2_mm,vel1_mm_s,vel2_mm_s,force1,force2"
    table = np.column_stack([data["t"], 100 * data["q"], 100 * data["dq"], data["tau"]])
    log, robot = tmp_path / "log.csv", tmp_path / "bench" / "robot.toml"
    np.savetxt(log, table, "%.7g", ",", header=head, comments="")
    api.new(robot.parent, bench="sliding", joints=["x", "y"])
    found = api.inspect(log, robot=robot, write=robot)
    assert (found.findings, found.fixed) == ([], [])
    units = found.proposal.description.log.units
    assert (units.q, units.dq) == ("mm", "mm/s")
