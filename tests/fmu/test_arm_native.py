"""The native arm: equal to the arm in Python, with complete states, in any host."""

import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import mujoco
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from mjcf_models import (
    HOME,
    OUTPUTS,
    STEP,
    UF850,
    Unpacked,
    assert_goes_on,
    assert_sampled_within_steps,
    command,
    names,
    run,
    started,
    steps,
)
from oracles.arm import Arm, encoder_error, torque_error

from fmu_src.arm.native import export_mjcf
from fmu_src.arm.plant import Plant
from fmu_src.run.fmu import FmuInstance
from hesr_model.errors import SimulationError
from hesr_model.robots.robot import Robot, RobotDescription

MJCF, TABLE = UF850 / "uf850.xml", UF850 / "arm.toml"
HOST = Path(__file__).with_name("mjcf_host.c")
QUIET = {f"{name}_noise[{i}]": 0.0 for name in ("q", "tau_meas") for i in (1, 2, 3)}


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    return export_mjcf(MJCF, tmp_path_factory.mktemp("arm") / "Arm.fmu", table=TABLE)


@pytest.fixture(scope="module")
def unpacked(fmu, tmp_path_factory):
    return Unpacked(fmu, tmp_path_factory.mktemp("a folder"))


def simulated(fmu, steps, start=HOME):
    with FmuInstance(fmu) as arm:
        arm.initialise(start=start)
        return run(arm, steps).reshape(steps + 1, -1, 3)


def by_name(rows):
    return {name: rows[:, k] for k, name in enumerate(OUTPUTS)}


def test_the_variables_are_complete(fmu):
    with FmuInstance(fmu) as arm:
        variables = arm.description.modelVariables
        assert names(arm, "input") == [f"dq_cmd[{i}]" for i in (1, 2, 3)]
        assert names(arm, "output") == [f"{name}[{i}]" for name in OUTPUTS for i in (1, 2, 3)]
    parameters = {v.name: float(v.start) for v in variables if v.causality == "parameter"}
    assert parameters == {
        "friction_scale": 1.0, "payload": 0.0, "latency": 0.01,
        "noise_seed[1]": 1.0, "noise_seed[2]": 0.0,
        "q0[1]": 0.0, "q0[2]": 0.0, "q0[3]": 0.0,
        "q_noise[1]": 2e-5, "q_noise[2]": 2e-5, "q_noise[3]": 2e-5,
        "tau_meas_noise[1]": 1.5, "tau_meas_noise[2]": 1.5, "tau_meas_noise[3]": 0.6,
    }  # fmt: skip


def test_outputs_do_not_depend_on_inputs_directly(fmu):
    with FmuInstance(fmu) as arm:
        for unknown in arm.description.outputs:
            assert unknown.dependencies == []


def test_the_arm_matches_the_arm_in_python(fmu):
    plant = Plant.read(UF850 / "plant.toml")
    arm, steps = Arm(plant), 1000
    states = [arm.reset([0.0, 0.3, -1.9])]
    states += [arm.step(command(k), STEP) for k in range(steps)]
    found, counter = by_name(simulated(fmu, steps)), np.arange(steps + 1)
    q = np.array([s.q for s in states])
    tau = np.array([s.tau_meas for s in states])
    expected = {
        "q_true": q,
        "dq_true": [s.dq for s in states],
        "tau_true": tau,
        "tau_f_true": [s.tau_f_true for s in states],
        "q": q + encoder_error(plant.noise, counter),
        "tau_meas": tau + torque_error(plant.noise, counter),
    }
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, rtol=0, atol=1e-9, err_msg=name)
    assert np.ptp(found["q_true"], axis=0).min() > 0.2


def test_torques_match_the_rigid_body_library(unpacked):
    model = mujoco.MjModel.from_binary_path(str(unpacked.resources / "model.mjb"))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    model.dof_damping[:] = model.dof_frictionloss[:] = model.actuator_damping[:] = 0
    model.body_gravcomp[:] = 0
    robot = Robot(RobotDescription.read(UF850 / "robot.toml"))
    rng = np.random.default_rng(4)
    q, dq, ddq = (rng.uniform(-a, a, (200, 3)) for a in (2.0, 3.0, 10.0))
    data, found = mujoco.MjData(model), []
    for row in zip(q, dq, ddq, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = row
        mujoco.mj_inverse(model, data)
        found.append(data.qfrc_inverse.copy())
    expected = robot.torque(robot.nominal_parameters, q, dq, ddq)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


# --- parameters -------------------------------------------------------------------------------


def test_the_servo_settles_on_the_weight_of_a_payload(fmu):
    """Gravity compensation ignores it: the integral settles on its weight."""
    robot = Robot(RobotDescription.read(UF850 / "robot.toml"))
    with FmuInstance(fmu) as arm:
        arm.initialise(start=HOME | QUIET | {"payload": 2.0, "friction_scale": 0.05})
        for k in range(2000):
            arm.step(k * STEP, STEP)
        q = arm.get([f"q_true[{i}]" for i in (1, 2, 3)])
        torque = arm.get([f"tau_true[{i}]" for i in (1, 2, 3)])
        friction = arm.get([f"tau_f_true[{i}]" for i in (1, 2, 3)])
    still = np.zeros((1, 3))
    gravity = robot.torque(robot.nominal_parameters, q[None], still, still)[0]
    model = mujoco.MjModel.from_xml_path(str(MJCF))
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    jacobian, body = np.zeros((3, 3)), model.body("payload").id
    mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
    weight = jacobian.T @ [0.0, 0.0, 2.0 * 9.81]
    np.testing.assert_allclose(torque - friction - gravity, weight, atol=1e-3)
    assert abs(weight[1]) > 5.0


def scaled_twin(scale, folder):
    """The MJCF and its table with all friction scaled in the text."""

    def scaled(match):
        numbers = [float(x) for x in match[2].split()]
        forces = numbers[:-1] if match[1] == "lugre" else numbers[:1]
        values = [scale * x for x in forces] + numbers[len(forces) :]
        return f'{match[1]}="{" ".join(map(repr, values))}"'

    mjcf, table = folder / "uf850.xml", folder / "arm.toml"
    mjcf.write_text(re.sub(r'\b(lugre|damping|cogging)="([^"]*)"', scaled, MJCF.read_text()))
    text = TABLE.read_text()
    for viscous in ("joint1_dq = 16.6", "joint2_dq = 12.5", "joint3_dq = 4.0"):
        name, value = viscous.split(" = ")
        assert viscous in text
        text = text.replace(viscous, f"{name} = {scale * float(value)!r}")
    table.write_text(text)
    return export_mjcf(mjcf, folder / "Scaled.fmu", table=table)


def test_the_friction_scale_includes_bristle_damping(tmp_path, monkeypatch):
    """The UF850 has no such damping."""
    damped = tmp_path / "damped.xml"
    damped.write_text(re.sub(r'(lugre="[^ ]+) 0 ', r"\1 40 ", MJCF.read_text()))
    monkeypatch.setitem(globals(), "MJCF", damped)
    fmu = export_mjcf(damped, tmp_path / "Arm.fmu", table=TABLE)
    twin = simulated(scaled_twin(1.7, tmp_path), 300)
    found = simulated(fmu, 300, HOME | {"friction_scale": 1.7})
    np.testing.assert_allclose(found, twin, rtol=0, atol=1e-9)


@pytest.mark.parametrize("scale", [0.5, 1.7])
def test_the_friction_scale_includes_all_friction_of_the_mjcf(scale, fmu, tmp_path):
    expected = simulated(scaled_twin(scale, tmp_path), 300)
    found = simulated(fmu, 300, HOME | {"friction_scale": scale})
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    usual = by_name(simulated(fmu, 300))["tau_f_true"]
    assert np.abs(by_name(found)["tau_f_true"] - usual).max() > 1.0


def test_friction_can_be_switched_off(fmu):
    rows = by_name(simulated(fmu, 100, HOME | {"friction_scale": 0.0}))
    np.testing.assert_allclose(rows["tau_f_true"], 0.0, atol=1e-7)
    assert np.ptp(rows["q_true"], axis=0).min() > 0.01


@pytest.mark.parametrize("milliseconds", [0, 1, 7, 25, 50])
def test_the_latency_delays_commands(milliseconds, fmu):
    with FmuInstance(fmu) as arm:
        arm.initialise(start=HOME | QUIET | {"latency": milliseconds * 1e-3})
        rest = arm.get(["tau_true[1]"])[0]
        arm.set({"dq_cmd[1]": 0.1})
        torque = []
        for k in range(60):
            arm.step(k * 1e-3, 1e-3)
            torque.append(arm.get(["tau_true[1]"])[0] - rest)
    # Read at the end of step k; the command dates from before the first step.
    first = next(k for k, value in enumerate(torque, start=1) if abs(value) > 1e-6)
    assert first == max(milliseconds, 1)


@pytest.mark.parametrize("milliseconds", [0, 1, 7])
def test_the_latency_is_constant_over_time(milliseconds, fmu):
    """Times are sums of steps: round-off would sooner or later shift the latency by one step."""
    start = HOME | QUIET | {"latency": milliseconds * 1e-3}
    late = []
    with FmuInstance(fmu) as still, FmuInstance(fmu, name="other") as other:
        still.initialise(start=start)
        before = [still.get(["tau_true[1]"])[0]]
        for k in range(400):
            still.step(k * 1e-3, 1e-3)
            before.append(still.get(["tau_true[1]"])[0])
        for given in range(3, 400, 37):
            if other.used:
                other.reset()
            other.initialise(start=start)
            for k in range(given + 20):
                if k == given:
                    other.set({"dq_cmd[1]": 0.1})
                other.step(k * 1e-3, 1e-3)
                if other.get(["tau_true[1]"])[0] != before[min(k + 1, 400)]:
                    late.append(k - given + 1)
                    break
    assert late == [max(milliseconds, 1)] * len(range(3, 400, 37))


def test_the_noise_depends_on_seed_and_levels(fmu):
    plain = by_name(simulated(fmu, 20, HOME))
    other = by_name(simulated(fmu, 20, HOME | {"noise_seed[2]": 1.0}))
    loud = by_name(simulated(fmu, 20, HOME | {"q_noise[2]": 4e-5}))
    assert np.all(plain["q"] != other["q"])
    np.testing.assert_array_equal(plain["q_true"], other["q_true"])
    noise = plain["q"] - plain["q_true"]
    np.testing.assert_allclose((loud["q"] - loud["q_true"])[:, 1], 2 * noise[:, 1], atol=1e-15)
    np.testing.assert_array_equal(loud["q"][:, 0], plain["q"][:, 0])


@pytest.mark.parametrize(
    ("start", "sentence"),
    [
        ({"latency": 0.051}, r"latency is 0\.051 s; .* hold 0\.05 s"),
        ({"latency": -0.001}, r"latency is -0\.001; it must not be negative\."),
        ({"friction_scale": -1.0}, r"friction_scale is -1; it must not be negative\."),
        ({"payload": -2.0}, r"payload is -2; it must not be negative\."),
        ({"q_noise[2]": -1.0}, r"q_noise\[2\] is -1; it must not be negative\."),
    ],
)
def test_meaningless_parameters_are_refused(start, sentence, fmu):
    with FmuInstance(fmu) as arm:
        with pytest.raises(SimulationError, match=sentence):
            arm.initialise(start=start)
        arm.reset()
        arm.initialise()
        arm.step(0.0, STEP)


@pytest.mark.parametrize("value", [0.5, 2.0**31, -(2.0**31) - 1.0])
def test_halves_of_the_seed_are_integers(value, fmu):
    sentence = (
        r"'noise_seed\[2\]' is of type Integer; it cannot be .*from -2147483648 to 2147483647\."
    )
    with FmuInstance(fmu) as arm, pytest.raises(SimulationError, match=sentence):
        arm.variables.expand_values({"noise_seed": (0, value)})


def test_any_step_ends_at_the_last_multiple_of_mujocos_own(fmu):
    assert_sampled_within_steps(fmu)


def test_too_many_steps_are_refused_and_the_next_step_succeeds(fmu):
    with FmuInstance(fmu) as arm:
        arm.initialise()
        with pytest.raises(SimulationError, match=r"at most 1e\+06 are made"):
            arm.step(0.0, 1500.0)
        arm.step(0.0, STEP)


def test_inputs_that_mujoco_would_zero_are_refused(fmu):
    with FmuInstance(fmu) as arm:
        arm.initialise()
        arm.set({"dq_cmd[2]": 2e10})
        with pytest.raises(SimulationError, match=r"dq_cmd\[2\] is 2e\+10; the largest that"):
            arm.step(0.0, STEP)
    with FmuInstance(fmu) as arm:
        arm.initialise()
        arm.set({"dq_cmd[3]": -2e10})
        with pytest.raises(SimulationError, match=r"dq_cmd\[3\] is -2e\+10; the largest that"):
            arm.step(0.0, STEP)


# --- states -----------------------------------------------------------------------------------


PARAMETERS = [
    {"payload": 1.5, "friction_scale": 0.8, "latency": 0.02},
    {"payload": 0.0, "friction_scale": 0.0, "latency": 0.0},
]


@pytest.mark.parametrize("parameters", PARAMETERS)
def test_a_saved_state_resumes_bit_for_bit_in_any_instance(parameters, unpacked):
    assert_goes_on(unpacked, HOME | parameters)


def test_a_state_resumes_in_another_process(fmu, tmp_path):
    script = """
import ctypes, sys
from pathlib import Path
import mjcf_models as t
from mjcf_models import HOME, Unpacked
fmu, folder, file, todo = (Path(a) for a in sys.argv[1:])
binary, state = Unpacked(fmu, folder), ctypes.c_void_p()
if todo.name == "save":
    c = t.started(binary, HOME | {"payload": 1.0})
    t.steps(binary, c, 0, 30)
    binary("GetFMUstate", c, ctypes.byref(state))
    size = ctypes.c_size_t()
    binary("SerializedFMUstateSize", c, state, ctypes.byref(size))
    data = ctypes.create_string_buffer(size.value)
    binary("SerializeFMUstate", c, state, data, size)
    file.write_bytes(data.raw)
else:
    c, data = binary.instantiate(), file.read_bytes()
    assert binary("DeSerializeFMUstate", c, data, len(data), ctypes.byref(state)) == 0
    assert binary("SetFMUstate", c, state) == 0
sys.stdout.write(repr(t.steps(binary, c, 30, 60)))
"""
    answers = [
        subprocess.run(
            [sys.executable, "-c", script, fmu, tmp_path / todo, tmp_path / "state", todo],
            capture_output=True,
            text=True,
            check=True,
            cwd=Path(__file__).parent,
            env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])},
        ).stdout
        for todo in ("save", "load")
    ]
    assert answers[0] == answers[1] != ""


def test_a_reset_restores_the_start(unpacked):
    c = started(unpacked, HOME | {"payload": 1.5, "latency": 0.03})
    steps(unpacked, c, 0, 40)
    assert unpacked("Reset", c) == 0
    assert unpacked.set_all(c, HOME) == 0
    assert unpacked("SetupExperiment", c, 0, 0.0, 0.0, 0, 0.0) == 0
    assert unpacked("EnterInitializationMode", c) == 0
    assert unpacked("ExitInitializationMode", c) == 0
    assert steps(unpacked, c, 0, 40) == steps(unpacked, started(unpacked, HOME), 0, 40)


def test_instances_are_independent(unpacked):
    alone = {k: steps(unpacked, started(unpacked, {"q0[2]": 0.01 * k}), 0, 20) for k in range(20)}
    together = {k: started(unpacked, {"q0[2]": 0.01 * k}) for k in range(20)}
    found = {k: [] for k in together}
    for n in range(20):
        for k, c in together.items():
            found[k] += steps(unpacked, c, n, n + 1)
    assert found == alone
    for c in together.values():
        unpacked("FreeInstance", c)


def test_instances_run_in_threads(unpacked):
    instances = [started(unpacked, HOME) for _ in range(8)]
    with ThreadPoolExecutor(4) as pool:
        rows = list(pool.map(lambda c: steps(unpacked, c, 0, 200), instances))
    for other in rows[1:]:
        assert other == rows[0]


# --- archive -----------------------------------------------------------------------------------


def test_the_fmu_is_valid_and_reproducible(fmu, tmp_path):
    assert validate_fmu(str(fmu)) == []
    again = export_mjcf(MJCF, tmp_path / "Arm.fmu", table=TABLE)
    assert again.read_bytes() == fmu.read_bytes()


def test_another_mass_gives_another_guid(unpacked, tmp_path):
    other = tmp_path / "uf850.xml"
    other.write_text(MJCF.read_text().replace('mass="4.807"', 'mass="4.808"'))
    fmu = export_mjcf(other, tmp_path / "Arm.fmu", table=TABLE)
    assert Unpacked(fmu, tmp_path / "x").about.guid != unpacked.about.guid
