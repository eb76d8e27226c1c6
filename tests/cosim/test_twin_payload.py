"""A payload on the twin, unknown to the robot file, identified from logs."""

import shutil

import numpy as np
import pytest

from cosim.loop.excite import load_arm, record
from fmu_src.arm.plant import Plant
from hesr_model.errors import FitError
from hesr_model.motions.trajectories import random_fourier
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.payload import add_payload, identify_payload
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

FOLDER = models_folder() / "uf850"
LAST_LINK = '<inertial pos="0.000484 -0.000334 -0.014217"'
PAYLOAD = """
<body name="load" gravcomp="1">
  <inertial pos="0.02 -0.01 0.08" mass="1.5"
    fullinertia="0.004 0.005 0.003 0.0002 0.0001 -0.0003"/>
</body>
"""


def fourier(seed, periods, velocity):
    return random_fourier(
        seed=seed,
        harmonics=10,
        period=20.0,
        peak_velocity=np.array(velocity),
        offset=np.array([0.0, 0.3, -1.9]),
        periods=periods,
    )


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """The unloaded arm, and the arm with a payload on its flange."""
    with_payload = tmp_path_factory.mktemp("loaded") / "uf850"
    shutil.copytree(FOLDER, with_payload)
    text = (FOLDER / "uf850.xml").read_text()
    place = text.index('<body name="payload"', text.index(LAST_LINK))
    (with_payload / "uf850.xml").write_text(text[:place] + PAYLOAD + text[place:])
    return FOLDER, with_payload


@pytest.fixture(scope="module")
def models(folders):
    return [Robot(RobotDescription.read(folder / "robot.toml")) for folder in folders]


@pytest.fixture(scope="module")
def logs(folders):
    """Excitation, forward and time-reversed, of either arm."""
    motion = fourier(86, 2, [1.3, 1.2, 1.3])
    both = []
    for folder in folders:
        plant = Plant.read(folder / "plant.toml")
        with load_arm(plant) as arm:
            both.append(
                [
                    record(arm, run, 1, name=f"{folder.parent.name}_{k}", unlogged=(20.0, 0.0))
                    for k, run in enumerate((motion, motion.reverse_time()))
                ]
            )
    return [[recording.log for recording in pair] for pair in both]


@pytest.fixture(scope="module")
def unloaded(models, logs):
    (forward, backward), _ = logs
    return identify([forward], models[0], reversed_logs=[backward])


def test_mass_and_centre_are_identified(models, logs, unloaded):
    payload = identify_payload(logs[1], models[0], unloaded)
    true = (models[1].nominal_parameters - models[0].nominal_parameters)[20:30]
    assert payload.mass == pytest.approx(1.5, rel=0.012)
    assert abs(payload.mass - 1.5) < 3 * payload.standard_errors[0]
    # In this joint's plane of motion; along its axis gravity gives little information.
    np.testing.assert_allclose(payload.parameters[1:3] / payload.mass, true[1:3] / 1.5, atol=5e-3)


def test_torque_under_load_is_predicted_as_well_as_without(models, logs, unloaded):
    model, truth = models
    body = add_payload(unloaded, identify_payload(logs[1], model, unloaded), model)
    states = fourier(5, 1, [1.2, 1.0, 1.2]).sample(np.arange(4000) / 200)

    def error(parameters, nominal):
        return np.sqrt(np.mean(model.torque(parameters - nominal, *states) ** 2, axis=0))

    ignored = error(unloaded.parameters, truth.nominal_parameters)
    assert np.all(ignored[1:] > 5.0)
    assert np.all(error(body.parameters, truth.nominal_parameters) < [0.25, 0.4, 0.15])
    assert np.all(error(unloaded.parameters, model.nominal_parameters) < [0.25, 0.4, 0.15])


def test_a_log_without_payload_is_refused(models, logs, unloaded):
    with pytest.raises(FitError, match=r"^log .*_0: no significant payload;"):
        identify_payload(logs[0][:1], models[0], unloaded)


def test_another_motion_without_payload_is_also_refused(folders, models, unloaded):
    plant = Plant.read(folders[0] / "plant.toml")
    with load_arm(plant) as arm:
        recording = record(arm, fourier(3, 1, [1.2, 1.0, 1.2]), 1, name="other")
    with pytest.raises(FitError, match=r"^log other: no significant payload"):
        identify_payload([recording.log], models[0], unloaded)
