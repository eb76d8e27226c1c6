"""Excitation design: its files, and the quality of the twin's rigid body identified from it."""

from dataclasses import replace

import numpy as np
import pytest

from cosim.loop.excite import load_arm, record
from cosim.report.figures.motions import write_excitation
from cosim.workflow.excite import excite
from fmu_src.arm.plant import Plant
from hesr_model.errors import ConfigError, FitError, RobotError
from hesr_model.logs.tables import read_table
from hesr_model.motions.excitation import ExcitationSettings, condition, random_motions
from hesr_model.motions.limits import MotionLimits
from hesr_model.motions.trajectories import random_fourier
from hesr_model.rigid_body.base_parameters import base_columns
from hesr_model.rigid_body.identification import identify
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

FOLDER = models_folder() / "uf850"
ROBOT = FOLDER / "robot.toml"
SETTINGS = """
[limits]
velocity = [1.3, 1.2, 1.3]
acceleration = [2.6, 2.4, 2.6]
"""
SLOW = "[limits]\nvelocity = [2.0, 2.0, 2.0]\n"
QUICK = "harmonics = 2\nstarts = 1\nperiod = [6.0, 8.0]\n"


@pytest.fixture(scope="module")
def model():
    return Robot(RobotDescription.read(ROBOT))


@pytest.fixture(scope="module")
def designed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("design")
    settings = folder / "excitation.toml"
    settings.write_text(SETTINGS)
    return excite(ROBOT, output=folder / "out" / "motion.csv", settings=settings)


@pytest.fixture(scope="module")
def recorded(designed):
    """The second of two periods, forward and time-reversed, on the twin."""
    plant = Plant.read(FOLDER / "plant.toml")
    motion = replace(designed.excitation.motion, periods=2)
    with load_arm(plant) as arm:
        return [
            record(arm, trajectory, 1, name=name, unlogged=(motion.period, 0.0))
            for name, trajectory in (("forward", motion), ("backward", motion.reverse_time()))
        ]


def read(path):
    table = read_table(path)
    return table.names, table.numbers(list(table.names))


# --- files ------------------------------------------------------------------------------------


def test_setpoints_match_the_motion(designed):
    names, rows = read(designed.forward)
    assert list(names) == ["t", *(f"{kind}{k}" for kind in ("q", "dq", "ddq") for k in (1, 2, 3))]
    t, q, dq, ddq = designed.excitation.setpoints()
    np.testing.assert_allclose(rows, np.column_stack([t, q, dq, ddq]), atol=1e-12)
    assert rows[-1, 0] == pytest.approx(designed.excitation.motion.period)


def test_counterpart_is_the_reversed_path(designed):
    assert designed.backward.name == "motion_reversed.csv"
    (names, forward), (others, backward) = read(designed.forward), read(designed.backward)
    assert names == others
    np.testing.assert_array_equal(backward[:, 0], forward[:, 0])
    np.testing.assert_array_equal(backward[:, 1:4], forward[::-1, 1:4])
    np.testing.assert_array_equal(backward[:, 4:7], -forward[::-1, 4:7])
    np.testing.assert_array_equal(backward[:, 7:], forward[::-1, 7:])


def test_picture_is_reproducible(designed, tmp_path):
    assert designed.picture.name == "motion.png"
    assert designed.picture.read_bytes().startswith(b"\x89PNG")
    again = tmp_path / "again.png"
    write_excitation(again, designed.excitation, ["joint1", "joint2", "joint3"])
    assert again.read_bytes() == designed.picture.read_bytes()


def test_parquet_is_supported(tmp_path):
    settings = tmp_path / "quick.toml"
    settings.write_text(QUICK + SLOW)
    found = excite(ROBOT, output=tmp_path / "motion.parquet", settings=settings)
    assert found.backward == tmp_path / "motion_reversed.parquet"
    assert len(read(found.forward)[1]) == len(found.excitation.setpoints()[0])


# --- quality -----------------------------------------------------------------------------------


def test_condition_is_a_third_of_the_median_random_motion(designed, model):
    assert designed.excitation.condition < designed.random_condition / 3
    rows = read(designed.forward)[1][:-1]
    base = list(base_columns(model))
    columns = model.regressor(rows[:, 1:4], rows[:, 4:7], rows[:, 7:])[:, :, base]
    found = np.linalg.cond(columns.reshape(-1, len(base)))
    assert found == pytest.approx(designed.excitation.condition, rel=0.01)


@pytest.mark.parametrize(
    ("method", "largest"), [("paper", [1.1, 1.4, 0.4]), ("stacked", [0.5, 0.5, 0.5])]
)
def test_rigid_body_of_the_twin_is_identified(designed, recorded, model, method, largest):
    forward, backward = recorded
    body = identify([forward.log], model, method=method, reversed_logs=[backward.log])
    test = random_fourier(
        seed=1,
        harmonics=10,
        period=20.0,
        peak_velocity=np.array([1.2, 1.0, 1.2]),
        offset=np.array([0.0, 0.3, -1.9]),
    )
    for motion in (test, designed.excitation.motion):
        q, dq, ddq = motion.sample(np.linspace(0.0, motion.duration, 2000))
        error = model.torque(body.parameters - model.nominal_parameters, q, dq, ddq)
        assert np.all(np.sqrt(np.mean(error**2, axis=0)) < largest)


def test_random_motions_respect_the_limits_of_the_twin(model):
    plant, limits = Plant.read(FOLDER / "plant.toml"), MotionLimits(velocity=(2.0, 2.0, 2.0))
    motion = random_motions(model, ExcitationSettings(limits=limits), 1, seed=3)[0]
    with load_arm(plant) as arm:
        record(arm, motion, 1, name="random")
    assert condition(model, base_columns(model), motion) > 15.0


# --- refusals ----------------------------------------------------------------------------------


def test_suffixes_other_than_those_of_tables_are_refused(tmp_path):
    message = r"suffix must be one of \.csv"
    with pytest.raises(ConfigError, match=message):
        excite(ROBOT, output=tmp_path / "motion.txt")


@pytest.mark.parametrize(
    ("text", "kind", "sentence"),
    [
        ("velocity = [1.0]", RobotError, "key 'limits.velocity' has 1 entries"),
        (
            "torque = [200.0, 1e-4, 1e-4]\nvelocity = [2.0, 2.0, 2.0]",
            FitError,
            "robot 'uf850': the limits allow no motion",
        ),
        ("speed = [1.0]", ConfigError, "unknown key 'limits.speed'"),
    ],
)
def test_refused_limits_are_reported_with_their_file(tmp_path, text, kind, sentence):
    settings = tmp_path / "excitation.toml"
    settings.write_text(f"{QUICK}[limits]\n{text}\n")
    with pytest.raises(kind) as caught:
        excite(ROBOT, output=tmp_path / "motion.csv", settings=settings)
    assert str(caught.value).startswith(f"{settings}: {sentence}")
    assert not (tmp_path / "motion.csv").exists()
