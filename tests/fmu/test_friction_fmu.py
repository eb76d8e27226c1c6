"""A friction FMU gives the torque of its law in every mode."""

import ctypes
from dataclasses import replace

import numpy as np
import pytest
from oracles.stepper import Stepper

from fmu_src.friction.friction_fmu import export_bare
from fmu_src.friction.replay import replay
from fmu_src.run.fmu import FmuInstance
from hesr_model.friction.predict import predict
from hesr_model.friction.scales import add_scales

EXACT_ENOUGH = 1e-12


def assert_equals_python(model, fmu, motion):
    t, dq, q, load = motion
    torque = replay(fmu, t, dq, q, load)
    for i, law in enumerate(model.laws):
        expected = predict(law, t=t, dq=dq[:, i], q=q[:, i], tau_load=load[:, i])
        worst = np.abs(torque[:, i] - expected).max() / np.abs(expected).max()
        assert worst <= EXACT_ENOUGH, f"{law.name}, joint {i + 1}"


@pytest.mark.parametrize("discretisation", ["exact", "euler"])
def test_each_law_matches_python(law, discretisation, make_model, make_motion, tmp_path):
    law = replace(law, discretisation=discretisation)
    motion = make_motion(1)
    if discretisation == "euler" and {r.name for r in law.form.relaxations} - {"h"}:
        motion = (3.0 + 1e-3 * (motion[0] - 3.0), *motion[1:])  # Euler needs rate * step < 1
    model = make_model(law)
    assert_equals_python(model, export_bare(model, tmp_path / "F.fmu"), motion)


def test_laws_of_different_forms_share_an_fmu(make_law, make_model, make_motion, tmp_path):
    names = ["lugre", "parfam_tanh", "gaussians", "viscous", "parfam_tanh", "elements"]
    model = make_model(*map(make_law, names))
    assert_equals_python(model, export_bare(model, tmp_path / "F.fmu"), make_motion(6))


def test_table_1_matches_the_equations_of_the_paper(table1, table1_fmu):
    t = 0.005 * np.arange(1600)
    v = 1.2 * np.sin(2 * np.pi * 0.25 * t)
    torque = replay(table1_fmu, t, np.column_stack([v, 0.8 * v, -v]))

    def expected(alpha, beta, equation, v):
        h, rows = 0.0, []
        for k, vk in enumerate(v):
            if k:
                h = (1 - alpha * 0.005) * h + alpha * 0.005 * np.tanh(beta * vk)
            dh = -alpha * h + alpha * np.tanh(beta * vk)
            rows.append(equation(vk, h, dh))
        return np.array(rows)

    def joint1(v, h, dh):
        return (
            16.237 * h
            - 0.163 * dh
            - 2.128
            + 37.715 * np.tanh(0.193 * v - 0.606 * h + 0.064 * dh + 0.057)
        )

    def joint2(v, h, dh):
        return (
            3.710 * v
            + 2.936 * h
            + 1.220 * dh
            - 0.279
            + 8.290 * np.cos(-0.865 * v + 1.531 * h + 0.351 * dh + 1.485)
        )

    def joint3(v, h, dh):
        return (
            0.051 * v
            + 6.614 * h
            + 0.238 * dh
            - 0.280
            + 6.527 * np.tanh(1.014 * v - 2.130 * h + 0.115 * dh + 0.167)
        )

    for i, (alpha, beta, equation, speed) in enumerate(
        [
            (11.37, 256.84, joint1, v),
            (19.62, 143.91, joint2, 0.8 * v),
            (8.45, 278.23, joint3, -v),
        ]
    ):
        reference = expected(alpha, beta, equation, speed)
        assert np.abs(torque[:, i] - reference).max() <= EXACT_ENOUGH * np.abs(reference).max()


def test_a_step_uses_the_inputs_that_are_set_before_it(table1, binary):
    c = binary.ready()
    stepper = Stepper(table1.laws[0])
    stepper.step(0.0, 0.0)
    for k, dq in enumerate((0.3, -0.2, -0.2, 0.0)):
        binary.set(c, dq=dq)
        assert binary.step(c, 0.005 * k, 0.005) == 0
        assert binary.get(c, "tau[1]")[0] == pytest.approx(
            stepper.step(0.005, dq), rel=1e-12, abs=0.0
        )


def test_states_and_derivatives_are_readable(table1, binary):
    c = binary.ready()
    binary.set(c, dq=0.01)
    binary.step(c, 0.0, 0.005)
    alpha, beta = (table1.laws[0].values[n] for n in ("alpha", "beta"))
    h, dh = binary.get(c, "h[1]", "der(h[1])")
    assert h == pytest.approx(alpha * 0.005 * np.tanh(beta * 0.01), rel=1e-12, abs=0.0)
    assert dh == pytest.approx(alpha * (np.tanh(beta * 0.01) - h), rel=1e-12, abs=0.0)


def test_reading_derivatives_has_no_side_effect(every_law, make_model, load, tmp_path):
    """Co-simulation computes them on reading; results do not depend on it."""
    fmu = load(export_bare(make_model(*every_law.values()), tmp_path / "F.fmu"))
    read, left, continuous = fmu.ready(), fmu.ready(), fmu.continuous()
    states = [u.variable.derivative.name for u in fmu.about.derivatives]
    rates = [f"der({state})" for state in states]
    joints = range(1, len(every_law) + 1)
    torques = [f"tau[{i}]" for i in joints]
    for k, dq in enumerate((0.3, -0.01, -0.2, 0.0, 0.02)):
        row = {"dq": dq, "q": 0.1 * k, "tau_load": 3.0 * k}
        inputs = {f"{name}[{i}]": value for name, value in row.items() for i in joints}
        for c in (read, left):
            assert fmu.set_all(c, inputs) == 0
            assert fmu.step(c, 0.002 * k, 0.002) == 0
        found = fmu.get(read, *rates)
        after = fmu.get(left, *states)
        assert fmu.get(read, *torques, *states) == fmu.get(left, *torques, *states)
        fmu.event(continuous, inputs)
        assert fmu.set_all(continuous, dict(zip(states, after, strict=True))) == 0
        assert fmu.get(continuous, *rates) == found


def test_outputs_are_readable_during_initialisation(table1, binary):
    c = binary.instantiate()
    assert binary("EnterInitializationMode", c) == 0
    first = Stepper(table1.laws[0]).step(0.0, 0.0)
    assert binary.get(c, "tau[1]") == [pytest.approx(first, rel=1e-12, abs=0.0)]
    binary.set(c, dq=0.3)
    before = binary.get(c, "tau[1]", "der(h[1])")
    assert before[0] != pytest.approx(first)
    assert binary("ExitInitializationMode", c) == 0
    assert binary.get(c, "tau[1]", "der(h[1])") == before


def test_start_values_of_states_are_used(table1, table1_fmu, make_motion):
    t, dq, *_ = make_motion(3)
    torque = replay(table1_fmu, t, dq, start={"h_start[2]": 0.7, "start_mode": 2})
    expected = predict(table1.laws[1], t=t, dq=dq[:, 1], start=(0.7,))
    np.testing.assert_allclose(torque[:, 1], expected, rtol=0, atol=1e-12 * np.ptp(expected))


def test_discretisation_is_selectable(table1, table1_fmu, make_motion):
    t, dq, *_ = make_motion(3)
    torque = replay(table1_fmu, t, dq, start={"discretisation": 1})
    law = replace(table1.laws[0], discretisation="exact")
    expected = predict(law, t=t, dq=dq[:, 0])
    np.testing.assert_allclose(torque[:, 0], expected, rtol=0, atol=1e-12 * np.ptp(expected))


def test_coefficients_are_tunable_at_run_time(table1, binary):
    tuned, other = binary.ready(), binary.ready(name=b"two")
    for c in (tuned, other):
        binary.set(c, dq=0.1)
        assert binary.step(c, 0.0, 0.005) == 0
    binary.set_all(tuned, {"joint[1].c_0": table1.laws[0].values["c_0"] + 1.5})
    for c in (tuned, other):
        assert binary.step(c, 0.005, 0.005) == 0
    assert binary.get(tuned, "h[1]") == binary.get(other, "h[1]")
    assert binary.get(tuned, "tau[1]")[0] == pytest.approx(binary.get(other, "tau[1]")[0] + 1.5)


def test_large_laws_have_only_their_factors(make_law, make_model, make_motion, tmp_path):
    fmu = export_bare(make_model(make_law("gaussians")), tmp_path / "F.fmu")
    t, dq, *_ = make_motion(1)
    with FmuInstance(fmu) as component:
        names = {v.name for v in component.description.modelVariables}
    assert {"coulomb_scale[1]", "viscous_scale[1]"} <= names
    assert not any(name.startswith("joint[") for name in names)
    np.testing.assert_allclose(
        replay(fmu, t, dq, start={"coulomb_scale[1]": 2.5}), 2.5 * replay(fmu, t, dq), rtol=1e-14
    )


def test_factors_scale_the_law(make_law, make_model, make_motion, tmp_path):
    """The binary agrees with Python; a law that cannot be split also has both factors."""
    chosen = {"coulomb_scale": 1.7, "viscous_scale": 0.4}
    t, dq, q, load = (np.squeeze(x) for x in make_motion(1))
    for name in ("lugre", "viscous", "parfam_tanh"):
        law = make_law(name)
        whole = replace(law, form=add_scales(law.form), values={**law.values, **chosen})
        fmu = export_bare(make_model(law), tmp_path / f"{name}.fmu")
        found = replay(
            fmu,
            t,
            dq[:, None],
            q[:, None],
            load[:, None],
            start={f"{n}[1]": x for n, x in chosen.items()},
        )[:, 0]
        wanted = predict(whole, t=t, dq=dq, q=q, tau_load=load)
        np.testing.assert_allclose(found, wanted, atol=1e-12 * np.abs(wanted).max())


def test_changing_factors_supply_no_energy(make_law, make_model, load, tmp_path):
    """At rest a loaded bristle keeps its torque: factors do not multiply stored deflection."""
    binary = load(export_bare(make_model(make_law("lugre")), tmp_path / "F.fmu"))
    c = binary.ready()
    binary.set_all(c, {"dq[1]": 0.3})
    for k in range(20):
        assert binary.step(c, 0.01 * k, 0.01) == 0
    binary.set_all(c, {"dq[1]": 0.0, "coulomb_scale[1]": 3.0})
    assert binary.step(c, 0.2, 0.01) == 0
    (held,) = binary.get(c, "tau[1]")
    assert held == pytest.approx(9.0, rel=1e-3)  # its level before
    binary.set_all(c, {"dq[1]": 0.3})
    for k in range(21, 81):
        assert binary.step(c, 0.01 * k, 0.01) == 0
    assert binary.get(c, "tau[1]")[0] == pytest.approx(27.0, rel=1e-3)


def test_input_derivatives_are_followed(table1, binary):
    """An input ramp in long steps comes close to the same ramp in short held steps."""
    slope, end = 0.02, 0.2
    held, ramped = binary.ready(), binary.ready(name=b"two")
    for k in range(2000):
        binary.set(held, dq=slope * end * (k + 0.5) / 2000)
        assert binary.step(held, k * end / 2000, end / 2000) == 0
    binary.set(held, dq=slope * end)

    vr, order, value = (
        binary.references(["dq[1]"]),
        (ctypes.c_int * 1)(1),
        (ctypes.c_double * 1)(slope),
    )
    for k in range(40):
        binary.set(ramped, dq=slope * end * k / 40)
        assert binary("SetRealInputDerivatives", ramped, vr, 1, order, value) == 0
        assert binary.step(ramped, k * end / 40, end / 40) == 0
    assert binary.get(ramped, "dq[1]")[0] == pytest.approx(slope * end)
    assert binary.get(ramped, "h[1]")[0] == pytest.approx(binary.get(held, "h[1]")[0], rel=2e-2)
    # An input derivative applies only to the step after it was set.
    assert binary.step(ramped, end, 0.005) == 0
    assert binary.get(ramped, "dq[1]")[0] == pytest.approx(slope * end)


def test_input_derivatives_apply_to_one_step(binary):
    c, one = binary.ready(), (ctypes.c_int * 1)(1)
    for k, name in enumerate(("dq[1]", "dq[2]", "dq[1]")):
        slope = (ctypes.c_double * 1)(0.5)
        vr = binary.references([name])
        assert binary("SetRealInputDerivatives", c, vr, 1, one, slope) == 0
        assert binary.step(c, 0.01 * k, 0.01) == 0
    assert binary.get(c, "dq[1]", "dq[2]") == pytest.approx([0.01, 0.005])


def test_signs_are_those_at_the_end_of_a_ramp(make_law, make_model, load, tmp_path):
    fmu = load(export_bare(make_model(make_law("viscous")), tmp_path / "F.fmu"))
    for start, end in ((0.1, -0.05), (0.05, -0.1), (-0.1, 0.05), (-0.1, 0.0)):
        c = fmu.ready()
        slope, one = (ctypes.c_double * 1)((end - start) / 0.125), (ctypes.c_int * 1)(1)
        fmu.set(c, dq=start)
        assert fmu("SetRealInputDerivatives", c, fmu.references(["dq[1]"]), 1, one, slope) == 0
        assert fmu.step(c, 0.0, 0.125) == 0
        expected = 4.5 * np.sign(end) + 12.0 * end**3 + 0.5
        assert fmu.get(c, "tau[1]") == [pytest.approx(expected)]


def test_instances_are_independent(binary):
    instances = [binary.ready(name=f"i{k}".encode()) for k in range(200)]
    for k, c in enumerate(instances):
        binary.set(c, dq=0.01 * k)
        binary.step(c, 0.0, 0.005)
    alone = binary.ready()
    for k in (0, 17, 199):
        fresh = binary.ready()
        binary.set(fresh, dq=0.01 * k)
        binary.step(fresh, 0.0, 0.005)
        assert binary.get(fresh, "tau[1]", "h[1]") == binary.get(instances[k], "tau[1]", "h[1]")
    assert binary.get(alone, "h[1]") == [0.0]
    for c in instances:
        binary("FreeInstance", c)
