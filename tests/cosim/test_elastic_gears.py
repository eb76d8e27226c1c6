"""Elastic gears, identified from two encoders; the truth is the twin's strain-wave plant."""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

import hesr
from cosim.report.sections import inputs
from cosim.report.tables.laws import rigid_body
from fmu_src.arm.plant import Plant
from fmu_src.arm.python_arm.simulation import Simulation
from fmu_src.arm.signals import read_signals
from fmu_src.arm.table import SignalTable
from fmu_src.arm.truth import Truth, write_truth
from hesr_model.errors import ArgumentError, ConfigError, FitError, LogError, RobotError
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.elasticity import ElasticGear
from hesr_model.rigid_body.identification import RigidBody, identify
from hesr_model.rigid_body.refinement import identify_again
from hesr_model.robots.robot import Robot
from hesr_model.support.files import models_folder

UF850 = models_folder() / "uf850"
PLANT, TABLE = Plant.read(UF850 / "plant.toml"), SignalTable.read(UF850 / "arm.toml")
TRUTH = PLANT.truths["strain_wave"]
ENCODER, TORQUE = 2e-5, np.array([1.5, 1.5, 0.6])  # noise [rad, N.m]
SECONDS, STEP, EVERY = 40.0, 0.001, 5  # commands at 1 kHz, as a controller interpolates them
SINES = [
    [(0.5, 0.13), (0.4, 0.41), (0.4, 1.13), (0.4, 2.3)],
    [(0.35, 0.11), (0.3, 0.37), (0.2, 1.01), (0.15, 2.1)],
    [(0.45, 0.17), (0.4, 0.47), (0.25, 1.29), (0.2, 2.7)],
]
"""Speed [rad/s] and frequency [Hz] of each joint's motion."""


def moved(truth: Truth, folder: Path) -> Log:
    """A log of the twin without noise, 5 kg in its hand, whose motors carry the weight.

    The twin compensates gravity behind its gears; here the servos hold it through them.
    """
    path = folder / "arm.xml"
    table = write_truth(truth, PLANT.model, PLANT.joints, TABLE, path)
    text = re.sub(r'(actuator)?gravcomp="[^"]*"', "", path.read_text())
    path.write_text(text.replace('timestep="0.001"', 'timestep="0.0005"'))
    t = STEP * np.arange(round(SECONDS / STEP))
    speeds = [sum(a * np.sin(2 * np.pi * f * t) for a, f in own) for own in SINES]
    commands = np.column_stack(speeds) * np.minimum(1.0, t / 2.0)[:, None]
    arm = Simulation(read_signals(path, table))
    quiet = {f"{name}_noise[{i}]": 0.0 for name in ("q", "tau_meas") for i in (1, 2, 3)}
    start = {"q0[1]": 0.0, "q0[2]": 0.3, "q0[3]": -1.9, "payload": 5.0}
    rows = [arm.reset(quiet | start), *(arm.step(row, STEP) for row in commands[:-1])]
    q, tau, link, *_ = np.moveaxis(np.array(rows)[::EVERY].reshape(len(t) // EVERY, -1, 3), 1, 0)
    return Log(name="arm", t=t[::EVERY], q=q, dq=None, tau=tau, q_link=link)


def noisy(log: Log, seed: int) -> Log:
    rng = np.random.default_rng(seed)
    shape, link = log.q.shape, log.q_link
    assert link is not None
    return replace(
        log,
        q=log.q + ENCODER * rng.standard_normal(shape),
        q_link=link + ENCODER * rng.standard_normal(shape),
        tau=log.tau + TORQUE * rng.standard_normal(shape),
    )


@pytest.fixture(scope="module")
def exact(tmp_path_factory: pytest.TempPathFactory) -> Log:
    return moved(TRUTH, tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def body_of(exact: Log) -> Callable[[int], RigidBody]:
    """Return the body of the log with the noise of a seed, identified once."""
    model = Robot(UF850 / "robot.toml")
    return cache(lambda seed: identify([noisy(exact, seed)], model))


@pytest.fixture(scope="module")
def files(exact: Log, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A noisy log as CSV, and the robot file that names its link encoders."""
    folder = tmp_path_factory.mktemp("files")
    noisy(exact, 1).write(folder / "arm.csv")
    text = (UF850 / "robot.toml").read_text().replace("uf850.xml", str(UF850 / "uf850.xml"))
    columns = '[log.columns]\ndq = ""\nq_link = "q_link{}"\n'
    (folder / "robot.toml").write_text(text + columns)
    return folder / "arm.csv", folder / "robot.toml"


def expected(joint: int) -> dict[str, float]:
    gear = TRUTH.transmission
    assert gear is not None
    return {
        "stiffness": gear.stiffness[joint],
        "motor_coulomb": TRUTH.losses.constant[joint],
        "motor_load": TRUTH.losses.load[joint],
        "motor_viscous": TRUTH.viscous[joint],
        "link_coulomb": 0.0,
        "link_viscous": 0.0,
    }


def scores(gears: Sequence[ElasticGear]) -> np.ndarray:
    """Errors over standard errors, (joints, parameters)."""
    return np.array(
        [
            [(gear.parameters[n][0] - true) / gear.parameters[n][1] for n, true in own.items()]
            for gear, own in ((g, expected(j)) for j, g in enumerate(gears))
        ]
    )


# --- identification ------------------------------------------------------------------------------


def test_stiffness_and_friction_are_those_of_the_plant(
    files: tuple[Path, Path], tmp_path: Path
) -> None:
    log, robot = files
    body = hesr.identify(log, robot=robot, output=tmp_path / "body.json")
    for j, gear in enumerate(body.gears):
        found = {name: value for name, (value, _) in gear.parameters.items()}
        true = expected(j)
        assert found["stiffness"] == pytest.approx(true["stiffness"], rel=0.05)
        for speed in (0.2, 0.5, 1.0):
            for load in (0.0, 20.0):
                friction = [
                    one["motor_coulomb"] + one["motor_load"] * load + one["motor_viscous"] * speed
                    for one in (found, true)
                ]
                assert friction[0] == pytest.approx(friction[1], rel=0.05)
                link = found["link_coulomb"] + found["link_viscous"] * speed
                assert abs(link) < 0.1 * friction[1]
    rotors = [body.parameters[body.names.index(f"{gear.joint}.Ir")] for gear in body.gears]
    np.testing.assert_allclose(rotors, [0.8, 0.8, 0.35], rtol=0.1)
    assert RigidBody.read(tmp_path / "body.json").gears == body.gears
    listed = {str(row.head) for row in inputs.parameters(body).rows}
    assert {"joint1.Ir", "joint1.stiffness", "joint3.motor_load"} <= listed
    text = rigid_body(body)
    assert re.search(r"Gear of joint2 \[SI\]: stiffness (29|30)\d+ \+- \d+, damping", text)


def test_intervals_cover_the_truth(body_of: Callable[[int], RigidBody]) -> None:
    found = np.array([scores(body_of(seed).gears) for seed in range(4)])
    assert np.mean(np.abs(found) < 1.96) >= 0.9
    assert np.sqrt(np.mean(found**2)) > 0.4  # the intervals are not just wide


def test_hysteresis_and_play_are_those_of_the_plant(body_of: Callable[[int], RigidBody]) -> None:
    gear = body_of(1).gears[1]
    widths, torques = np.transpose(gear.elements)
    stops = widths > 0.0
    assert np.sum(torques[stops]) == pytest.approx(6.0, rel=0.1)
    assert (widths * torques)[stops].sum() == pytest.approx(2e-4 * 2.0 + 8e-4 * 4.0, rel=0.1)
    assert np.sum(torques[~stops]) == pytest.approx(-1.5, rel=0.1)  # stiffness times half the play


def test_a_refined_body_keeps_its_gears(exact: Log, body_of: Callable[[int], RigidBody]) -> None:
    log, model, body = noisy(exact, 1), Robot(UF850 / "robot.toml"), body_of(1)
    law = hesr.fit(log, robot=model, rigid_body=body, law="stribeck")
    refined = identify_again([log], model, body, law)
    assert refined.gears == body.gears
    assert not np.array_equal(refined.parameters, body.parameters)


def test_rigid_gears_have_no_entry(exact: Log, tmp_path: Path) -> None:
    body = identify([replace(noisy(exact, 1), q_link=None)], Robot(UF850 / "robot.toml"))
    assert body.gears == ()
    body.write(tmp_path / "body.json")
    assert "gears" not in (tmp_path / "body.json").read_text()


def test_a_gear_that_hardly_twists_is_reported(exact: Log) -> None:
    slow = noisy(exact.rows(slice(0, 500)), 1)
    body = identify([slow], Robot(UF850 / "robot.toml"))
    assert "Gear of joint1: these logs" in rigid_body(body)


# --- a single axis -------------------------------------------------------------------------------


def axis(known: bool, folder: Path) -> tuple[Log, Robot]:
    """A motor with an elastic gear: 8000 N.m/rad, 6 N.m.s/rad, inertias 0.05 and 0.4 kg.m2."""
    h, end = 1e-4, 20.0
    t = h * np.arange(round(end / h))
    waves = ((0.8, 0.3, 0.0), (0.6, 0.9, 1.0), (0.5, 2.1, 2.0), (0.4, 4.3, 0.5))
    speeds = sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in waves) * np.minimum(1.0, t)
    q = link = v = u = integral = 0.0
    rows = []
    for k, speed in enumerate(speeds.tolist()):
        integral += h * (speed - v)
        tau = 20.0 * (speed - v) + 300.0 * integral
        gear = 8000.0 * (q - link) + 6.0 * (v - u)
        if k % 20 == 0:
            rows.append((q, link, tau))
        free, stuck = v + h * (tau - gear - 3.0 * v) / 0.05, h * (2.0 + 0.06 * abs(gear)) / 0.05
        v = math.copysign(max(abs(free) - stuck, 0.0), free)
        free, stuck = u + h * (gear - 1.2 * u) / 0.4, h * 0.8 / 0.4
        u = math.copysign(max(abs(free) - stuck, 0.0), free)
        q, link = q + h * v, link + h * u
    noise = np.random.default_rng(1).standard_normal((len(rows), 3)) * [2e-5, 2e-5, 0.1]
    found = (np.array(rows) + noise).T[:, :, None]
    hesr.new(folder / "axis", bench="rotary", inertia=0.4 if known else None)
    text = (folder / "axis" / "robot.toml").read_text()
    (folder / "axis" / "robot.toml").write_text(text.replace("inertia = false", "inertia = true"))
    log = Log(name="axis", t=t[::20], q=found[0], dq=None, tau=found[2], q_link=found[1])
    return log, Robot(folder / "axis" / "robot.toml")


def test_a_known_inertia_determines_the_gear_of_a_single_axis(tmp_path: Path) -> None:
    log, robot = axis(True, tmp_path)
    (gear,) = identify([log], robot).gears
    true = {"stiffness": 8000.0, "damping": 6.0, "motor_coulomb": 2.0, "motor_load": 0.06,
            "motor_viscous": 3.0, "link_coulomb": 0.8, "link_viscous": 1.2}  # fmt: skip
    for name, number in true.items():
        value, error = gear.parameters[name]
        assert abs(value - number) < max(2.0 * error, 0.01 * number)
        if name not in ("damping", "motor_load"):
            assert value == pytest.approx(number, rel=0.1 if "coulomb" in name else 0.05)


def test_an_unknown_inertia_leaves_the_gear_of_a_single_axis_open(tmp_path: Path) -> None:
    log, robot = axis(False, tmp_path)
    text = rigid_body(identify([log], robot))
    assert "logs do not determine its stiffness" in text


# --- refusals ------------------------------------------------------------------------------------


def changed(files: tuple[Path, Path], old: str, new: str, folder: Path) -> Path:
    text = files[1].read_text()
    assert old in text
    (folder / "robot.toml").write_text(text.replace(old, new))
    return folder / "robot.toml"


@pytest.mark.parametrize(
    ("old", "new", "kind", "sentence"),
    [
        (
            "[log.columns]",
            '[log.units]\nq_link = "deg"\n[log.columns]',
            LogError,
            "link encoder of joint 'joint1'",
        ),
        ('"q_link{}"', '"q{}"', LogError, "link encoder of joint 'joint1'"),
        ('"q_link{}"', '["q_link1"]', RobotError, "log.columns.q_link.* has 1 entries"),
        ('"q_link{}"', '"x{}"', LogError, "column 'x1' is missing"),
        ("rotor_inertia = true", "rotor_inertia = false", ConfigError, "needs 'rotor_inertia'"),
    ],
)
def test_unsuitable_columns_are_refused(
    files: tuple[Path, Path],
    old: str,
    new: str,
    kind: type[Exception],
    sentence: str,
    tmp_path: Path,
) -> None:
    with pytest.raises(kind, match=sentence):
        Log.read(files[0], changed(files, old, new, tmp_path))


@pytest.mark.parametrize("options", [{"physical": True}, {"method": "paper"}])
def test_methods_for_rigid_gears_are_refused(exact: Log, options: dict[str, Any]) -> None:
    with pytest.raises(FitError, match=r"link encoders .* exclude 'physical' and 'method' paper"):
        identify([noisy(exact, 1)], Robot(UF850 / "robot.toml"), **options)


# --- drives --------------------------------------------------------------------------------------


def test_a_drive_has_the_identified_gears(
    body_of: Callable[[int], RigidBody], tmp_path: Path
) -> None:
    body = body_of(1)
    body.write(tmp_path / "body.json")
    options = {"format": "drive", "rigid_body": tmp_path / "body.json", "platform": ["linux64"]}
    drive = hesr.export("uf850-table1", tmp_path / "D.fmu", **options)
    found = {v.name: v.start for v in fmpy.read_model_description(drive).modelVariables}
    for i, gear in enumerate(body.gears, start=1):
        assert (
            float(found[f"inertia[{i}]"]) == body.parameters[body.names.index(f"{gear.joint}.Ir")]
        )
        for name in ("stiffness", "damping"):
            assert float(found[f"{name}[{i}]"]) == gear.parameters[name][0]


def test_a_drive_with_rigid_gears_needs_an_inertia(exact: Log, tmp_path: Path) -> None:
    body = identify([replace(noisy(exact, 1), q_link=None)], Robot(UF850 / "robot.toml"))
    with pytest.raises(ArgumentError, match="'rigid_body' has no elastic gears"):
        hesr.export("uf850-table1", tmp_path / "D.fmu", format="drive", rigid_body=body)
