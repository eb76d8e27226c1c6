"""FMUs and other exports of models with a prismatic joint: units, pages, refusals."""

import json
import re
import zipfile

import mujoco
import numpy as np
import pytest
from fmpy import read_model_description

from fmu_src import export_fmu
from fmu_src.arm.truth import true_friction
from fmu_src.check.run import check
from fmu_src.friction.embedded_model import EMBEDDED_MODEL
from fmu_src.run.fmu import FmuInstance
from hesr.extras.drive.drive_fmu import export_drive
from hesr.extras.mjcf.mjcf_file import export_mjcf_law
from hesr.extras.modelica.modelica_package import export_modelica
from hesr_model.errors import ExportError

CART = """
<mujoco>
  <option timestep="0.0005"/>
  <worldbody>
    <body><joint name="axis_1" type="slide" axis="1 0 0"/><geom size="0.1" mass="2"/></body>
  </worldbody>
  <include file="friction.xml"/>
</mujoco>
"""


@pytest.fixture(scope="module")
def mixed(make_law, make_model):
    """A revolute and a prismatic joint with the same law."""
    return make_model(make_law("lugre"), make_law("lugre"), sliding=(False, True))


@pytest.fixture(scope="module")
def mixed_fmu(mixed, tmp_path_factory):
    return export_fmu(mixed, tmp_path_factory.mktemp("mixed") / "Friction.fmu")


def variables(fmu):
    return {v.name: v for v in read_model_description(fmu, validate=True).modelVariables}


def test_every_variable_has_the_unit_of_its_joint(mixed_fmu):
    found = variables(mixed_fmu)
    for name, turning, sliding in (
        ("dq[{}]", "rad/s", "m/s"),
        ("q[{}]", "rad", "m"),
        ("tau_load[{}]", "N.m", "N"),
        ("tau[{}]", "N.m", "N"),
        ("dtau_ddq[{}]", "N.m.s/rad", "N.s/m"),
        ("z[{}]", "rad", "m"),
        ("der(z[{}])", "rad/s", "m/s"),
        ("joint[{}].sigma_0", "N.m/rad", "N/m"),
        ("joint[{}].sigma_1", "N.m.s/rad", "N.s/m"),
        ("joint[{}].F_c", "N.m", "N"),
        ("joint[{}].v_s", "rad/s", "m/s"),
    ):
        assert [found[name.format(i)].unit for i in (1, 2)] == [turning, sliding], name
    assert "friction torque of axis_1, delivered" in found["tau[1]"].description
    assert "friction force of axis_2, delivered" in found["tau[2]"].description
    assert (
        found["tau_load[2]"].description == "load force on axis_2: rigid-body force of the motion"
    )


def test_the_fmu_passes_all_checks_and_contains_the_model(mixed, mixed_fmu):
    assert check(mixed_fmu).problems == ()
    with zipfile.ZipFile(mixed_fmu) as archive:
        carried = json.loads(archive.read(EMBEDDED_MODEL))
    assert carried == mixed.to_json()
    assert [joint.get("sliding") for joint in carried["joints"]] == [None, True]


def test_the_code_of_a_law_is_written_once(mixed_fmu):
    with zipfile.ZipFile(mixed_fmu) as archive:
        laws = archive.read("sources/equations.h").decode()
    assert "law_1_step" in laws
    assert "law_2_step" not in laws


def test_the_page_has_the_right_units(mixed, mixed_fmu, make_law, make_model, tmp_path):
    both, one = "N.m (N where it slides)", make_model(make_law("lugre"), sliding=(True,))
    with zipfile.ZipFile(mixed_fmu) as archive:
        page = archive.read("documentation/index.html").decode()
        readme = archive.read("extra/README.txt").decode()
    assert f"Jump of the torque at rest [{both}]" in page
    assert "<td>rad/s (m/s where it slides)</td>" in page
    assert '"torque": "N"' in page
    assert "Units are SI: s, rad, rad/s, N.m; s, m, m/s, N of a joint that slides." in readme
    with zipfile.ZipFile(export_fmu(one, tmp_path / "F.fmu")) as archive:
        page = archive.read("documentation/index.html").decode()
        readme = archive.read("extra/README.txt").decode()
    shown = re.sub(r"<script.*?</script>|<style.*?</style>", "", page, flags=re.DOTALL)
    assert not re.findall(r".*(?:N\.m|\brad\b|µrad).*", shown)
    assert "Units are SI: s, m, m/s, N.\n" in readme


@pytest.fixture(scope="module")
def mixed_drive(mixed, tmp_path_factory):
    return export_drive(mixed, tmp_path_factory.mktemp("mixed") / "Drive.fmu", inertia=(3.0, 3.0))


def test_a_sliding_drive_has_its_units(mixed_drive):
    found = variables(mixed_drive)
    for name, turning, sliding in (
        ("tau_motor[{}]", "N.m", "N"),
        ("q_link[{}]", "rad", "m"),
        ("dq[{}]", "rad/s", "m/s"),
        ("ddq[{}]", "rad/s2", "m/s2"),
        ("tau_f[{}]", "N.m", "N"),
        ("inertia[{}]", "kg.m2", "kg"),
        ("stiffness[{}]", "N.m/rad", "N/m"),
        ("damping[{}]", "N.m.s/rad", "N.s/m"),
        ("q_start[{}]", "rad", "m"),
        ("z[{}]", "rad", "m"),
        ("joint[{}].sigma_0", "N.m/rad", "N/m"),
    ):
        assert [found[name.format(i)].unit for i in (1, 2)] == [turning, sliding], name
    assert found["tau_motor[1]"].description == "motor torque, joint 1"
    assert found["tau_motor[2]"].description == "motor force, joint 2"
    assert found["inertia[2]"].description == "mass at the motor, joint 2"
    assert check(mixed_drive).problems == ()
    with zipfile.ZipFile(mixed_drive) as archive:
        page = archive.read("documentation/index.html").decode()
    assert "its inertia is a mass in kg" in page
    assert " N without load; a force below " in page or "creeps under any force." in page


def test_a_sliding_drive_equals_a_rotating_one(mixed_drive):
    """A mass under a force moves in m like an inertia under a torque in rad, bit for bit."""
    with FmuInstance(mixed_drive) as drive:
        drive.initialise()
        force = drive.buffer(["tau_motor[1]", "tau_motor[2]"])
        moved = drive.buffer(["q[1]", "q[2]", "dq[1]", "dq[2]"])
        for k in range(200):
            force.values[:] = 40.0 * np.sin(0.05 * k)
            force.write()
            drive.step(0.005 * k, 0.005)
            q_turned, q_slid, dq_turned, dq_slid = moved.read()
            assert (q_turned, dq_turned) == (q_slid, dq_slid)
        assert abs(q_slid) > 1e-3


def test_modelica_refuses_sliding_joints(mixed, tmp_path):
    with pytest.raises(ExportError) as caught:
        export_modelica(mixed, tmp_path / "Friction.mo")
    assert "Modelica: joint 'axis_2' is prismatic" in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_mujoco_matches_the_law_in_sliding(make_law, make_model, tmp_path):
    """Passive actuators act on any joint, in N on a prismatic one."""
    model = make_model(make_law("lugre"), law="lugre", sliding=(True,))
    assert export_mjcf_law(model, tmp_path / "friction.xml").lines() == ["axis_1: exact"]
    (tmp_path / "cart.xml").write_text(CART)
    cart = mujoco.MjModel.from_xml_path(str(tmp_path / "cart.xml"))
    assert true_friction(tmp_path / "cart.xml", ("axis_1",), sample_time=0.005).sliding == (True,)
    data = mujoco.MjData(cart)
    dt, rows = cart.opt.timestep, 4000
    dq, force = np.empty(rows), np.empty(rows)
    for k in range(rows):
        data.qfrc_applied[0] = 25.0 * np.sin(6.0 * k * dt)
        dq[k] = data.qvel[0]
        mujoco.mj_step(cart, data)
        force[k] = data.qfrc_actuator[0]
    assert np.abs(force).max() > 5.0
    # MuJoCo applies the force of the start of a step; the law gives that of its end.
    said = model.predict(t=dt * np.arange(rows), dq=dq[:, None])[:, 0]
    assert np.abs(force[1:] + said[:-1]).max() < 0.05 * np.abs(said).max()


def test_parts_missing_in_mujoco_are_reported_in_their_units(make_law, make_model, tmp_path):
    law = make_law("lugre")
    negative = type(law)(**{**vars(law), "values": {**law.values, "sigma_0": -9.0, "F_c": 1.0}})
    with pytest.raises(ExportError, match=r"has the factor -9 N/m, and the stiffness"):
        export_mjcf_law(make_model(negative, sliding=(True,)), tmp_path / "friction.xml")
    parfam = make_model(make_law("parfam_tanh"), sliding=(True,))
    (line,) = export_mjcf_law(parfam, tmp_path / "friction.xml", project=True).lines()
    assert re.search(r"\S+ N where fitted and \S+", line)
