"""A known payload gives the torque constants of the digital twin with unknown friction."""

from pathlib import Path

import numpy as np
from small_study import uf850
from small_twin import fourier

from cosim.loop.excite import record_motions
from cosim.loop.motions import Motions
from fmu_src.arm.plant import Plant
from hesr_model.logs.signals import Motion, smooth
from hesr_model.rigid_body.torque_constants import point_payload, torque_constants
from hesr_model.robots.robot import Robot, RobotDescription

MOTIONS = fourier("excitation", 86, 8, 20.0, "1.3, 1.2, 1.3")
PAYLOAD = '<body name="payload" pos="0 0 0.1">\n                    <inertial pos="0 0 0" mass="0"'
WRONG = np.array([0.5, 2.0, 1.3])
"""Ratios of assumed to true constants."""


def motion(folder: Path, mass: float) -> Motion:
    """Run the arm with a payload; wrong constants turn currents into torques."""
    text = uf850("uf850.xml").read_text(encoding="utf-8")
    assert PAYLOAD in text
    heavier = PAYLOAD.replace('mass="0"', f'mass="{mass}"')
    folder.mkdir()
    (folder / "uf850.xml").write_text(text.replace(PAYLOAD, heavier), encoding="utf-8")
    for name in ("plant.toml",):
        (folder / name).write_text(uf850(name).read_text(encoding="utf-8"), encoding="utf-8")
    (folder / "motions.toml").write_text(MOTIONS, encoding="utf-8")
    plant = Plant.read(folder / "plant.toml")
    [made] = record_motions(Motions.read(folder / "motions.toml"), plant)
    smoothed = smooth(made.log)
    return Motion(**{**vars(smoothed), "tau": smoothed.tau * WRONG})


def test_joints_moving_the_payload_are_known_within_3_percent(tmp_path: Path) -> None:
    robot = Robot(RobotDescription.read(uf850("robot.toml")))
    # The payload is at the flange; the welded wrist is one body with the last joint's link.
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(uf850("uf850.xml")))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    frame = model.body("link3").id
    rotation = data.xmat[frame].reshape(3, 3)
    centre = rotation.T @ (data.body("payload").xpos - data.xpos[frame])
    found = torque_constants(
        [motion(tmp_path / "free", 0.0)],
        robot,
        WRONG,
        mass_error=0.5,
        loaded=[motion(tmp_path / "loaded", 4.0)],
        payload=point_payload(4.0, centre),
    )
    assert [constant.determined for constant in found] == [True, True, True]
    np.testing.assert_allclose([constant.value for constant in found], 1.0, rtol=0.03)
    alone = torque_constants([motion(tmp_path / "again", 0.0)], robot, WRONG, mass_error=0.1)
    assert not alone[0].determined
    for constant in alone:
        if constant.determined:
            assert abs(constant.value - 1.0) < 3 * constant.error
