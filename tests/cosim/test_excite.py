"""The default motions on the twin: contents and reproducibility of their logs."""

import numpy as np
import pytest
from scipy.linalg import qr

from cosim.loop.excite import excite, load_arm, record, record_motions
from cosim.loop.motions import Motions
from fmu_src.arm.native import export_mjcf
from fmu_src.arm.plant import Plant, joint_limits
from hesr_model.errors import ConfigError
from hesr_model.logs.robot_log import Log
from hesr_model.motions.trajectories import Sine, random_fourier
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

FOLDER = models_folder()
MOTIONS = FOLDER / "studies" / "uf850_motions.toml"
NAMES = [
    "excitation",
    "excitation_reversed",
    "sine_joint1",
    "sine_joint2",
    "sine_joint3",
    "sweep",
    "fourier_test",
    "chirp",
    "chirp_20s",
    *(f"fourier_40s_{k}" for k in range(1, 5)),
]
HOME = np.array([0.0, 0.3, -1.9])


@pytest.fixture(scope="module")
def motions():
    return Motions.read(MOTIONS)


@pytest.fixture(scope="module")
def plant():
    return Plant.read(FOLDER / "uf850" / "plant.toml")


@pytest.fixture(scope="module")
def arm(plant):
    with load_arm(plant) as loaded:
        yield loaded


@pytest.fixture(scope="module")
def robot():
    return RobotDescription.read(FOLDER / "uf850" / "robot.toml")


@pytest.fixture(scope="module")
def everything(motions, plant):
    return {recording.log.name: recording for recording in record_motions(motions, plant)}


def only(motions, *names):
    chosen = tuple(motion for motion in motions.motions if motion.name in names)
    return motions.model_copy(update={"motions": chosen})


def sine(frequency=2.0, amplitude=(0.2, 0.2, 0.2), periods=2):
    return Sine(offset=HOME, amplitude=np.array(amplitude), frequency=frequency, periods=periods)


# --- the default logs -------------------------------------------------------------------------


def test_servo_signals_give_the_logs_of_named_signals(motions, plant, everything, tmp_path):
    folder = FOLDER / "uf850"
    fmu = export_mjcf(plant.model, tmp_path / "Arm.fmu", table=folder / "arm.toml")
    for recording in record_motions(motions, plant, fmu=fmu):
        other = everything[recording.log.name]
        np.testing.assert_array_equal(recording.log.q, other.log.q)
        np.testing.assert_array_equal(recording.log.tau, other.log.tau)
        np.testing.assert_array_equal(recording.truth.tau_f_true, other.truth.tau_f_true)


def test_every_default_motion_gives_its_logs(everything):
    assert list(everything) == NAMES
    rows = {name: len(recording.log.t) for name, recording in everything.items()}
    assert rows == {
        **dict.fromkeys(NAMES, 4000),
        "sweep": 8400,
        "chirp": 936,
        **{f"fourier_40s_{k}": 8000 for k in range(1, 5)},
    }


def test_logs_are_sampled_at_200_hz_from_zero(everything):
    for recording in everything.values():
        np.testing.assert_array_equal(recording.log.t, np.arange(len(recording.log.t)) / 200)


def test_arm_stays_within_its_limits(everything, plant):
    lower, upper = joint_limits(plant).T
    for recording in everything.values():
        assert np.all(recording.truth.q > lower)
        assert np.all(recording.truth.q < upper)
        assert np.abs(recording.truth.dq).max() < 1.5


def test_servo_follows_within_a_few_hundredths_of_a_radian(everything):
    for recording in everything.values():
        assert np.abs(recording.truth.q - recording.desired).max() < 0.06


def test_torque_is_far_from_the_servo_limits(everything):
    for recording in everything.values():
        assert np.all(np.abs(recording.truth.tau_meas).max(axis=0) < [100.0, 100.0, 45.0])


def test_log_is_the_truth_plus_the_stated_noise(everything, plant):
    for recording in everything.values():
        log, truth, n = recording.log, recording.truth, len(recording.log.t)
        for measured, true, sigma in (
            (log.tau, truth.tau_meas, plant.noise.torque),
            (log.q, truth.q, plant.noise.encoder),
        ):
            noise = (measured - true) / np.array(sigma)
            np.testing.assert_allclose(noise.std(axis=0), 1.0, atol=4 / np.sqrt(2 * n))
            np.testing.assert_allclose(noise.mean(axis=0), 0.0, atol=4 / np.sqrt(n))


def test_logged_velocity_is_differentiated_from_the_encoder(everything):
    log, truth = everything["sine_joint1"].log, everything["sine_joint1"].truth
    np.testing.assert_allclose(log.dq[1:-1], (log.q[2:] - log.q[:-2]) * 100, atol=1e-12)
    # Central differences of independent errors: sqrt(2) sigma over two periods. No lag.
    error = log.dq - truth.dq
    np.testing.assert_allclose(error[:, 1:].std(axis=0), 2e-5 * np.sqrt(2) * 100, rtol=0.1)
    lags = [np.corrcoef(log.dq[50:-50, 0], truth.dq[50 + k : -50 + k, 0])[0, 1] for k in (-1, 0, 1)]
    assert np.argmax(lags) == 1


def test_noise_of_different_logs_is_independent(everything):
    noise = [
        everything[name].log.tau - everything[name].truth.tau_meas
        for name in ("excitation", "excitation_reversed", "fourier_test")
    ]
    together = np.corrcoef(np.hstack(noise).T) - np.eye(9)
    assert np.abs(together).max() < 0.08


def test_reversed_excitation_is_the_counterpart(everything):
    forward, back = everything["excitation"], everything["excitation_reversed"]
    np.testing.assert_allclose(back.desired[1:], forward.desired[:0:-1], atol=1e-12)
    # Friction is odd: in fast motion it cancels in the mean of the two directions.
    fast = np.abs(forward.truth.dq[1:]) > 0.3
    mean = 0.5 * (forward.truth.tau_f_true[1:] + back.truth.tau_f_true[:0:-1])
    assert np.abs(mean[fast]).mean() < 0.05 * np.abs(forward.truth.tau_f_true[1:][fast]).mean()


def test_logged_excitation_is_periodic(arm):
    trajectory = random_fourier(
        seed=3, harmonics=3, period=4.0, peak_velocity=np.ones(3), offset=HOME, periods=3
    )
    truth = record(arm, trajectory, 1, name="x", unlogged=(4.0, 0.0)).truth
    np.testing.assert_allclose(truth.tau_f_true[800:], truth.tau_f_true[:800], atol=0.05)
    np.testing.assert_allclose(truth.q[800:], truth.q[:800], atol=1e-5)


def test_resting_joints_stay_at_rest(everything):
    for joint in (1, 2, 3):
        speed = np.abs(everything[f"sine_joint{joint}"].truth.dq).max(axis=0)
        assert speed[joint - 1] == pytest.approx(1.2, rel=0.02)
        assert np.all(np.delete(speed, joint - 1) < 0.02)


def test_friction_truth_shows_hysteresis(everything):
    truth = everything["sine_joint1"].truth
    dq, friction = truth.dq[800:, 0], truth.tau_f_true[800:, 0]
    speeding = np.gradient(dq) > 0
    slow = (dq > 0.02) & (dq < 0.06)
    assert friction[slow & ~speeding].mean() - friction[slow & speeding].mean() > 1.0


def test_rigid_body_and_friction_explain_the_log(everything, robot):
    model, truth = Robot(robot), everything["fourier_test"].truth
    ddq = np.gradient(truth.dq, 5e-3, axis=0)
    rigid = model.torque(model.nominal_parameters, truth.q, truth.dq, ddq)
    residual = truth.tau_meas - rigid - truth.tau_f_true
    # The residual is ripple that differences over 10 ms smooth out.
    assert np.all(np.sqrt(np.mean(residual**2, axis=0)) < [0.5, 0.5, 0.3])
    assert np.all(np.abs(residual.mean(axis=0)) < 0.05)


def test_excitation_is_well_conditioned(everything, robot):
    model, desired = Robot(robot), everything["excitation"].desired
    dq = np.gradient(desired, 5e-3, axis=0)
    ddq = np.gradient(dq, 5e-3, axis=0)
    columns = model.regressor(desired[::10], dq[::10], ddq[::10]).reshape(-1, 33)[:, :30]
    lengths = np.linalg.norm(columns, axis=0)
    used = lengths > 1e-9 * lengths.max()
    scaled = columns[:, used] / lengths[used]
    _, r, order = qr(scaled, mode="economic", pivoting=True)
    rank = int(np.sum(np.abs(np.diag(r)) > 1e-8))
    assert rank == 15
    assert np.linalg.cond(scaled[:, order[:rank]]) < 5.0


# --- files ------------------------------------------------------------------------------------


def test_written_logs_can_be_read(motions, plant, robot, everything, tmp_path):
    paths = excite(only(motions, "chirp", "sine_joint2"), plant, tmp_path / "new")
    assert list(paths) == ["sine_joint2", "chirp"]
    for name, path in paths.items():
        assert path == tmp_path / "new" / f"{name}.csv"
        read, recorded = Log.read(path, robot), everything[name].log
        assert read.name == name
        for column in ("t", "q", "dq", "tau"):
            np.testing.assert_array_equal(getattr(read, column), getattr(recorded, column))


def seeded(plant: Plant, seed: int) -> Plant:
    return plant.model_copy(update={"noise": plant.noise.model_copy(update={"seed": seed})})


def test_the_seed_determines_noise_and_bytes(motions, plant, tmp_path):
    chosen = only(motions, "chirp")
    texts = [
        excite(chosen, seeded(plant, seed), tmp_path / str(k))["chirp"].read_bytes()
        for k, seed in enumerate((7, 7, 8))
    ]
    assert texts[0] == texts[1]
    assert texts[0] != texts[2]


def test_the_truth_does_not_depend_on_the_seed(motions, plant):
    chirp = only(motions, "chirp")
    one, other = (next(record_motions(chirp, seeded(plant, seed))) for seed in (7, 8))
    assert np.array_equal(one.truth.q, other.truth.q)
    assert np.array_equal(one.truth.tau_f_true, other.truth.tau_f_true)
    assert not np.any(one.log.tau == other.log.tau)


# --- refusals ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('kind = "chirp"', 'kind = "chrip"', "'chrip'"),
        ("seed = 86\n", "seed = 86\nsead = 1\n", "sead"),
        ("harmonics = 10", "harmonics = 1", "harmonics' is 1"),
        ("length = 4.68\n", "", "length' is missing"),
        ('name = "chirp"', 'name = "sweep"', "two logs would be named 'sweep'"),
        ('name = "chirp"', 'name = "excitation_reversed"', "would be named 'excitation_reversed'"),
        ('name = "chirp"', 'name = "../chirp"', "name' is '../chirp'"),
    ],
)
def test_invalid_motions_are_refused(tmp_path, old, new, sentence):
    text = MOTIONS.read_text()
    assert old in text
    path = tmp_path / "motions.toml"
    path.write_text(text.replace(old, new))
    with pytest.raises(ConfigError) as caught:
        Motions.read(path)
    assert str(path) in str(caught.value)
    assert sentence in str(caught.value)


def test_motion_beyond_a_limit_names_the_joint(arm):
    with pytest.raises(
        ConfigError, match=r"motion 'far': takes joint3 from -3\.919 to 0\.119 rad; .* to 0\.061"
    ):
        record(arm, sine(0.1, (0.0, 0.0, 1.2688)), 1, name="far")


def test_motion_for_another_number_of_joints_is_refused(arm):
    trajectory = Sine(offset=np.zeros(2), amplitude=np.ones(2), frequency=1.0)
    with pytest.raises(ConfigError, match="motion 'two': is for 2 joints"):
        record(arm, trajectory, 1, name="two")


def test_motion_that_ends_before_the_log_starts_is_refused(arm):
    with pytest.raises(ConfigError, match="motion 'short': 1 of 1 s are not logged"):
        record(arm, sine(), 1, name="short", unlogged=(0.5, 0.5))
