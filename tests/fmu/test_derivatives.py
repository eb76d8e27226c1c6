"""Derivatives of an FMU agree with finite differences of the same FMU."""

import ctypes

import numpy as np
import pytest
from containing import Containing

from fmu_src.friction.friction_fmu import export_bare

OK, ERROR = 0, 3
STEP = 2e-5  # short enough for Euler with every law


@pytest.fixture(scope="module")
def fmu(every_law, make_model, load, tmp_path_factory):
    """One FMU with a joint for each law."""
    folder = tmp_path_factory.mktemp("derivatives")
    return load(export_bare(make_model(*every_law.values()), folder / "F.fmu"))


@pytest.fixture(scope="module")
def joints(every_law):
    return {name: i for i, name in enumerate(every_law, start=1)}


@pytest.fixture
def joint(any_law, joints):
    return joints[any_law]


def names(fmu, joint):
    """Inputs, start states and parameters of a joint; its derivatives and torque."""
    own = [
        v
        for v in fmu.about.modelVariables
        if v.name.removesuffix(")").endswith(f"[{joint}]") or f"joint[{joint}]." in v.name
    ]
    knowns = [v.name for v in own if v.start is not None]
    unknowns = [v.name for v in own if v.start is None and not v.name.startswith("dtau")]
    states = states_of(fmu)
    return knowns, [name for name in unknowns if name not in states]


def states_of(fmu):
    """Names of states, each with the name of its start value."""
    states = [u.variable.derivative.name for u in fmu.about.derivatives]
    return {name: name.replace("[", "_start[") for name in states}


def place(fmu, joint):
    """Point of evaluation of a joint: motion so slow that the start matters, away from kinks.

    A scale whose start is its limit lies within it.
    """
    rng = np.random.default_rng(joint)
    knowns, _ = names(fmu, joint)
    start = {v.name: float(v.start) for v in fmu.about.modelVariables if v.name in knowns}
    for v in fmu.about.modelVariables:
        if v.name in knowns and v.min is not None and float(v.min) == start[v.name] > 0.0:
            start[v.name] *= 1.01
    for state in (u.variable.derivative for u in fmu.about.derivatives):
        if (name := states_of(fmu)[state.name]) in knowns:
            start[name] += rng.uniform(0.1, 0.3) * float(state.nominal or 1.0)
    start |= {f"dq[{joint}]": rng.uniform(0.005, 0.015) * rng.choice([-1.0, 1.0])}
    return start | {f"q[{joint}]": rng.uniform(0.2, 1.0), f"tau_load[{joint}]": 7.0}


def initialising(fmu, values, kind=0, *, given=True):
    c = fmu.instantiate(kind=kind)
    mode = (ctypes.c_int * 1)(2 if given else 1)
    assert fmu("SetInteger", c, fmu.references(["start_mode"]), 1, mode) == OK
    assert fmu("SetupExperiment", c, 0, 0.0, 0.0, 0, 0.0) == OK
    assert fmu("EnterInitializationMode", c) == OK
    assert fmu.set_all(c, values) == OK
    return c


def tangent(fmu, c, unknowns, seed):
    """Derivative of `unknowns` along a direction, {name: component}."""
    result = (ctypes.c_double * len(unknowns))()
    direction = (ctypes.c_double * len(seed))(*seed.values())
    status = fmu(
        "GetDirectionalDerivative",
        c,
        fmu.references(unknowns),
        len(unknowns),
        fmu.references(list(seed)),
        len(seed),
        direction,
        result,
    )
    assert status == OK, fmu.messages[-1]
    return np.array(result)


def difference(f, x):
    """Fourth-order central difference of a function, and its uncertainty."""
    h = min(1e-5 * max(abs(x), 0.1), 1e-3 * abs(x) or 1e-6)
    far, near = (f(x + k * h) - f(x - k * h) for k in (2, 1))
    return (8.0 * near - far) / (12.0 * h), 1e-14 * np.abs(f(x)) / h


def worst(found, expected, uncertain):
    """Largest relative error beyond the round-off of a difference."""
    error = np.maximum(np.abs(found - expected) - uncertain, 0.0)
    return float((error / np.maximum(np.abs(expected), 1e-300)).max())


def test_directional_derivatives_match_differences(fmu, joint):
    knowns, unknowns = names(fmu, joint)
    values = place(fmu, joint)
    c, moved = (initialising(fmu, values) for _ in range(2))
    event, slave = (initialising(fmu, values, kind) for kind in (0, 1))
    assert fmu("ExitInitializationMode", event) == fmu("ExitInitializationMode", slave) == OK
    begun = {start: state for state, start in states_of(fmu).items()}
    continuous = initialising(fmu, values)
    assert fmu("ExitInitializationMode", continuous) == OK
    assert fmu("EnterContinuousTimeMode", continuous) == OK
    for known in knowns:

        def at(x, known=known):
            assert fmu.set_all(moved, values | {known: x}) == OK
            return np.array(fmu.get(moved, *unknowns))

        found = tangent(fmu, c, unknowns, {known: 1.0})
        assert worst(found, *difference(at, values[known])) <= 1e-6, known
        later = {begun.get(known, known): 1.0}
        for other in (event, continuous, slave):
            assert list(tangent(fmu, other, unknowns, later)) == list(found)


def test_directional_derivatives_match_before_the_steady_start(fmu, joint):
    """States and everything derived from them depend on their start values."""
    knowns, unknowns = names(fmu, joint)
    unknowns += [name for name, start in states_of(fmu).items() if start in knowns]
    values = place(fmu, joint)
    c, moved = (initialising(fmu, values, given=False) for _ in range(2))
    for known in knowns:

        def at(x, known=known):
            assert fmu.set_all(moved, values | {known: x}) == OK
            return np.array(fmu.get(moved, *unknowns))

        found = tangent(fmu, c, unknowns, {known: 1.0})
        assert worst(found, *difference(at, values[known])) <= 2e-6, known


def test_directional_derivatives_match_at_the_end_of_a_step(fmu, joint):
    """The states are fixed there, at their values after the step."""
    knowns, unknowns = names(fmu, joint)
    values = place(fmu, joint)
    slave = initialising(fmu, values, kind=1)
    assert fmu("ExitInitializationMode", slave) == OK
    for k in range(5):
        assert fmu.step(slave, k * STEP, STEP) == OK
    begun = {start: state for state, start in states_of(fmu).items()}
    places = [begun.get(name, name) for name in knowns]
    reached = dict(zip(knowns, fmu.get(slave, *places), strict=True))
    c = initialising(fmu, reached)
    # To one ulp: a step computes its end in another order than an evaluation does.
    assert fmu.get(slave, *unknowns) == pytest.approx(fmu.get(c, *unknowns), rel=1e-14, abs=0.0)
    for known, place_of_it in zip(knowns, places, strict=True):
        moved = tangent(fmu, slave, unknowns, {place_of_it: 1.0})
        assert list(moved) == list(tangent(fmu, c, unknowns, {known: 1.0}))


def test_derivatives_are_linear_in_their_direction(fmu, joints):
    rng = np.random.default_rng(2)
    parts = [names(fmu, joint) for joint in joints.values()]
    knowns = [name for part, _ in parts for name in part]
    unknowns = [name for _, part in parts for name in part]
    values = {k: v for joint in joints.values() for k, v in place(fmu, joint).items()}
    c = initialising(fmu, values)
    one, two = (dict(zip(knowns, rng.normal(size=len(knowns)), strict=True)) for _ in range(2))
    both = {name: 2.0 * one[name] - 3.0 * two[name] for name in knowns}
    first, second = (tangent(fmu, c, unknowns, seed) for seed in (one, two))
    scale = np.abs(first) + np.abs(second)
    together = tangent(fmu, c, unknowns, both)
    assert (np.abs(together - (2.0 * first - 3.0 * second)) <= 1e-9 * scale).all()
    # A joint does not depend on another one.
    elsewhere = {k: v for k, v in one.items() if k not in parts[0][0]}
    assert not tangent(fmu, c, parts[0][1], elsewhere).any()
    # A variable listed twice contributes with both components.
    twice = fmu.references(["dq[1]", "dq[1]"])
    result = (ctypes.c_double * 1)()
    unknown = fmu.references(["tau[1]"])
    direction = (ctypes.c_double * 2)(0.25, 0.75)
    assert fmu("GetDirectionalDerivative", c, unknown, 1, twice, 2, direction, result) == OK
    assert result[0] == tangent(fmu, c, ["tau[1]"], {"dq[1]": 1.0})[0]


def test_a_signal_at_rest_has_a_slope_without_sign(fmu, joints):
    joint = joints["viscous"]
    c = fmu.ready()
    assert tangent(fmu, c, [f"tau[{joint}]"], {f"dq[{joint}]": 1.0}) == [0.0]
    assert tangent(fmu, c, [f"tau[{joint}]"], {f"joint[{joint}].F_c": 1.0}) == [0.0]


@pytest.mark.parametrize(
    ("unknown", "known", "reason"),
    [
        (
            "dtau_ddq[2]",
            "dq[2]",
            ("dtau_ddq[2] is neither a continuous"),
        ),
        ("dq[2]", "dq[2]", "dq[2] is neither a continuous"),
        ("h[1]", "dq[1]", "h[1] is neither a continuous"),
        ("tau[2]", "tau[1]", "derivatives with respect to tau[1] are not available."),
        ("tau[2]", "der(h[1])", "derivatives with respect to der(h[1]) are not available."),
        ("tau[2]", "discretisation", "type with value reference {}"),
    ],
)
def test_undifferentiable_variables_are_refused(fmu, unknown, known, reason):
    c = fmu.ready()
    result = (ctypes.c_double * 1)(7.0)
    arguments = (fmu.references([unknown]), 1, fmu.references([known]), 1, result, result)
    fmu.messages.clear()
    assert fmu("GetDirectionalDerivative", c, *arguments) == ERROR
    assert [m.text for m in fmu.messages] == [
        Containing("fmi2GetDirectionalDerivative: ", reason.format(fmu.vr[known]))
    ]
    assert result[0] == 7.0


def stepping(fmu, joint, discretisation):
    c = fmu.instantiate()
    choice = (ctypes.c_int * 1)(discretisation)
    assert fmu("SetInteger", c, fmu.references(["discretisation"]), 1, choice) == OK
    assert fmu.set_all(c, place(fmu, joint)) == OK
    assert fmu("SetupExperiment", c, 0, 0.0, 0.0, 0, 0.0) == OK
    assert fmu("EnterInitializationMode", c) == OK
    assert fmu("ExitInitializationMode", c) == OK
    return c


@pytest.mark.parametrize("discretisation", [1, 2], ids=["exact", "euler"])
def test_the_slope_is_that_of_the_whole_step(fmu, joint, discretisation):
    """dtau_ddq is the change of tau with the velocity held over the step."""
    dq, tau, slope = (f"{kind}[{joint}]" for kind in ("dq", "tau", "dtau_ddq"))
    c = stepping(fmu, joint, discretisation)
    state = ctypes.c_void_p()
    for k, speed in enumerate((0.09, 0.05, -0.03, -0.08, 0.2)):
        assert fmu("GetFMUstate", c, ctypes.byref(state)) == OK

        def after(x, k=k):
            assert fmu("SetFMUstate", c, state) == OK
            assert fmu.set_all(c, {dq: x}) == OK
            assert fmu.step(c, k * STEP, STEP) == OK
            return np.array(fmu.get(c, tau))

        expected, uncertain = difference(after, speed)
        after(speed)
        assert worst(np.array(fmu.get(c, slope)), expected, uncertain) <= 1e-6
    fmu("FreeFMUstate", c, ctypes.byref(state))


def test_the_slope_includes_input_derivatives(fmu, joints):
    """Also if the velocity changes sign within the step."""
    joint = joints["lugre"]
    dq, tau, slope = (f"{kind}[{joint}]" for kind in ("dq", "tau", "dtau_ddq"))
    c, state = stepping(fmu, joint, 1), ctypes.c_void_p()
    assert fmu("GetFMUstate", c, ctypes.byref(state)) == OK
    one = (ctypes.c_int * 1)(1)
    for ramp in (-0.5, 0.5, -3.0, -7.0):

        def after(x, ramp=ramp):
            assert fmu("SetFMUstate", c, state) == OK
            assert fmu.set_all(c, {dq: x}) == OK
            rate = (ctypes.c_double * 1)(ramp / STEP)
            assert fmu("SetRealInputDerivatives", c, fmu.references([dq]), 1, one, rate) == OK
            assert fmu.step(c, 0.0, STEP) == OK
            return np.array(fmu.get(c, tau))

        expected, uncertain = difference(after, 2.0)
        after(2.0)
        assert worst(np.array(fmu.get(c, slope)), expected, uncertain) <= 1e-6
    fmu("FreeFMUstate", c, ctypes.byref(state))


def test_the_slope_before_the_first_step_holds_the_states(fmu, joints):
    for joint in joints.values():
        c = stepping(fmu, joint, 1)
        slope = tangent(fmu, c, [f"tau[{joint}]"], {f"dq[{joint}]": 1.0})
        assert fmu.get(c, f"dtau_ddq[{joint}]") == pytest.approx(slope, rel=1e-12, abs=0.0)
