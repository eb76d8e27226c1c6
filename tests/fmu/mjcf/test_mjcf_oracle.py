"""MuJoCo as an independent oracle: its bristles compared with exact relaxation and the FMU."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import sympy
from mujoco_joints import Joints, reference
from oracles.stepper import Stepper

from fmu_src import export_fmu
from fmu_src.arm.truth import true_friction
from fmu_src.friction.reference import reference_motion
from fmu_src.run.fmu import FmuInstance
from hesr.extras.mjcf.mjcf_file import export_mjcf_law
from hesr_model.equations.functions import absolute
from hesr_model.equations.memory import Relaxation
from hesr_model.fitting.estimator import estimator
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.predict import predict
from hesr_model.laws.dahl import DEFLECTIONS
from hesr_model.support.files import models_folder

UF850 = models_folder() / "uf850" / "uf850.xml"
UF850_JOINTS = ("joint1", "joint2", "joint3")
EXACT = 1e-12


def lugre():
    values = {"sigma_0": 8159.06, "sigma_1": 38.86, "sigma_2": 16.63, "F_c": 9.54, "F_s": 11.39}
    form = estimator("lugre").form({})
    return FrictionLaw(name="lugre", form=form, values=values | {"v_s": 0.062, "tau_0": -0.3})


def rising_lugre():
    """The level rises with speed, and micro-damping is large."""
    values = dict(lugre().values) | {"F_s": 3.1, "sigma_1": 300.0, "tau_0": 0.0}
    return replace(lugre(), values=values)


def dahl():
    form = estimator("dahl").form({})
    values = {f"kappa_{i}": 1.0 / x for i, x in enumerate(DEFLECTIONS, start=1)}
    # MuJoCo has no element without torque.
    values |= {"F_1": 0.0, "F_2": 7.5, "F_3": 2.25, "F_4": 0.2, "F_5": 0.3}
    return FrictionLaw(name="dahl", form=form, values=values | {"sigma_2": 12.0, "tau_0": 0.1})


def damped_dahl():
    """States in another unit than a deflection, with a torque from their derivative."""
    own = [Coefficient(name=n, unit="1", description="") for n in ("k", "F", "c")]
    k, force, c = (o.symbol for o in own)
    x = Relaxation(name="x", unit="1", drive=k * DQ, rate=k * absolute(DQ))
    torque = force * x.state + c * x.derivative + sympy.Rational(5, 2) * DQ
    form = LawForm(coefficients=tuple(own), memory=(x,), output=torque)
    return FrictionLaw(name="by_hand", form=form, values={"k": 250.0, "F": 6.0, "c": 0.01})


def ripple():
    structure = {"ripple": {"gear_ratio": 50.5, "orders": [1, 4]}}
    values = {"ripple1_cos": 0.4, "ripple1_sin": -0.2, "ripple4_cos": 0.0, "ripple4_sin": 0.3}
    return FrictionLaw(
        name="lugre_load_ripple",
        structure=structure,
        form=estimator("lugre_load_ripple").form(structure),
        values=dict(lugre().values) | values | {"mu": 0.0, "lag": 0.0, "smoothing": 0.0},
    )


def twin():
    return true_friction(UF850, UF850_JOINTS, sample_time=0.005).laws[0]


LAWS = {f.__name__: f for f in (lugre, rising_lugre, dahl, damped_dahl, ripple, twin)}


@pytest.fixture(params=LAWS)
def law(request):
    return LAWS[request.param]()


def deflections(law, stepper):
    """The states that affect the torque, as deflections in MuJoCo's order."""
    numbers = {c.symbol: law.values[c.name] for c in law.form.coefficients}
    counted = law.form.output.subs(numbers).free_symbols
    scales = [float((r.drive / DQ).subs(numbers)) for r in law.form.relaxations]
    return [
        x / scale
        for x, scale, r in zip(stepper.x, scales, law.form.relaxations, strict=True)
        if r.state in counted
    ]


def test_states_and_torques_of_the_reference_motion_match(law, make_model, tmp_path):
    """The importer's convention: inputs are held over a step, the torque is read at its end."""
    model = make_model(law)
    motion, expected = reference(model)
    assert export_mjcf_law(model, tmp_path / "friction.xml").exact
    joints = Joints(model.joints, tmp_path / "friction.xml", model.sample_time)
    stepper = Stepper(law)
    stepper.step(0.0, motion.dq[0, 0], motion.q[0, 0])
    torques = [joints.torque(motion.q[0], motion.dq[0])]
    found, states = [joints.data.act.copy()], [deflections(law, stepper)]
    for q, dq in zip(motion.q[:-1], motion.dq[:-1], strict=True):
        joints.hold(q, dq)
        torques.append(joints.torque(q, dq))
        stepper.step(model.sample_time, dq[0], q[0])
        found.append(joints.data.act.copy())
        states.append(deflections(law, stepper))
    assert len(found) == 100
    scale = np.abs(states).max(axis=0)
    assert np.all(scale > 0.0)
    assert np.max(np.abs(np.array(found) - states) / scale) < EXACT
    assert np.max(np.abs(np.array(torques) - expected)) < EXACT * np.max(np.abs(expected))


def test_the_replay_of_a_log_matches(law, make_model, tmp_path):
    """The convention of logs: set sample k, step to it, read it."""
    model = make_model(law)
    motion = reference_motion(model, frequency=0.4, periods=4.0, lead_in=1.0)
    export_mjcf_law(model, tmp_path / "friction.xml")
    joints = Joints(model.joints, tmp_path / "friction.xml", model.sample_time)
    found = [joints.torque(motion.q[0], motion.dq[0])]
    for q, dq in zip(motion.q[1:], motion.dq[1:], strict=True):
        joints.hold(q, dq)
        found.append(joints.torque(q, dq))
    expected = predict(law, t=motion.t, dq=motion.dq[:, 0], q=motion.q[:, 0])
    assert np.max(np.abs(np.squeeze(found) - expected)) < EXACT * np.max(np.abs(expected))


def test_the_fmu_matches(make_model, tmp_path):
    """Six laws in one FMU compared with MuJoCo, which shares no code with it."""
    model = make_model(*(law() for law in LAWS.values()))
    motion, _ = reference(model)
    export_mjcf_law(model, tmp_path / "friction.xml")
    joints = Joints(model.joints, tmp_path / "friction.xml", model.sample_time)
    indices = range(1, len(LAWS) + 1)
    found, expected = [], []
    with FmuInstance(export_fmu(model, tmp_path / "Friction.fmu")) as fmu:
        fmu.initialise()
        for k, (q, dq) in enumerate(zip(motion.q, motion.dq, strict=True)):
            fmu.set({f"q[{i}]": q[i - 1] for i in indices})
            fmu.set({f"dq[{i}]": dq[i - 1] for i in indices})
            fmu.step(k * model.sample_time, model.sample_time)
            expected.append(fmu.get([f"tau[{i}]" for i in indices]))
            joints.hold(q, dq)
            found.append(joints.torque(q, dq))
    difference = np.max(np.abs(np.array(found) - expected), axis=0)
    assert np.all(difference < EXACT * np.max(np.abs(expected), axis=0))


def test_a_plain_mujoco_simulation_matches(law, make_model, tmp_path):
    """The view of a MuJoCo user: the states follow the velocity at the start of each step, and the
    torque is that of the states and the velocity at the same instant.
    """
    step = 1e-3
    model = make_model(law, sample_time=step)
    export_mjcf_law(model, tmp_path / "friction.xml")
    joints = Joints(model.joints, tmp_path / "friction.xml", step)
    data = joints.data
    q, dq, torque = [], [], []
    for k in range(4000):
        data.qfrc_applied[:] = 30.0 * np.sin(4.0 * np.pi * step * k) * np.sin(0.7 * step * k)
        mujoco.mj_forward(joints.model, data)
        q.append(data.qpos[0])
        dq.append(data.qvel[0])
        torque.append(-(data.qfrc_actuator + data.qfrc_passive)[0])
        mujoco.mj_step(joints.model, data)
    assert np.sum(np.diff(np.sign(dq)) != 0) > 5
    # A step with the previous velocity, then a zero step that only reads the torque.
    t = np.repeat(step * np.arange(4000), 2)[1:]
    rows = {name: np.repeat(values, 2)[:-1] for name, values in (("q", q), ("dq", dq))}
    expected = predict(law, t=t, **rows)[::2]
    np.testing.assert_allclose(torque, expected, rtol=0, atol=EXACT * np.max(np.abs(torque)))
