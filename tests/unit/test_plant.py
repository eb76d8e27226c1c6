"""The twin against independent references: Pinocchio, exact relaxation, the servo's equation."""

import mujoco
import numpy as np
import pinocchio
import pytest
from oracles.arm import Arm, encoder_error, torque_error
from scipy.linalg import qr

from fmu_src.arm.plant import Plant, servo_signals
from hesr_model.errors import ConfigError, SimulationError
from hesr_model.support.files import models_folder

FOLDER = models_folder() / "uf850"
MJCF = FOLDER / "uf850.xml"
STEP = 1e-3
HOME = np.array([0.0, 0.3, -1.9])

COULOMB = np.array([9.6, 12.1, 5.5])
STATIC = COULOMB * np.array([1.35, 1.30, 1.35])
STRIBECK = np.array([0.08, 0.10, 0.07])
VISCOUS = np.array([16.6, 12.5, 4.0])
RIPPLE, CYCLES = np.array([0.5, 0.5, 0.3]), 202
WEIGHT = np.array([0.4, 0.3, 0.2, 0.1])
DEFLECTION = np.array([0.5e-3, 1.5e-3, 4e-3, 8e-3])
STIFFNESS = STATIC[:, None] * WEIGHT / DEFLECTION
ARMATURE = np.array([0.8, 0.8, 0.35])
KV = np.array([90.5, 150.8, 52.8])
KI = KV / 0.1
LIMIT = np.array([200.0, 200.0, 90.0])


@pytest.fixture(scope="module")
def plant():
    return Plant.read(FOLDER / "plant.toml")


@pytest.fixture
def arm(plant):
    return Arm(plant)


@pytest.fixture(scope="module")
def simulator():
    return mujoco.MjModel.from_xml_path(str(MJCF))


@pytest.fixture(scope="module")
def kinematics():
    return pinocchio.buildModelFromMJCF(str(MJCF))


def random_states(model, count):
    rng = np.random.default_rng(0)
    q = rng.uniform(model.lowerPositionLimit, model.upperPositionLimit, (count, 3))
    return q, rng.uniform(-3, 3, (count, 3)), rng.uniform(-10, 10, (count, 3))


# --- rigid body -------------------------------------------------------------------------------


def test_simulator_and_rigid_body_library_agree_on_inverse_dynamics(simulator, kinematics):
    data, reference = mujoco.MjData(simulator), kinematics.createData()
    np.testing.assert_array_equal(kinematics.armature, ARMATURE)
    for q, dq, ddq in zip(*random_states(kinematics, 200), strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
        mujoco.mj_inverse(simulator, data)
        torque = data.qfrc_inverse + data.qfrc_passive
        expected = pinocchio.rnea(kinematics, reference, q, dq, ddq)
        np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-9)


def test_rotor_inertias_are_part_of_the_reference(kinematics):
    state = [HOME, np.zeros(3), np.ones(3)]
    with_rotors = pinocchio.rnea(kinematics, kinematics.createData(), *state)
    bare = kinematics.copy()
    bare.armature = np.zeros(3)
    without = pinocchio.rnea(bare, bare.createData(), *state)
    np.testing.assert_allclose(with_rotors - without, ARMATURE, atol=1e-12)


def test_gravity_torque_at_zero_is_that_of_the_whole_arm(kinematics):
    torque = pinocchio.computeGeneralizedGravity(kinematics, kinematics.createData(), np.zeros(3))
    np.testing.assert_allclose(torque, [0.0, 8.204, -8.207], atol=5e-4)


def test_mass_and_limits_match_the_data_sheet(kinematics, arm):
    moving = 4.807 + 3.280 + 2.237 + 2.041 + 1.385 + 0.225
    assert sum(body.mass for body in kinematics.inertias[1:]) == pytest.approx(moving, abs=1e-12)
    limits = [[-6.283185307, 6.283185307], [-2.3038346, 2.3038346], [-4.2236968, 0.061087]]
    np.testing.assert_array_equal(arm.limits, limits)
    np.testing.assert_array_equal(kinematics.lowerPositionLimit, arm.limits[:, 0])
    np.testing.assert_array_equal(kinematics.upperPositionLimit, arm.limits[:, 1])


def test_regressor_has_rank_15_of_30(kinematics):
    data = kinematics.createData()
    rows = [
        pinocchio.computeJointTorqueRegressor(kinematics, data, *state)
        for state in zip(*random_states(kinematics, 200), strict=True)
    ]
    regressor = np.vstack(rows)
    assert regressor.shape[1] == 30
    sizes = np.abs(np.diag(qr(regressor, mode="r", pivoting=True)[0]))
    assert np.sum(sizes > 1e-4 * sizes[0]) == 15
    assert np.sum(sizes > 1e-12 * sizes[0]) == 15


def test_mujoco_joints_have_no_friction(simulator):
    assert not simulator.dof_damping.any()
    assert not simulator.dof_frictionloss.any()


# --- true friction ----------------------------------------------------------------------------


def slide(simulator, path, velocity):
    """Move the joints along a path; return friction torque (N, n) and bristles (N, n, 4).

    Both arguments are (N, n); positive friction opposes positive velocity.
    """
    data = mujoco.MjData(simulator)
    elements = [
        simulator.actuator(f"joint{joint}_friction{k}").id
        for joint in (1, 2, 3)
        for k in (1, 2, 3, 4)
    ]
    bristles = simulator.actuator_actadr[elements]
    torque, states = [], []
    for q, dq in zip(path, velocity, strict=True):
        data.qpos[:], data.qvel[:] = q, dq
        mujoco.mj_forward(simulator, data)
        parts = data.actuator_force[elements].reshape(3, 4)
        torque.append(-parts.sum(axis=1) - data.qfrc_damper)
        states.append(data.act[bristles].reshape(3, 4).copy())
        mujoco.mj_step(simulator, data)
    return np.array(torque), np.array(states)


def curve(dq):
    """The Stribeck curve, (..., n)."""
    return COULOMB + (STATIC - COULOMB) * np.exp(-((dq / STRIBECK) ** 2))


def ripple(q):
    """Ripple torque opposing the motion."""
    return -RIPPLE * np.sin(CYCLES * q)


def constant(speed, count):
    velocity = np.full((count, 3), speed)
    return HOME + velocity * STEP * np.arange(count)[:, None], velocity


@pytest.mark.parametrize("speed", [0.01, 0.05, 0.3, 1.2, -0.05, -1.2])
def test_steady_sliding_is_stribeck_plus_viscous_plus_ripple(simulator, speed):
    path, velocity = constant(speed, 3000 if abs(speed) > 0.02 else 9000)
    torque, _ = slide(simulator, path, velocity)
    expected = np.sign(speed) * curve(speed) + VISCOUS * speed + ripple(path[-1])
    np.testing.assert_allclose(torque[-1], expected, atol=1e-3)


def test_bristles_relax_exactly(simulator):
    t = STEP * np.arange(3000)
    velocity = 0.4 * np.sin(2 * np.pi * t[:, None] * np.array([0.7, 1.1, 1.6])) + 1e-3
    path = HOME + STEP * np.cumsum(velocity, axis=0)
    _, states = slide(simulator, path, velocity)
    x = np.zeros((3, 4))
    for k, dq in enumerate(velocity):
        np.testing.assert_allclose(states[k], x, rtol=1e-12, atol=1e-16)
        drive = dq[:, None]
        z = STEP * STIFFNESS * np.abs(drive) / (curve(dq)[:, None] * WEIGHT)
        x = x * np.exp(-z) + drive * STEP * -np.expm1(-z) / z


def test_break_away_peaks_at_static_friction_and_falls_to_coulomb(simulator):
    # A slow ramp: break-away occurs well below the Stribeck velocity.
    velocity = np.tile(0.1 * STEP * np.arange(8000)[:, None], (1, 3))
    path = HOME + STEP * np.cumsum(velocity, axis=0)
    torque, _ = slide(simulator, path, velocity)
    friction = torque - VISCOUS * velocity - ripple(path)
    # The stiff elements already slide faster when the soft elements break away.
    assert np.all(friction.max(axis=0) > 0.8 * STATIC)
    assert np.all(friction.max(axis=0) > 1.05 * COULOMB)
    assert np.all(friction.max(axis=0) <= STATIC)
    np.testing.assert_allclose(friction[-1], COULOMB, atol=1e-2)


def test_break_away_without_acceleration_reaches_static_friction(simulator):
    path, velocity = constant(2e-3, 40_000)
    torque, _ = slide(simulator, path, velocity)
    friction = torque - VISCOUS * velocity - ripple(path)
    np.testing.assert_allclose(friction.max(axis=0), STATIC, rtol=1e-3)


def test_initial_stiffness_is_that_of_all_elements(simulator):
    path, velocity = constant(1e-3, 5)
    torque, _ = slide(simulator, path, velocity)
    friction = torque - VISCOUS * velocity - ripple(path)
    slope = friction[1] / (path[1] - path[0])
    np.testing.assert_allclose(slope, STIFFNESS.sum(axis=1), rtol=2e-3)


def test_memory_depends_on_the_path_and_not_on_its_speed(simulator):
    def loop(speed):
        """20 mrad forwards, 1 mrad back, 0.5 mrad forwards, 4 mrad back; equal corner positions."""
        moves = [(0.020, 1), (0.001, -1), (0.0005, 1), (0.004, -1)]
        velocity = np.concatenate(
            [np.full(round(way / speed / STEP), sign * speed) for way, sign in moves]
        )
        velocity = np.tile(velocity[:, None], (1, 3))
        path = HOME + STEP * np.cumsum(velocity, axis=0) - STEP * velocity
        torque, _ = slide(simulator, path, velocity)
        friction = torque - VISCOUS * velocity - ripple(path)
        corners = np.cumsum([round(way / speed / STEP) for way, _ in moves]) - 1
        return friction[corners]

    slow, fast = loop(0.5e-3), loop(1e-3)
    np.testing.assert_allclose(fast, slow, atol=0.02 * STATIC.max())
    # After 1 mrad backwards the stiff element has yielded, the soft ones have not: no common sign.
    assert np.all(np.abs(slow[1]) < 0.7 * STATIC)


def test_ripple_has_the_stated_amplitude_and_period(simulator):
    turn = 2 * np.pi / CYCLES
    speed = turn / 0.1
    path, velocity = constant(speed, 1000)
    torque, _ = slide(simulator, path, velocity)
    last = torque[-200:] - torque[-200:].mean(axis=0)
    spectrum = 2 / 200 * np.abs(np.fft.rfft(last, axis=0))
    np.testing.assert_allclose(spectrum[2], RIPPLE, atol=2e-3)
    assert np.delete(spectrum, 2, axis=0).max() < 2e-3


# --- servo ------------------------------------------------------------------------------------


def test_the_arm_rests_at_its_start(arm):
    before = arm.reset(HOME)
    for _ in range(200):
        after = arm.step(np.zeros(3), 5e-3)
    np.testing.assert_allclose(after.q, HOME, atol=1e-12)
    np.testing.assert_allclose(after.dq, 0.0, atol=1e-12)
    np.testing.assert_allclose(after.tau_meas, before.tau_meas, atol=1e-9)


def test_torque_at_rest_is_gravity_and_ripple(arm, kinematics):
    output = arm.reset(HOME)
    gravity = pinocchio.computeGeneralizedGravity(kinematics, kinematics.createData(), HOME)
    np.testing.assert_allclose(output.tau_f_true, ripple(HOME), atol=1e-12)
    np.testing.assert_allclose(output.tau_meas, gravity + ripple(HOME), atol=1e-9)


def test_command_acts_after_ten_milliseconds(arm):
    start = arm.reset(np.zeros(3))
    torque = np.array([arm.step([0.1, 0.1, 0.1], STEP).tau_meas for _ in range(12)])
    np.testing.assert_allclose(torque[:9], np.tile(start.tau_meas, (9, 1)), atol=1e-9)
    np.testing.assert_allclose(torque[9] - start.tau_meas, 0.1 * KV, atol=1e-9)


def test_servo_is_a_velocity_pi(arm, kinematics):
    arm.reset(HOME)
    data, command, integral = kinematics.createData(), [], HOME + ripple(HOME) / KI
    t = STEP * np.arange(400)
    for k, now in enumerate(t):
        command.append(0.5 * np.sin(2 * np.pi * now + np.arange(3)))
        output = arm.step(command[-1], STEP)
        seen = command[k - 10] if k >= 10 else np.zeros(3)
        integral = integral + STEP * seen
        seen_now = command[k - 9] if k >= 9 else np.zeros(3)
        expected = KV * (seen_now - output.dq) + KI * (integral - output.q)
        expected += pinocchio.computeGeneralizedGravity(kinematics, data, output.q)
        np.testing.assert_allclose(output.tau_meas, expected, atol=1e-8)


def test_measured_torque_is_rigid_body_plus_friction(arm, kinematics):
    arm.reset(HOME)
    data = kinematics.createData()
    for k in range(300):
        output = arm.step(0.8 * np.sin(0.03 * k * np.array([0.6, 0.8, 1.1])), 5e-3)
        acceleration = arm._data.qacc.copy()
        rigid = pinocchio.rnea(kinematics, data, output.q, output.dq, acceleration)
        np.testing.assert_allclose(output.tau_meas, rigid + output.tau_f_true, atol=1e-9)


def test_acceleration_is_the_derivative_of_velocity(arm):
    arm.reset(HOME)
    speeds, accelerations = [], []
    for k in range(1500):
        output = arm.step(0.8 * np.sin(0.006 * k * np.array([0.6, 0.8, 1.1])), STEP)
        speeds.append(output.dq)
        accelerations.append(arm._data.qacc.copy())
    difference = np.gradient(speeds, STEP, axis=0)[500:-1] - accelerations[500:-1]
    assert np.sqrt(np.mean(difference**2)) < 0.05


def test_friction_of_the_arm_is_the_sum_of_its_elements(arm, simulator):
    arm.reset(HOME)
    for k in range(200):
        output = arm.step(np.sin(0.01 * k) * np.ones(3), 5e-3)
    data = arm._data
    parts = [
        sum(data.sensor(f"joint{joint}_friction{k}").data[0] for k in (1, 2, 3, 4))
        for joint in (1, 2, 3)
    ]
    np.testing.assert_allclose(output.tau_f_true, VISCOUS * output.dq - parts, atol=1e-12)


def test_torque_limit_holds_for_the_servo_and_not_for_friction(arm, kinematics):
    arm.reset(HOME)
    data, servo = kinematics.createData(), []
    for k in range(400):
        output = arm.step(np.full(3, 3.0 if k < 200 else -3.0), STEP)
        gravity = pinocchio.computeGeneralizedGravity(kinematics, data, output.q)
        servo.append(output.tau_meas - gravity)
    peaks = np.abs(servo).max(axis=0)
    np.testing.assert_allclose(peaks, LIMIT, atol=1e-9)


def test_integral_does_not_wind_up_beyond_the_range(arm):
    arm.reset(HOME)
    for _ in range(1200):
        output = arm.step([0.0, 0.0, 1.0], 5e-3)
    # Proportional and integral part balance 0.1 s of the command beyond the bound.
    assert output.q[2] < arm.limits[2, 1] + 0.1
    for _ in range(200):
        output = arm.step([0.0, 0.0, -1.0], 5e-3)
    assert output.q[2] < arm.limits[2, 1] - 0.9


# --- stepping ---------------------------------------------------------------------------------


def test_one_long_step_equals_many_short_ones(plant):
    one, many = Arm(plant), Arm(plant)
    one.reset(HOME)
    many.reset(HOME)
    for k in range(40):
        command = 0.3 * np.sin(0.2 * k + np.arange(3))
        long = one.step(command, 5e-3)
        for _ in range(5):
            short = many.step(command, STEP)
    for name in ("q", "dq", "tau_meas", "tau_f_true"):
        assert np.array_equal(getattr(long, name), getattr(short, name))


def test_a_second_run_repeats_the_first_bit_for_bit(arm):
    def run():
        arm.reset(HOME)
        for k in range(100):
            output = arm.step(np.full(3, 0.5 * np.sin(0.1 * k)), 5e-3)
        return np.concatenate([output.q, output.dq, output.tau_meas, output.tau_f_true])

    assert np.array_equal(run(), run())


def test_time_comes_from_the_step_counter(arm):
    arm.reset(HOME)
    for _ in range(777):
        arm.step(np.zeros(3), 5e-3)
    assert arm.steps == 3885
    assert arm.time == 3885 * STEP


def test_outputs_are_not_overwritten_by_the_next_step(arm):
    first = arm.reset(HOME)
    kept = first.q.copy()
    for _ in range(20):
        arm.step(np.ones(3), 5e-3)
    assert np.array_equal(first.q, kept)


@pytest.mark.parametrize("dt", [0.0, -1e-3, 4e-4, 5.5e-3])
def test_step_must_be_a_multiple(arm, dt):
    with pytest.raises(SimulationError, match=r"a positive integer multiple of 0\.001 s"):
        arm.step(np.zeros(3), dt)


def test_nan_command_is_refused(arm):
    said = r"the velocity command at 0 s is \[0\.0, nan, 0\.0\]; finite numbers are needed\."
    with pytest.raises(SimulationError, match=said):
        arm.step([0.0, np.nan, 0.0], 5e-3)


# --- noise and files --------------------------------------------------------------------------


def test_noise_has_the_stated_deviation_and_is_independent(plant):
    counter = np.arange(50_000)
    torque, encoder = torque_error(plant.noise, counter), encoder_error(plant.noise, counter)
    np.testing.assert_allclose(torque.std(axis=0), plant.noise.torque, rtol=0.02)
    np.testing.assert_allclose(encoder.std(axis=0), plant.noise.encoder, rtol=0.02)
    together = np.corrcoef(np.hstack([torque, encoder]).T) - np.eye(6)
    assert np.abs(together).max() < 0.02


def test_noise_of_a_sample_does_not_depend_on_its_neighbours(plant):
    series = torque_error(plant.noise, np.arange(100))
    np.testing.assert_allclose(torque_error(plant.noise, 42)[0], series[42], rtol=1e-14)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("encoder = [2e-5, 2e-5, 2e-5]", "encoder = [2e-5]", "encoder has 1 entries; 3 are needed"),
        ("torque = [1.5,", "torque = [-1.5,", "must not be negative"),
        ("seed = 1", "seed = 1\nsead = 2", "unknown key 'noise.sead'; did you mean"),
        ("sample_rate = 200.0", "sample_rate = 0", "'sample_rate' is 0"),
        ("[noise]", "[nois]", "unknown key 'nois'; did you mean 'noise'"),
    ],
)
def test_wrong_plant_file_is_refused_with_a_sentence(tmp_path, old, new, sentence):
    text = (FOLDER / "plant.toml").read_text()
    assert old in text
    path = tmp_path / "plant.toml"
    path.write_text(text.replace(old, new))
    with pytest.raises(ConfigError) as caught:
        Plant.read(path)
    assert sentence in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"joints": ("joint1", "joint2", "joint9")}, "has no joint 'joint9'"),
        ({"servo": {"torque": ("a", "joint2_servo", "joint3_servo")}}, "has no sensor 'a'"),
        ({"servo": {"integral": ("b", "b", "b")}}, "has no actuator 'b'"),
    ],
)
def test_part_missing_in_the_model_is_named(plant, change, sentence):
    data = plant.model_dump()
    for key, value in change.items():
        data[key] = data[key] | value if isinstance(value, dict) else value
    with pytest.raises(ConfigError, match=sentence):
        servo_signals(Plant.model_validate(data))


def test_missing_or_broken_model_is_refused(plant, tmp_path):
    with pytest.raises(ConfigError, match="no such model file"):
        servo_signals(plant.model_copy(update={"model": tmp_path / "none.xml"}))
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbody>")
    with pytest.raises(ConfigError, match="cannot be parsed as an MJCF"):
        servo_signals(plant.model_copy(update={"model": broken}))
