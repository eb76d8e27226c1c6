"""Any MJCF as an FMU compared with MuJoCo in Python, with and without a signal table."""

import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from mjcf_models import CART_POLE, CART_POLE_TABLE, PENDULUM, names

from fmu_src.arm.native import export_mjcf
from fmu_src.run.fmu import FmuInstance
from hesr_model.errors import ConfigError, ExportError, SimulationError
from hesr_model.logs.noise import standard_normal
from hesr_model.robots.robot import Robot

sys.path.append(str(Path(__file__).parent / "plant"))
from plant_robots import ur_like

DT = 0.01


@pytest.fixture
def export(tmp_path):
    def make(mjcf, table=None):
        model, rows = tmp_path / "model.xml", None
        model.write_text(mjcf)
        if table is not None:
            rows = tmp_path / "table.toml"
            rows.write_text(table)
        return export_mjcf(model, tmp_path / "Model.fmu", table=rows)

    return make


class Reference:
    """MuJoCo in Python."""

    def __init__(self, mjcf, **qpos):
        self.model = mujoco.MjModel.from_xml_string(mjcf)
        self.data = mujoco.MjData(self.model)
        for name, value in qpos.items():
            self.data.joint(name).qpos = value
        mujoco.mj_forward(self.model, self.data)

    def step(self, **control):
        for name, value in control.items():
            self.data.actuator(name).ctrl = value
        mujoco.mj_step(self.model, self.data, nstep=round(DT / self.model.opt.timestep))
        guess = self.data.qacc_warmstart.copy()
        mujoco.mj_forward(self.model, self.data)
        self.data.qacc_warmstart[:] = guess

    def __getattr__(self, name):
        return self.data.sensor(name).data


def units(component):
    return {v.name: v.unit for v in component.description.modelVariables}


def test_a_pendulum_works_without_a_table(export):
    fmu = export(PENDULUM)
    reference = Reference(PENDULUM, pivot=0.6)
    with FmuInstance(fmu) as pendulum:
        assert names(pendulum, "input") == ["pivot"]
        # A sensor with the same name, one with three values and one without a name.
        outputs = ["pivot_2", "bob_at[1]", "bob_at[2]", "bob_at[3]", "sensor3"]
        assert names(pendulum, "output") == outputs
        assert names(pendulum, "parameter") == ["start_pivot"]
        assert [units(pendulum)[n] for n in (*outputs, "start_pivot")] == [
            "rad", "m", "m", "m", "N.m", "rad",
        ]  # fmt: skip
        assert pendulum.description.modelName == "pendulum"
        pendulum.initialise(start={"start_pivot": 0.6})
        for k in range(300):
            expected = [reference.pivot[0], *reference.data.sensordata[1:]]
            np.testing.assert_allclose(pendulum.get(outputs), expected, rtol=0, atol=1e-12)
            control = np.sin(0.1 * k)
            pendulum.set({"pivot": control})
            pendulum.step(k * DT, DT)
            reference.step(pivot=control)


def test_a_cart_pole_with_limits_works_without_a_table(export):
    """Limits are constraints, which MuJoCo solves iteratively from an initial guess."""
    fmu, reference = export(CART_POLE), Reference(CART_POLE, slider=0.2, hinge=0.3)
    with FmuInstance(fmu) as cart:
        assert names(cart, "input") == ["left", "right", "spring"]
        outputs = ["x", "dx", "angle", "acc[1]", "acc[2]", "acc[3]"]
        assert names(cart, "output") == outputs
        cart.initialise(start={"start_slider": 0.2, "start_hinge": 0.3})
        furthest = 0.0
        for k in range(400):
            found = cart.get(outputs)
            np.testing.assert_allclose(found, reference.data.sensordata, rtol=1e-9, atol=1e-9)
            control = {"left": 0.5 * np.sin(0.02 * k), "right": 0.1, "spring": 0.4}
            cart.set(control)
            cart.step(k * DT, DT)
            reference.step(**control)
            furthest = max(furthest, abs(found[0]))
    assert furthest > 0.95


def test_a_cart_pole_works_with_a_table(export):
    """Inputs of several actuators, outputs of several sensors, noise."""
    fmu, reference = export(CART_POLE, CART_POLE_TABLE), Reference(CART_POLE, slider=0.1, hinge=0.3)
    assert validate_fmu(str(fmu)) == []
    seed = 2**64 - 3
    with FmuInstance(fmu) as cart:
        assert names(cart, "input") == ["u[1]", "u[2]"]
        assert names(cart, "output") == ["mixed[1]", "mixed[2]", "angle[1]"]
        assert names(cart, "parameter") == [
            "payload", "noise_seed[1]", "noise_seed[2]", "begin[1]", "begin[2]",
            "mixed_noise[1]", "mixed_noise[2]", "angle_noise[1]",
        ]  # fmt: skip
        assert float(cart.description.defaultExperiment.stepSize) == DT
        cart.initialise(start={"begin[1]": 0.3, "begin[2]": 0.1})
        for k in range(200):
            x, dx, angle = (float(reference.data.sensor(n).data[0]) for n in ("x", "dx", "angle"))
            expected = [
                x - 0.5 * angle + 0.01 * standard_normal(seed, 7, k),
                2.5 * x + dx + 3 * angle,
                angle + 0.2 * standard_normal(seed, 2, k),
            ]
            found = cart.get(["mixed[1]", "mixed[2]", "angle[1]"])
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
            force, spring = 0.2 * np.cos(0.05 * k), 0.3
            cart.set({"u[1]": force, "u[2]": spring})
            cart.step(k * DT, DT)
            reference.step(left=force, right=force, spring=spring)


def test_a_payload_is_a_mass_at_the_centre_of_its_body(export):
    fmu = export(CART_POLE, CART_POLE_TABLE)
    heavy = Reference(CART_POLE, hinge=0.3)
    heavy.model.body("pole").mass += 0.5
    mujoco.mj_setConst(heavy.model, heavy.data)
    mujoco.mj_resetData(heavy.model, heavy.data)
    heavy.data.joint("hinge").qpos = 0.3
    mujoco.mj_forward(heavy.model, heavy.data)
    quiet = {"mixed_noise[1]": 0.0, "angle_noise[1]": 0.0}
    with FmuInstance(fmu) as cart:
        cart.initialise(start=quiet | {"begin[1]": 0.3, "payload": 0.5})
        for k in range(100):
            np.testing.assert_allclose(cart.get(["angle[1]"]), heavy.angle, rtol=0, atol=1e-9)
            cart.step(k * DT, DT)
            heavy.step()


def test_actuators_keep_their_different_delays(export):
    mjcf = CART_POLE.replace('gear="10"', 'gear="10" delay="0.02" nsample="9"').replace(
        'gear="-4"', 'gear="-4" delay="0.04" nsample="9"'
    )
    with FmuInstance(export(mjcf)) as cart:
        assert "latency" not in names(cart, "parameter")
        cart.initialise()
        cart.set({"left": 1.0})
        cart.step(0.0, 0.015)
        assert cart.get(["dx"])[0] == 0.0
        cart.step(0.015, 0.02)
        assert cart.get(["dx"])[0] > 0.0


UNSTABLE = PENDULUM.replace('damping="0.1"', 'stiffness="-1e9"')
CROWDED = (
    '<mujoco model="crowd"><size memory="20K"/><worldbody><geom type="plane" size="1 1 1"/>'
    + "".join(
        f'<body pos="0 0 {0.3 + 0.25 * i}"><joint type="slide" axis="0 0 1" name="z{i}"/>'
        '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
        '<geom size=".1 .1 .1" type="box"/></body>'
        for i in range(6)
    )
    + '</worldbody><sensor><jointpos name="z" joint="z0"/></sensor></mujoco>'
)


@pytest.mark.parametrize(
    ("mjcf", "output", "sentence"),
    [
        (UNSTABLE, "pivot_2", "MuJoCo: Nan, Inf or huge value in QACC at DOF 0"),
        (
            UNSTABLE.replace("<option", '<option><flag autoreset="disable"/></option><option'),
            "pivot_2",
            "MuJoCo: Nan, Inf or huge value in QACC at DOF 0",
        ),
        # MuJoCo's default ends the process here.
        (CROWDED, "z", "MuJoCo: mj_stackAlloc: out of memory"),
        (CROWDED.replace("20K", "6K"), "z", "MuJoCo: Insufficient arena memory"),
    ],
)
def test_fatal_errors_of_mujoco_are_reported(
    mjcf, output, sentence, export, tmp_path, monkeypatch, capfd
):
    fmu = export(mjcf)
    place = tmp_path / "empty"
    place.mkdir()
    monkeypatch.chdir(place)

    def steps(component, rows):
        for k in range(400):
            rows.append(component.get([output])[0])
            component.step(k * DT, DT)

    def go(component):
        rows = []
        with pytest.raises(SimulationError, match=sentence):
            steps(component, rows)
        assert component.get([output])[0] == rows[-1]
        return rows

    with FmuInstance(fmu) as component:
        start = {"start_pivot": 0.1} if "start_pivot" in names(component, "parameter") else {}
        component.initialise(start=start)
        state = component._instance.slave.getFMUState()
        first = go(component)
        component._instance.slave.setFMUState(state)
        assert go(component) == first
        component._instance.slave.freeFMUState(state)
        component.reset()
        component.initialise(start=start)
        assert go(component) == first
    assert list(place.iterdir()) == []
    assert capfd.readouterr() == ("", "")


# --- refusals ----------------------------------------------------------------------------------


TABLE_ERRORS = [
    ('["left", "right"]', '["left", "up"]', "the model has no actuator 'up'"),
    ("angle = -0.5", "tilt = -0.5", "the model has no sensor 'tilt'"),
    ("{ angle = 1 }", "{ acc = 1 }", "sensor 'acc' has 3 numbers; expected exactly one"),
    ('payload = "pole"', 'payload = "box"', "the model has no body 'box'"),
    ('["hinge", "slider"]', '["elbow"]', "the model has no joint 'elbow'"),
    ("step = 0.01", 'friction = ["left"]', "actuator 'left' is not a dcmotor"),
    ('["hinge", "slider"]', '["hinge"]\nintegrals = ["left"]', "'left' is not an integral"),
    ('["hinge", "slider"]', '["hinge"]\nintegrals = ["left", "left"]',
     "integrals has 2 entries; 1 are needed"),
    ('["hinge", "slider"]', '["hinge"]\nhold = true', "'start.begin.hold' needs 'integrals'"),
    ("noise = [0.2]", "noise = [0.2, 0.1]", "noise has 2 entries; 1 are needed"),
    ("noise = [0.2]", "noise = [-0.2]", "greater than or equal to 0"),
    ("noise = [0.2]", "nois = [0.2]", "unknown key 'outputs.angle.nois'"),
    ('unit = "rad"', 'unit = "turns"', "unit 'turns'"),
    ("[outputs.angle]", "[outputs.u]", "variable name 'u[1]' is used twice"),
    ("[outputs.angle]", "[outputs.2x]", "2x"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "sentence"), TABLE_ERRORS)
def test_an_inconsistent_table_is_refused(old, new, sentence, export, tmp_path):
    assert old in CART_POLE_TABLE
    with pytest.raises((ConfigError, ExportError)) as caught:
        export(CART_POLE, CART_POLE_TABLE.replace(old, new))
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "Model.fmu").exists()


def test_a_file_without_sensors_receives_those_of_its_joints(export):
    start, end = CART_POLE.index("<sensor>"), CART_POLE.index("</mujoco>")
    with FmuInstance(export(CART_POLE[:start] + CART_POLE[end:])) as cart:
        assert names(cart, "output") == ["q_slider", "dq_slider", "tau_slider",
                                         "q_hinge", "dq_hinge", "tau_hinge"]  # fmt: skip
        assert [units(cart)[n] for n in ("q_slider", "dq_hinge", "tau_slider")] == [
            "m",
            "rad/s",
            "N",
        ]
        assert not any(name.startswith("tau_") for name in names(cart, "input"))


def test_a_urdf_is_driven_by_torques(tmp_path):
    """Its first acceleration is that of the rigid bodies."""
    path = ur_like(tmp_path)
    robot = Robot(path)
    q, tau = np.array([0.3, -0.8, 1.2, 0.4, 0.5, 0.1]), np.array([9.0, -40.0, 20.0, 3.0, 2.0, 1.0])
    mass, bias = robot.dynamics(robot.nominal_parameters, q[None], np.zeros((1, 6)))
    expected = np.linalg.solve(mass[0], tau - bias[0])
    with FmuInstance(export_mjcf(path, tmp_path / "Arm.fmu")) as arm:
        inputs = [f"tau_j{i}" for i in range(1, 7)]
        assert names(arm, "input") == inputs
        assert {units(arm)[name] for name in inputs} == {"N.m"}
        arm.initialise(start={f"start_j{i + 1}": float(x) for i, x in enumerate(q)})
        arm.set(dict(zip(inputs, tau.tolist(), strict=True)))
        step = arm.description.defaultExperiment.stepSize
        arm.step(0.0, float(step))
        found = np.array(arm.get([f"dq_j{i}" for i in range(1, 7)])) / float(step)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_joints_and_sensors_with_several_values_are_refused(export):
    ball = CART_POLE.replace('name="hinge" axis="0 1 0"', 'name="hinge" type="ball"')
    ball = ball.replace('<position name="spring" joint="hinge" kp="2"/>', "")
    ball = ball.replace('<jointpos name="angle" joint="hinge"/>', "")
    with FmuInstance(export(ball)) as cart:
        assert names(cart, "parameter") == ["start_slider"]
    table = '[outputs.x]\nunit = "m"\nsensors = [{ x = 1 }]\n[start.q]\nunit = "rad"\n'
    with pytest.raises(ConfigError, match="joint 'hinge' is not a hinge"):
        export(ball, table + 'joints = ["hinge"]\n')


def test_unsuitable_models_are_refused(export, tmp_path):
    ball = (
        '<mujoco><worldbody><body><joint type="ball"/><geom size="1"/></body></worldbody></mujoco>'
    )
    with pytest.raises(ConfigError, match="neither a sensor nor a hinge"):
        export(ball)
    with pytest.raises(ConfigError, match="cannot be compiled as an MJCF"):
        export("<mujoco><nonsense/></mujoco>")
    with pytest.raises(ConfigError, match="no such model file"):
        export_mjcf(tmp_path / "none.xml", tmp_path / "M.fmu")
    (tmp_path / "m.xml").write_text(PENDULUM)
    with pytest.raises(ConfigError, match="no such file"):
        export_mjcf(tmp_path / "m.xml", tmp_path / "M.fmu", table=tmp_path / "none.toml")


def test_a_model_with_plugins_is_refused(export):
    mjcf = PENDULUM.replace(
        "<worldbody>",
        '<extension><plugin plugin="mujoco.pid"/></extension><worldbody>',
    ).replace(
        '<motor name="pivot" joint="pivot" gear="2"/>',
        '<plugin name="pivot" joint="pivot" plugin="mujoco.pid"><config key="kp" value="1"/>'
        "</plugin>",
    )
    with pytest.raises(ExportError, match="plugins of MuJoCo are not supported"):
        export(mjcf)


def test_unusual_names_become_valid_in_fmi(export):
    mjcf = PENDULUM.replace('<motor name="pivot"', '<motor name="1st/Ünit"')
    mjcf = mjcf.replace('model="pendulum"', 'model="2 arms"')
    with FmuInstance(export(mjcf)) as pendulum:
        assert names(pendulum, "input") == ["_1st__nit"]
        assert pendulum.description.coSimulation.modelIdentifier == "_2_arms"
        pendulum.initialise()
