"""A drive with input derivatives: inner steps use the inputs of their own time."""

import ctypes
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from binary import Binary
from drive_runs import drive

OK, DISCARD = 0, 2
STIFFNESS = 1e4  # [N.m/rad]
LONG = 0.01  # [s]
MOVES = ("q[1]", "dq[1]", "ddq[1]", "tau_f[1]", "tau_link[1]")


@pytest.fixture
def binary(make_law, load: Callable[[Path], Binary], tmp_path: Path) -> Binary:
    """A law switched off by its scale, and one with a state and a load."""
    laws = {"free": make_law("gaussians"), "bristle": make_law("lugre"), "v": make_law("viscous")}
    return load(drive(laws, tmp_path, [1.0] * 3, stiffness=[STIFFNESS] * 3, damping=[5.0] * 3))


def ready(binary: Binary, **start: float) -> ctypes.c_void_p:
    c = binary.instantiate()
    assert binary("EnterInitializationMode", c) == OK
    values = {"coulomb_scale[1]": 0.0, "damping[1]": 0.0}
    values |= {"substep" if name == "substep" else f"{name}[1]": v for name, v in start.items()}
    assert binary.set_all(c, values) == OK
    assert binary("ExitInitializationMode", c) == OK
    return c


def follow(binary: Binary, c: ctypes.c_void_p, slopes: Mapping[str, float]) -> None:
    n = len(slopes)
    values = (ctypes.c_double * n)(*slopes.values())
    ones = (ctypes.c_int * n)(*[1] * n)
    names = binary.references(list(slopes))
    assert binary("SetRealInputDerivatives", c, names, n, ones, values) == OK


def drawn(binary: Binary, *, steps: int = 1, **start: float) -> float:
    """Torque on a link after 10 ms at 1 rad/s."""
    c = ready(binary, **start)
    for k in range(steps):
        follow(binary, c, {"q_link[1]": 1.0})
        assert binary.step(c, k * LONG / steps, LONG / steps) == OK
    assert binary.get(c, "q_link[1]") == [pytest.approx(LONG)]
    return binary.get(c, "tau_link[1]")[0]


@pytest.mark.parametrize("substep", [1.0, 1e-3, 1e-5])
def test_the_torque_on_the_link_is_that_at_the_end_of_the_step(
    binary: Binary, substep: float
) -> None:
    """A motor that hardly moves."""
    held = drawn(binary, inertia=1e6, substep=substep)
    assert held == pytest.approx(-STIFFNESS * 1.0 * LONG, rel=1e-4)


def test_the_error_is_proportional_to_the_substep(binary: Binary) -> None:
    """inertia q'' = -stiffness (q - t), so q - t is a sine of 100 rad/s; first order."""
    exact = -STIFFNESS * np.sin(100.0 * LONG) / 100.0
    substeps = LONG / np.array([10, 20, 40, 80, 160, 320])
    errors = np.array([drawn(binary, substep=s) - exact for s in substeps])
    np.testing.assert_allclose(errors[1:] / errors[:-1], 0.5, rtol=0.1)
    assert abs(drawn(binary, substep=1e-7) - exact) < 1e-3


def test_a_long_step_equals_its_inner_steps_with_input_derivatives(binary: Binary) -> None:
    slopes = {f"{name}[{i}]": s * i for name, s in
              (("tau_motor", 900.0), ("q_link", 0.3), ("dq_link", -20.0), ("tau_load", 400.0))
              for i in (1, 2, 3)}  # fmt: skip
    one, many = ready(binary, substep=1e-3), ready(binary, substep=1.0)
    names = [n.replace("[1]", f"[{i}]") for n in MOVES for i in (1, 2, 3)] + ["z[2]", "der(z[2])"]
    for k in range(20):
        follow(binary, one, slopes)
        assert binary.step(one, k * LONG, LONG) == OK
        for n in range(10):
            follow(binary, many, slopes)
            assert binary.step(many, k * LONG + n * 1e-3, 1e-3) == OK
        found, expected = binary.get(one, *names), binary.get(many, *names)
        assert found == pytest.approx(expected, rel=1e-7, abs=1e-9)
    assert min(map(abs, binary.get(one, "q[1]", "q[2]", "q[3]"))) > 0.01
    assert binary.get(one, *slopes) == pytest.approx([s * 0.2 for s in slopes.values()])


def test_an_implicit_step_uses_the_inputs_at_its_end(binary: Binary) -> None:
    """The scheme is implicit; input derivatives apply to one step only."""
    start = {"substep": 1.0, "tau_motor": 3.0}
    sloped, held = ready(binary, **start), ready(binary, **start)
    follow(binary, sloped, {"tau_motor[1]": 500.0, "q_link[1]": 1.0, "dq_link[1]": 2.0})
    assert binary.set(held, tau_motor=8.0, q_link=0.01, dq_link=0.02) == OK
    for time in (0.0, LONG):
        assert binary.step(sloped, time, LONG) == binary.step(held, time, LONG) == OK
        assert binary.get(sloped, *MOVES) == binary.get(held, *MOVES)


def test_zero_input_derivatives_have_no_effect(binary: Binary) -> None:
    sloped, held = ready(binary, tau_motor=3.0), ready(binary, tau_motor=3.0)
    follow(binary, sloped, {"tau_motor[1]": 0.0})
    assert binary.step(sloped, 0.0, LONG) == binary.step(held, 0.0, LONG) == OK
    assert binary.get(sloped, *MOVES) == binary.get(held, *MOVES)


def test_a_refused_step_keeps_its_input_derivatives(binary: Binary) -> None:
    """The torque overflows midway; a shorter step with the same input derivatives succeeds."""
    c = ready(binary, substep=1e-3)
    follow(binary, c, {"tau_motor[1]": 1.7e308, "tau_motor[2]": 300.0})
    before = binary.get(c, *MOVES, "q[2]", "tau_motor[1]")
    assert binary.step(c, 0.0, 2.0) == DISCARD
    assert "the torques are not finite" in binary.messages[-1].text
    assert binary.get(c, *MOVES, "q[2]", "tau_motor[1]") == before
    follow(binary, c, {"tau_motor[1]": 1000.0})
    assert binary.step(c, 0.0, LONG) == OK
    assert binary.get(c, "tau_motor[1]", "tau_motor[2]") == [10.0, 3.0]
