"""Directional derivatives of plants agree with differences of the same plant."""

import ctypes
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from fmpy import extract, read_model_description
from fmpy.fmi3 import FMU3Model
from plant_robots import chain, coupled, sprung
from plant_runs import content_of, stribeck

from fmu_src.export.package import write_fmu
from hesr_model.robots.robot import Robot

OK = 0
MODEL_EXCHANGE, CO_SIMULATION = 0, 1
GIVEN = 2  # start values of the friction's states
STEP = 1e-3  # [s]
WIDTHS = (2e-5, 5e-7)  # of differences: smooth unknowns, and those that bend within micrometres

Array = np.ndarray


def names_of(fmu) -> tuple[list[str], list[str], dict[str, str]]:
    """Knowns of initialisation, unknowns, and the start value of each state."""
    variables = fmu.about.modelVariables
    knowns = [v.name for v in variables if v.start is not None and v.type == "Real"]
    states = [u.variable.derivative.name for u in fmu.about.derivatives]
    begun = {name: name.replace("[", "_start[") for name in states}
    return knowns, [v.name for v in variables if v.start is None], begun


def place_of(fmu, knowns: Sequence[str], begun: Mapping[str, str], n: int) -> dict[str, float]:
    """A fast posture with payload, in which the first joint is in a stop and friction creeps."""
    rng = np.random.default_rng(n)
    about = {v.name: v for v in fmu.about.modelVariables}
    values = {name: float(about[name].start) for name in knowns}
    for state, start in begun.items():
        values[start] += rng.uniform(0.1, 0.3) * float(about[state].nominal or 1.0)
    for i in range(1, n + 1):
        values |= {f"q_start[{i}]": rng.uniform(0.2, 1.0), f"tau[{i}]": rng.uniform(-9.0, 9.0)}
        values[f"dq_start[{i}]"] = rng.uniform(0.1, 0.4) * rng.choice([-1.0, 1.0])
    values |= {"dq_start[1]": 5e-4, "q_max[1]": values["q_start[1]"] - 4e-4, "payload.m": 1.5}
    values |= {f"payload.com[{k}]": 0.04 * k for k in (1, 2, 3)} | {"payload.Iyy": 0.02}
    return values


def initialising(fmu, values: Mapping[str, float], kind: int, *, given: bool = True):
    c = fmu.instantiate(kind=kind)
    mode = (ctypes.c_int * 1)(GIVEN if given else 1)
    assert fmu("SetInteger", c, fmu.references(["start_mode"]), 1, mode) == OK
    assert fmu("SetupExperiment", c, 0, 0.0, 0.0, 0, 0.0) == OK
    assert fmu("EnterInitializationMode", c) == OK
    assert fmu.set_all(c, values) == OK
    return c


def tangent(fmu, c, unknowns: Sequence[str], seed: Mapping[str, float]) -> Array:
    result = (ctypes.c_double * len(unknowns))()
    along = (ctypes.c_double * len(seed))(*seed.values())
    references = fmu.references(unknowns), fmu.references(list(seed))
    status = fmu(
        "GetDirectionalDerivative",
        c,
        references[0],
        len(unknowns),
        references[1],
        len(seed),
        along,
        result,
    )
    assert status == OK, fmu.messages[-1]
    return np.array(result)


def difference(f: Callable[[float], Array], x: float, h: float) -> tuple[Array, Array]:
    """Fourth-order central difference, and its round-off for each unknown."""
    far, near = (f(x + k * h) - f(x - k * h) for k in (2, 1))
    return (8.0 * near - far) / (12.0 * h), 1e-12 * np.abs(f(x)) / h


def check(fmu, unknowns: Sequence[str], values: Mapping[str, float], c, moved) -> None:
    """Derivatives of settled stops are 0, as differences of terms of up to 1000/s."""
    sizes = np.array([1000.0 if name.startswith("der(x") else 1.0 for name in unknowns])
    for known in values:

        def at(x: float, known=known) -> Array:
            assert fmu.set_all(moved, {**values, known: x}) == OK
            return np.array(fmu.get(moved, *unknowns))

        found, wrong = tangent(fmu, c, unknowns, {known: 1.0}), np.ones(len(unknowns), dtype=bool)
        for width in WIDTHS:
            h = width * max(abs(values[known]), 0.1)
            expected, uncertain = difference(at, values[known], h)
            uncertain = np.maximum(uncertain, 1e-12 * sizes / h)
            wrong &= np.abs(found - expected) > uncertain + 1e-6 * np.abs(expected)
        assert [name for name, bad in zip(unknowns, wrong, strict=True) if bad] == [], known


@pytest.fixture
def arms(make_law, request, load, tmp_path: Path):
    laws = {"lugre": lambda: make_law("lugre"), "stribeck": stribeck,
            "parfam": lambda: make_law("parfam_tanh"),
            "stops": lambda: request.getfixturevalue("fitted")["parfam_s"]}  # fmt: skip

    def made(source: Callable[[Path], Path], law: str):
        robot = Robot(source(tmp_path))
        whole = content_of(robot, [laws[law]()] * robot.n, tool=True)
        return robot, load(write_fmu(whole, tmp_path / "Plant.fmu"))

    return made


ROBOTS = {
    "one": lambda folder: chain(folder, 1),
    "three": lambda folder: chain(folder, 3),
    "six": lambda folder: chain(folder, 6),
    "sprung": sprung,
    "coupled": coupled,
}


@pytest.mark.parametrize(
    ("robot", "law"),
    [
        ("one", "lugre"),
        ("three", "stribeck"),
        ("three", "parfam"),
        *(
            pytest.param(*pair, marks=pytest.mark.ci)
            for pair in (
                ("six", "lugre"),
                ("six", "stribeck"),
                ("six", "parfam"),
                ("six", "stops"),
                ("sprung", "lugre"),
                ("coupled", "lugre"),
            )
        ),
    ],
)
def test_directional_derivatives_match_differences(robot: str, law: str, arms) -> None:
    """Along inputs, parameters and start values, of both kinds and with both starts."""
    arm, fmu = arms(ROBOTS[robot], law)
    knowns, unknowns, begun = names_of(fmu)
    values = place_of(fmu, knowns, begun, arm.n)
    for kind in (MODEL_EXCHANGE, CO_SIMULATION):
        for given in (True, False):
            c, moved = (initialising(fmu, values, kind, given=given) for _ in range(2))
            check(fmu, unknowns, values, c, moved)
    later = initialising(fmu, values, MODEL_EXCHANGE)
    given = initialising(fmu, values, MODEL_EXCHANGE)
    assert fmu("ExitInitializationMode", later) == OK
    assert fmu("EnterContinuousTimeMode", later) == OK
    unknowns = [name for name in unknowns if name not in begun]
    for state, start in begun.items():
        first = tangent(fmu, given, unknowns, {start: 1.0})
        np.testing.assert_array_equal(tangent(fmu, later, unknowns, {state: 1.0}), first)


def test_after_a_step_derivatives_are_those_of_the_continuous_form(arms) -> None:
    arm, fmu = arms(ROBOTS["three"], "lugre")
    knowns, unknowns, begun = names_of(fmu)
    values = place_of(fmu, knowns, begun, arm.n)
    c = initialising(fmu, values, CO_SIMULATION)
    assert fmu("ExitInitializationMode", c) == OK
    assert fmu.step(c, 0.0, STEP) == OK
    unknowns = [name for name in unknowns if name not in begun]
    at = dict(zip(begun.values(), fmu.get(c, *begun), strict=True))
    same = initialising(fmu, values | at, MODEL_EXCHANGE)
    assert fmu("ExitInitializationMode", same) == OK
    for known in (*begun, "tau[2]", "payload.m", "joint[1].sigma_0"):
        found, expected = (tangent(fmu, one, unknowns, {known: 1.0}) for one in (c, same))
        np.testing.assert_array_equal(found, expected)


def test_fmi_3_gives_the_same_derivatives(make_law, load, tmp_path: Path) -> None:
    robot = Robot(chain(tmp_path, 3))
    whole = content_of(robot, [make_law("lugre")] * 3)
    two = load(write_fmu(whole, tmp_path / "Two.fmu"))
    path = write_fmu(whole, tmp_path / "Three.fmu", fmi=3)
    about = read_model_description(str(path))
    vr = {v.name: v.valueReference for v in about.modelVariables}
    arm = FMU3Model(
        guid=about.guid,
        unzipDirectory=extract(str(path), str(tmp_path / "three")),
        modelIdentifier=about.modelExchange.modelIdentifier,
        instanceName="arm",
    )
    arm.instantiate()
    arm.enterInitializationMode()
    arm.setFloat64([vr["dq_start"], vr["tau"]], [0.3, -0.2, 0.1, 5.0, -6.0, 7.0])
    arm.exitInitializationMode()
    start = {f"dq_start[{i}]": x for i, x in zip((1, 2, 3), (0.3, -0.2, 0.1), strict=True)}
    start |= {f"tau[{i}]": x for i, x in zip((1, 2, 3), (5.0, -6.0, 7.0), strict=True)}
    c = initialising(two, start, MODEL_EXCHANGE, given=False)
    assert two("ExitInitializationMode", c) == OK
    for k, name in enumerate(("tau", "q", "dq")):
        seed = [1.0 + k, -2.0, 0.5]
        found = arm.getDirectionalDerivative(
            unknowns=[vr["ddq"], vr["tau_friction"]],
            knowns=[vr[name]],
            seed=seed,
            nSensitivity=6,
        )
        unknowns = [f"{n}[{i}]" for n in ("ddq", "tau_friction") for i in (1, 2, 3)]
        along = {f"{name}[{i}]": x for i, x in zip((1, 2, 3), seed, strict=True)}
        np.testing.assert_array_equal(found, tangent(two, c, unknowns, along))
    arm.terminate()
    arm.freeInstance()
