"""Units of model files: millimetres, grams and their products are named, robots are not doubted."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from hesr_model.robots.model_file import load
from hesr_model.robots.model_units import RobotSize, find_units, measure_size
from hesr_model.robots.robot import Robot
from hesr_model.support.files import models_folder

MODELS = [models_folder() / "uf850" / "uf850.xml", models_folder() / "ur10" / "ur10.urdf"]

UNITS = {
    "lengths in millimetres and inertias in kg.mm2": (1e3, 1.0, 1e6),
    "lengths in millimetres and inertias in kg.m2": (1e3, 1.0, 1.0),
    "masses in grams and inertias in g.m2": (1.0, 1e3, 1e3),
    "lengths in millimetres, masses in grams and inertias in g.mm2": (1e3, 1e3, 1e9),
    "inertias in kg.mm2": (1.0, 1.0, 1e6),
}

LINK = """<link name="l{k}"><inertial><origin xyz="0.1 0 0.02"/><mass value="{mass}"/>
<inertia ixx="{ixx}" ixy="0" ixz="0" iyy="{ixx}" iyz="0" izz="{ixx}"/></inertial></link>"""
JOINT = """<joint name="j{k}" type="revolute"><parent link="l{before}"/><child link="l{k}"/>
<origin xyz="0.3 0 0.05"/><axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="50" velocity="2"/>
</joint>"""


def arm(folder: Path, *, joints: int = 4) -> Path:
    """Write an arm of 1.2 m and 12 kg."""
    parts = ['<link name="l0"/>']
    for k in range(1, joints + 1):
        parts += [LINK.format(k=k, mass=3.0, ixx=0.02), JOINT.format(k=k, before=k - 1)]
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="arm">{"".join(parts)}</robot>', encoding="utf-8")
    return path


def scale(path: Path, length: float, mass: float, inertia: float) -> Path:
    """Multiply the numbers of a URDF, as other units do."""
    tree = ElementTree.parse(path)
    for origin in tree.iter("origin"):
        numbers = [length * float(number) for number in origin.get("xyz", "").split()]
        origin.set("xyz", " ".join(map(repr, numbers)))
    for element in tree.iter("mass"):
        element.set("value", repr(mass * float(element.get("value", ""))))
    for element in tree.iter("inertia"):
        for key, value in element.items():
            element.set(key, repr(inertia * float(value)))
    tree.write(path)
    return path


@pytest.mark.parametrize("path", MODELS, ids=lambda path: path.stem)
def test_robots_are_not_doubted(path: Path) -> None:
    assert load(path).file_doubts == ()


@pytest.mark.parametrize("units", UNITS)
def test_units_are_named_and_a_converted_file_is_not_doubted(units: str, tmp_path: Path) -> None:
    path = scale(arm(tmp_path), *UNITS[units])
    (doubt,) = (doubt for doubt in Robot(path).doubts if doubt.check == "model-units")
    assert doubt.severity == "warning"
    assert doubt.remedy.endswith(f" {units}")
    converted = scale(path, *(1.0 / factor for factor in UNITS[units]))
    assert load(converted).file_doubts == ()


def test_sizes_without_an_explanation_have_no_units(tmp_path: Path) -> None:
    path = scale(arm(tmp_path), 1.0, 1e-6, 1e-6)
    (doubt,) = load(path).file_doubts
    assert doubt.remedy.startswith("check the units")


@pytest.mark.parametrize("joints", [1, 2])
def test_a_pendulum_may_have_any_size(joints: int, tmp_path: Path) -> None:
    path = scale(arm(tmp_path, joints=joints), 1.0, 1e4, 1e4)
    assert load(path).file_doubts == ()


def test_the_size_is_that_of_the_file(tmp_path: Path) -> None:
    size = measure_size(load(arm(tmp_path)).pin_model)
    assert size is not None
    reach = 4.0 * np.hypot(0.3, 0.05) + np.hypot(0.1, 0.02)
    np.testing.assert_allclose(size, [reach, 12.0, np.sqrt(0.03 / 3.0)], rtol=1e-12)


def test_bounds_leave_room_for_unusual_robots() -> None:
    assert RobotSize(reach=25.0, mass=9000.0, gyration=2.0).is_plausible()
    assert RobotSize(reach=0.3, mass=0.001, gyration=0.008).is_plausible()
    assert not RobotSize(reach=100.0, mass=2000.0, gyration=0.08).is_plausible()
    assert find_units(RobotSize(reach=1000.0, mass=12.0, gyration=100.0)) == [
        "lengths in millimetres",
        "inertias in kg.mm2",
    ]
