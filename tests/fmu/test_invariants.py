"""Terms that depend only on parameters and step are computed once, until one changes."""

import ctypes
from dataclasses import replace

import numpy as np
import pytest
import sympy
from oracles.over_log import lowered_program

from fmu_src.friction.friction_component import component
from fmu_src.friction.friction_fmu import export_bare
from fmu_src.friction.replay import replay
from hesr_model.equations.memory import DT, EULER
from hesr_model.equations.program import Invariants, build_step


def moved(h: float, dq: float, step: float, alpha: float, beta: float) -> float:
    """Equation 10 with Euler steps, as fitted for Table I."""
    return h * (1.0 - alpha * step) + alpha * np.tanh(beta * dq) * step


def test_separating_invariants_does_not_change_a_law(fitted) -> None:
    rng = np.random.default_rng(5)
    invariants = 0
    for name, law in fitted.items():
        own = component(law)
        fixed = {*(q.symbol for q in own.parameters), DT, EULER}
        program = build_step(own)
        wanted = tuple(program)
        parts = Invariants.from_program(program, wanted, fixed)
        invariants += len(parts.reused)
        assert not any(e.is_Atom for e in parts.once.values()), name
        known = {*fixed, *parts.once}
        assert all(e.free_symbols <= known for e in parts.once.values()), name
        free = set().union(*(e.free_symbols for e in program.values())) - program.keys()
        free = sorted(free, key=str)
        values = dict(zip(free, rng.uniform(0.1, 1.0, len(free)), strict=True)) | {EULER: False}
        values |= dict(zip((q.symbol for q in own.parameters), law.values.values(), strict=True))
        found, expected = {**parts.once, **parts.moving}, dict(program)
        results = []
        for lines in (found, expected):
            every = lowered_program(free, lines)(*(values[s] for s in free))
            results.append(dict(zip(lines, every, strict=True)))
        for symbol in wanted:
            a, b = (float(r[symbol]) for r in results)
            # Some of the cancelling rates are 1e4.
            assert a == pytest.approx(b, rel=1e-12, abs=1e-10), (name, symbol)
    assert invariants > 20


def test_changed_coefficients_and_steps_take_effect(table1, binary) -> None:
    c = binary.ready()
    alpha, beta = (table1.laws[0].values[n] for n in ("alpha", "beta"))
    h, time = binary.get(c, "h[1]")[0], 0.0
    for k in range(40):
        step = (0.005, 0.0025, 0.01)[k // 3 % 3]
        if k in (7, 8, 20):
            alpha *= 1.2
            assert binary.set_all(c, {"joint[1].alpha": alpha}) == 0
        binary.set(c, dq=0.05 * np.cos(0.3 * k))
        assert binary.step(c, time, step) == 0
        h, time = moved(h, 0.05 * np.cos(0.3 * k), step, alpha, beta), time + step
        assert binary.get(c, "h[1]")[0] == pytest.approx(h, rel=1e-12, abs=0.0)


def test_invariants_are_part_of_a_saved_state(table1, binary) -> None:
    c, state = binary.ready(), ctypes.c_void_p()
    alpha, beta = (table1.laws[0].values[n] for n in ("alpha", "beta"))
    binary.set(c, dq=0.05)
    binary.step(c, 0.0, 0.005)
    (h,) = binary.get(c, "h[1]")
    assert binary("GetFMUstate", c, ctypes.byref(state)) == 0
    for factor in (1.5, 1.0, 1.5):
        assert binary("SetFMUstate", c, state) == 0
        if factor != 1.0:
            assert binary.set_all(c, {"joint[1].alpha": factor * alpha}) == 0
        assert binary.step(c, 0.005, 0.005) == 0
        expected = moved(h, 0.05, 0.005, factor * alpha, beta)
        assert binary.get(c, "h[1]")[0] == pytest.approx(expected, rel=1e-12, abs=0.0)


def test_states_can_be_saved_with_infinite_invariants(fitted, make_model, load, tmp_path) -> None:
    fmu = load(export_bare(make_model(fitted["lugre"]), tmp_path / "F.fmu"))
    c = fmu.ready()
    assert fmu.set_all(c, {"joint[1].F_c": 0.0}) == 0
    fmu.set(c, dq=0.0)
    assert fmu.step(c, 0.0, 0.005) == 0
    state, size = ctypes.c_void_p(), ctypes.c_size_t()
    assert fmu("GetFMUstate", c, ctypes.byref(state)) == 0
    assert fmu("SerializedFMUstateSize", c, state, ctypes.byref(size)) == 0
    data = ctypes.create_string_buffer(size.value)
    assert fmu("SerializeFMUstate", c, state, data, size) == 0
    other = ctypes.c_void_p()
    assert fmu("DeSerializeFMUstate", c, data, len(data), ctypes.byref(other)) == 0


@pytest.mark.parametrize("law", ["lugre", "parfam_h"])
def test_joints_that_step_together_give_the_same_bits_as_one(
    law: str, fitted, make_model, make_motion, tmp_path
) -> None:
    t, *signals = make_motion(5)
    laws = [
        replace(own, values={n: (1.0 + 0.1 * i) * x for n, x in own.values.items()})
        for i, own in enumerate([fitted[law]] * 5)
    ]
    all_of_them = replay(export_bare(make_model(*laws), tmp_path / "All.fmu"), t, *signals)
    for i in (0, 4):
        alone = export_bare(make_model(laws[i]), tmp_path / f"{i}.fmu")
        found = replay(alone, t, *(x[:, i : i + 1] for x in signals))
        assert found.tobytes() == all_of_them[:, i : i + 1].tobytes()


def test_invariant_terms_and_factors_share_one_name() -> None:
    a, b, u, y, z = sympy.symbols("a b u y z", real=True)
    parts = Invariants.from_program(
        {y: u * sympy.exp(-a) / b, z: u + sympy.exp(-a) / b}, [y, z], {a, b}
    )
    assert len(parts.reused) == 1
    assert parts.moving[y] == u * parts.reused[0]
    assert parts.moving[z] == u + parts.reused[0]
