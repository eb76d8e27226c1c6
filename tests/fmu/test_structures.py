"""Laws with the terms of their typical structure, ripple included, in every compiled format.

Three equal joints share compiled lanes, one joint does not.
"""

import re
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from fmu_src import export_fmu
from fmu_src.plant.plant_fmu import PlantBody, export_plant
from fmu_src.run.fmu import FmuInstance
from hesr.extras.adaptive.monitor import export_adaptive
from hesr.extras.drive.drive_fmu import export_drive
from hesr.extras.mujoco_plugin.plugin_library import export_mujoco_plugin
from hesr_model.equations.memory import Stop
from hesr_model.errors import ExportError
from hesr_model.fitting.estimator import Estimator, registry
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.robots.robot import Robot, RobotDescription

STEP = 0.005
SMALL = {"lag", "smoothing", "v_s", "v_a", "deflection"}
GATE = ("stribeck", "lugre_load_ripple", "parfam_s")
ARM = """<mujoco model="arm"><compiler angle="radian"/><worldbody>{links}</worldbody></mujoco>"""
LINK = """<body pos="0 0 0.3"><joint name="j{k}" axis="0 1 0" armature="0.5"/>
<geom size=".05 .2" type="capsule" pos=".1 0 .1" mass="2"/>"""

Export = Callable[[FrictionModel, Robot, Path], Path]


def typical_law(name: str, estimator: type[Estimator]) -> FrictionLaw:
    """Return a law of the typical structure with coefficients of a usual size."""
    structure = dict(estimator.typical)
    form = estimator.form(structure)
    values = {c.name: 0.01 if c.name in SMALL else 0.5 for c in form.coefficients}
    return FrictionLaw(name=name, structure=structure, form=form, values=values)


def arm(joints: int, folder: Path) -> Robot:
    """Return a chain of equal links."""
    links = "".join(LINK.format(k=k) for k in range(1, joints + 1)) + "</body>" * joints
    path = folder / f"arm{joints}.xml"
    path.write_text(ARM.format(links=links), encoding="utf-8")
    names = tuple(f"j{k}" for k in range(1, joints + 1))
    return Robot(RobotDescription(name="arm", model=path, joints=names))


def export_friction_2(model: FrictionModel, robot: Robot, path: Path) -> Path:
    return export_fmu(model, path)


def export_friction_3(model: FrictionModel, robot: Robot, path: Path) -> Path:
    return export_fmu(model, path, fmi=3)


def export_adapting(model: FrictionModel, robot: Robot, path: Path) -> Path:
    return export_adaptive(model, path)


def export_motors(model: FrictionModel, robot: Robot, path: Path) -> Path:
    return export_drive(model, path, inertia=[0.5] * robot.n, bare=True)


def export_arm(model: FrictionModel, robot: Robot, path: Path) -> Path:
    return export_plant(model, path, body=PlantBody.of(robot), bare=True)


def export_servo_arm(model: FrictionModel, robot: Robot, path: Path) -> Path:
    gains = {"kv": [20.0] * robot.n, "ki": [50.0] * robot.n}
    return export_plant(model, path, body=PlantBody.of(robot), bare=True, **gains)


FORMATS: dict[str, Export] = {
    "FMI 2": export_friction_2,
    "FMI 3": export_friction_3,
    "adaptive": export_adapting,
    "drive": export_motors,
    "plant": export_arm,
    "plant with servo": export_servo_arm,
}


def fitted_model(name: str, robot: Robot) -> FrictionModel:
    """Return a model with equal joints, and the range that some formats need."""
    trained = TrainedRange(
        sample_time=STEP, dq=(-1.0, 1.0), q=(-1.0, 1.0), tau_load=(-9.0, 9.0), tau=(-9.0, 9.0)
    )
    return FrictionModel(
        law=name,
        robot="arm",
        joints=robot.joints,
        laws=(typical_law(name, registry()[name]),) * robot.n,
        sample_time=STEP,
        trained=(trained,) * robot.n,
        training_rmse=(0.1,) * robot.n,
    )


def adapts(law: FrictionLaw) -> bool:
    """Return whether a law has friction that an adaptive FMU can scale."""
    memory = law.form.memory
    return any(isinstance(m, Stop) or DQ not in m.drive.diff(DQ).free_symbols for m in memory)


def run(fmu: Path, joints: int) -> None:
    """Step at rest with all defaults, then with speeds or torques; all outputs are finite."""
    with FmuInstance(fmu) as component:
        component.initialise(start={})
        names = [v.name for v in component.description.modelVariables]
        outputs = [n for n in names if n.startswith(("tau[", "q[", "dq[", "tau_friction["))]
        moved = "dq" if "dq_start[1]" not in names and "tau_motor[1]" not in names else "tau"
        for k in range(20):
            if k == 10 and f"{moved}[1]" in names:
                component.set({f"{moved}[{i}]": 0.3 for i in range(1, joints + 1)})
            component.step(k * STEP, STEP)
        assert np.isfinite(component.get(outputs)).all()


@pytest.mark.parametrize("joints", [1, 3])
@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize(
    "name",
    [n if n in GATE else pytest.param(n, marks=pytest.mark.nightly("laws")) for n in registry()],
)
@pytest.mark.ci
def test_every_structure_runs_in_every_format(
    name: str, kind: str, joints: int, tmp_path: Path
) -> None:
    robot = arm(joints, tmp_path)
    model = fitted_model(name, robot)
    path = tmp_path / "It.fmu"
    if kind == "adaptive" and not adapts(model.laws[0]):
        with pytest.raises(ExportError, match=re.escape(f"law '{name}' has neither stops nor")):
            FORMATS[kind](model, robot, path)
        return
    FORMATS[kind](model, robot, path)
    run(path, joints)


@pytest.mark.parametrize(
    "name",
    [n if n in GATE else pytest.param(n, marks=pytest.mark.nightly("laws")) for n in registry()],
)
@pytest.mark.ci
def test_three_equal_joints_are_a_plugin_of_mujoco(name: str, tmp_path: Path) -> None:
    robot = arm(3, tmp_path)
    model = fitted_model(name, robot)
    plugin = export_mujoco_plugin(model, tmp_path / f"equal_{name}.so")
    mujoco.mj_loadPluginLibrary(str(plugin))
    text = ARM.format(links="".join(LINK.format(k=k) for k in (1, 2, 3)) + "</body>" * 3)
    include = f'<include file="{plugin.with_suffix(".xml")}"/>'
    model_of_mujoco = mujoco.MjModel.from_xml_string(
        text.replace("<worldbody>", include + "<worldbody>")
    )
    data = mujoco.MjData(model_of_mujoco)
    for _ in range(20):
        mujoco.mj_step(model_of_mujoco, data)
    assert np.isfinite(data.qpos).all()
    assert np.abs(data.qfrc_passive).max() > 0.0
