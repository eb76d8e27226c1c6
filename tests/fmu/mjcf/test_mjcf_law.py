"""A law as MJCF: its numbers, its inclusion in a robot, and refusals."""

import json
import xml.etree.ElementTree as ET
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import sympy

from fmu_src import model_file
from fmu_src.arm.truth import true_friction
from hesr.extras.mjcf.mjcf_file import export_mjcf_law
from hesr.extras.mjcf.parts import Wave, find_parts
from hesr_model.equations.functions import absolute
from hesr_model.equations.memory import Relaxation
from hesr_model.errors import ArtifactError, ExportError
from hesr_model.fitting.estimator import estimator
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.support.files import models_folder

UF850 = models_folder() / "uf850" / "uf850.xml"
JOINTS = ("joint1", "joint2", "joint3")


@pytest.fixture
def twin():
    """The true friction of the twin, which MuJoCo can represent under any law name."""
    return true_friction(UF850, JOINTS, sample_time=0.005)


@pytest.fixture
def lugre(make_law, make_model):
    return make_model(make_law("lugre"), law="lugre")


def without_friction(path):
    """The robot of the twin with an include in place of its friction actuators."""
    tree = ET.parse(UF850)
    actuators = tree.find("actuator")
    for motor in actuators.findall("dcmotor"):
        actuators.remove(motor)
    sensors = tree.find("sensor")
    for sensor in sensors.findall("actuatorfrc"):
        sensors.remove(sensor)
    ET.SubElement(tree.getroot(), "include", file="friction.xml")
    tree.write(path)
    return path


def test_numbers_have_full_precision(make_model, tmp_path):
    names = ("sigma_0", "sigma_1", "sigma_2", "F_c", "F_s", "v_s", "tau_0")
    value = dict(zip(names, np.exp(np.random.default_rng(0).normal(size=7)), strict=True))
    law = FrictionLaw(name="lugre", form=estimator("lugre").form({}), values=value)
    model = replace(make_model(law, law="lugre"), joints=("joint2",))
    export_mjcf_law(model, tmp_path / "friction.xml")
    robot = mujoco.MjModel.from_xml_path(str(without_friction(tmp_path / "robot.xml")))
    motor = robot.actuator("joint2_lugre1").id
    assert list(robot.actuator_dynprm[motor, 5:7]) == [value["sigma_0"], value["sigma_1"]]
    found = robot.actuator_biasprm[motor, :6]
    offset = [-value["tau_0"], 0.0, np.pi / 2.0]
    assert list(found) == [*offset, value["F_c"], value["F_s"], value["v_s"]]
    assert np.ravel(robot.actuator_damping[motor])[0] == value["sigma_2"]
    assert robot.joint("joint2").id == robot.actuator_trnid[motor, 0]


def test_the_friction_of_the_twin_is_reproduced(twin, tmp_path):
    """The MJCF of its own friction gives the same arm, step by step."""
    assert export_mjcf_law(twin, tmp_path / "friction.xml").lines() == [
        "joint1: exact",
        "joint2: exact",
        "joint3: exact",
    ]
    again = mujoco.MjModel.from_xml_path(str(without_friction(tmp_path / "robot.xml")))
    original = mujoco.MjModel.from_xml_path(str(UF850))
    assert again.nu == original.nu
    assert again.na == original.na
    states = []
    for model in (original, again):
        data = mujoco.MjData(model)
        data.qpos[:] = [0.0, 0.3, -1.9]
        path = []
        for k in range(2000):
            data.ctrl[:3] = data.ctrl[3:] = np.sin(0.004 * k) * np.array([1.0, 0.5, 0.8])
            mujoco.mj_step(model, data)
            path.append([*data.qpos, *data.qvel])
        states.append(path)
    moved = np.ptp(states[0], axis=0)
    assert np.all(moved[:3] > 0.1)
    np.testing.assert_allclose(states[1], states[0], rtol=0, atol=1e-12)


def test_defaults_of_the_robot_are_overridden(lugre, tmp_path):
    """Gear, damping and cogging of the robot's own motors do not affect the friction."""
    (tmp_path / "robot.xml").write_text(
        '<mujoco><default><dcmotor gear="3" damping="7" cogging="1 2 3" motorconst="1 1"'
        ' resistance="2"/></default>'
        '<worldbody><body><joint name="axis_1"/><geom size="0.1"/></body></worldbody>'
        '<include file="friction.xml"/></mujoco>'
    )
    export_mjcf_law(lugre, tmp_path / "friction.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    assert model.actuator_gear[0, 0] == 1.0
    assert not np.any(model.actuator_damping)
    assert not np.any(model.actuator_biasprm[0, :3])
    data = mujoco.MjData(model)
    data.qvel[0] = 100.0
    mujoco.mj_forward(model, data)
    # Bristles at rest have only micro-damping.
    assert data.actuator_force[0] == pytest.approx(-150.0, rel=1e-14, abs=0.0)


def test_the_file_states_its_origin(lugre, tmp_path):
    model = replace(
        lugre, robot='"a" & <b>', joints=("arm's <1>",), provenance={"seed": 3, "files": ["x"]}
    )
    path = tmp_path / "friction.xml"
    export_mjcf_law(model, path)
    texts = {text.get("name"): text.get("data") for text in ET.parse(path).iter("text")}
    assert texts['"a" & <b>_friction_law'].startswith(
        'lugre of "a" & <b>, made at 0.005 s, by HESR'
    )
    assert json.loads(texts['"a" & <b>_friction_provenance']) == {"seed": 3, "files": ["x"]}
    assert texts['"a" & <b>_friction_error'] == "arm's <1>: exact"
    assert [motor.get("joint") for motor in ET.parse(path).iter("dcmotor")] == ["arm's <1>"]


def test_the_export_is_reproducible(twin, tmp_path):
    for name in ("a.xml", "b.xml"):
        export_mjcf_law(twin, tmp_path / name)
    assert (tmp_path / "a.xml").read_bytes() == (tmp_path / "b.xml").read_bytes()


V, F, C = (sympy.Symbol(name, real=True) for name in ("v_s", "F", "c"))


SLOPE = absolute(DQ) * F


def odd(*, drive=DQ, rate=SLOPE, output=None, values=(0.1, 9.0, 2.0), **more):
    z = Relaxation(name="z", unit="rad", drive=drive, rate=rate)
    own = tuple(Coefficient(name=str(s), unit="1", description="") for s in (V, F, C))
    torque = F * z.state if output is None else output(z)
    form = LawForm(coefficients=own, memory=(z,), output=torque)
    return FrictionLaw(
        name="odd", form=form, values=dict(zip(map(str, (V, F, C)), values, strict=True)), **more
    )


PEAK = sympy.exp(-((DQ / V) ** 2))
NO_COUNTERPART = {
    "start": (odd(start=(0.1,)), "state 'z' starts at 0.1"),
    "euler": (
        odd(discretisation="euler"),
        "Euler steps, and MuJoCo relaxes",
    ),
    "drive": (
        odd(drive=sympy.tanh(DQ)),
        "state 'z' is driven by tanh(dq)",
    ),
    "backwards": (odd(drive=-DQ), "its state 'z' is driven by -dq, "),
    "rate at rest": (
        odd(rate=F),
        "state 'z' relaxes at the rate",
    ),
    "rate in the angle": (odd(rate=absolute(DQ) * (F + Q**2)), "its state 'z' relaxes at the rate"),
    "other peak": (odd(rate=absolute(DQ) / (F + sympy.exp(-DQ))), "its state 'z' relaxes at"),
    "two peaks": (odd(rate=absolute(DQ) / (F + PEAK + PEAK**2)), "its state 'z' relaxes at"),
    "level": (
        odd(rate=absolute(DQ) * (F + C * PEAK)),
        "torque of its state 'z' is",
    ),
    "negative level": (
        odd(rate=absolute(DQ) / (F - C * PEAK), values=(0.1, 1.0, 2.0)),
        "'z' slides at 1 to -1",
    ),
    "negative force": (
        odd(output=lambda z: -F * z.state),
        "state 'z' has the factor -9",
    ),
    "no force": (odd(output=lambda z: C * z.derivative), "has the factor 0 N.m/rad"),
    "square": (
        odd(output=lambda z: F * z.state**2),
        "the term F*z**2, which is neither",
    ),
    "product": (odd(output=lambda z: F * z.state * z.derivative), "has the term F*dz*z, "),
    "quadratic": (odd(output=lambda z: F * z.state + DQ**2), "its torque has the term dq**2, "),
    "spring": (odd(output=lambda z: F * z.state + C * Q), "its torque has the term c*q, "),
    "wave of speed": (
        odd(output=lambda z: F * z.state + sympy.sin(Q + DQ)),
        "its torque has the term sin(dq + q), ",
    ),
    "endless": (
        odd(rate=absolute(DQ) * C, values=(0.1, 9.0, 0.0)),
        "its state 'z' never relaxes",
    ),
    "wave of the square": (
        odd(output=lambda z: F * z.state + C * sympy.sin(Q**2)),
        "its torque has the term c*sin(q**2), ",
    ),
    "square wave": (
        odd(output=lambda z: F * z.state + C * sympy.sin(Q) ** 2),
        "its torque has the term c*sin(q)**2, ",
    ),
}


@pytest.mark.parametrize("name", NO_COUNTERPART)
def test_parts_missing_in_mujoco_are_refused(name, make_model, tmp_path):
    law, reason = NO_COUNTERPART[name]
    path = tmp_path / "friction.xml"
    with pytest.raises(ExportError) as refusal:
        export_mjcf_law(make_model(law, law="odd"), path)
    sentence = str(refusal.value)
    assert "joint 'axis_1' is not expressible" in sentence
    assert reason in sentence
    assert "'project' writes the nearest bristles" in sentence
    assert not list(tmp_path.iterdir())


def test_a_non_finite_part_is_named():
    law = odd(output=lambda z: F * z.state + sympy.log(C) * DQ, values=(0.1, 9.0, -2.0))
    with pytest.raises(ExportError) as refusal:
        find_parts(law)
    assert str(refusal.value) == "its coefficients make its viscous friction non-finite (log(c))"


REGISTRY = {
    "coulomb_viscous": "has the term F_c*sgn(dq), which is neither",
    "stribeck": "has the term F_c*sgn(dq), which is neither",
    "parfam_v": "nor viscous",
    "lugre_load": "term mu*sigma_0*z*abs(tau_load), which depends",
    "lugre_load_ripple": "term mu*sigma_0*z*abs(tau_load), which depends",
    "dahl_load": "term mu_1*x1*abs(tau_load), which depends",
    "rbfnn_h": "state 'h' is driven by alpha*tanh(beta*dq)",
    "mlp_h": "its state 'h' is driven by alpha*tanh(beta*dq), ",
    "parfam_h": "its state 'h' is driven by alpha*tanh(beta*dq), ",
    "strain_wave": "term mu_avg*z*abs(tau_load), which depends",
    "parfam_hx": "its state 'h' is driven by ",
    "parfam_s": "bristles relax",
    "parfam_s_load": "bristles relax",
    "parfam_s_v": "bristles relax",
    "bam_m6": "has the term F_c*sgn(dq), which is neither",
    "gms": "bristles relax",
    "strain_wave_bound": "its state 'z' relaxes at the rate ",
    "lugre_textbook": "has the term dq*sigma_t/(1 + abs(dq)/v_t), which is neither",
}


def test_every_law_of_the_registry_is_exact_or_refused(fitted, make_model, tmp_path):
    """A new law needs a line here unless it is a sum of MuJoCo's parts."""
    for name, law in fitted.items():
        model = make_model(law, law=name)
        if name not in REGISTRY:
            assert export_mjcf_law(model, tmp_path / f"{name}.xml").exact
            continue
        with pytest.raises(ExportError, match=f"law '{name}' of joint 'axis_1' is not") as refusal:
            export_mjcf_law(model, tmp_path / f"{name}.xml")
        assert REGISTRY[name] in str(refusal.value)
    exact_laws = {"none", "constant", "lugre", "lugre_passive", "dahl"}
    assert {path.stem for path in tmp_path.iterdir()} == exact_laws


def test_the_law_of_the_paper_is_refused(tmp_path):
    with pytest.raises(ExportError, match="law 'parfam_h' of joint 'joint1' is not expressible"):
        export_mjcf_law(FrictionModel.read(model_file("uf850-table1")), tmp_path / "friction.xml")


@pytest.mark.parametrize("name", ["friction.fmu", "friction", "xml"])
def test_an_invalid_name_is_refused(name, lugre, tmp_path):
    path = tmp_path / name
    with pytest.raises(ExportError) as refusal:
        export_mjcf_law(lugre, path)
    assert f"{path}: the name of an MJCF" in str(refusal.value)
    assert not list(tmp_path.iterdir())


def test_an_unwritable_path_is_reported(lugre, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ArtifactError, match="cannot be written there"):
        export_mjcf_law(lugre, tmp_path / "file" / "friction.xml")


def test_terms_with_zero_coefficient_are_ignored():
    """A load dependence of zero is ignored, and so is a state without effect."""
    plain = odd(output=lambda z: F * z.state * (1 + C * absolute(TAU_LOAD)), values=(0.1, 9.0, 0.0))
    assert find_parts(plain) == find_parts(odd())
    idle = odd(output=lambda z: 2 * DQ + 0 * z.state)
    assert find_parts(idle).bristles == ()
    assert find_parts(idle).viscous == 2.0


def test_ripple_has_the_phase_of_the_law():
    """A torque F cos(c - 3 q) of a law is on the other side of the equation in MuJoCo."""
    law = odd(output=lambda z: F * z.state + F * sympy.cos(C - 3 * Q) + F * sympy.sin(3 * Q))
    q = np.linspace(-1.0, 1.0, 7)
    waves = find_parts(law).waves
    found = sum(w.amplitude * np.sin(w.poles * q + w.phase) for w in waves)
    expected = -9.0 * (np.cos(2.0 - 3.0 * q) + np.sin(3.0 * q))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
    assert Wave(amplitude=-9.0, poles=3.0, phase=0.0) in waves
