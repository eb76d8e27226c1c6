"""The two systems for every engine, each as a folder with its FMUs and a SYSTEM.toml."""

from pathlib import Path

from closed_loop import MOTION, build

from cosim.loop.closed_loop import Scheme
from cosim.systems.system import ComponentSpec, SystemSpec, write_system
from fmu_src import export_fmu, model_file
from fmu_src.blocks.inverse_dynamics import inverse_dynamics
from fmu_src.blocks.trajectory import start_values, trajectory
from fmu_src.export.package import Content, write_fmu
from fmu_src.plant.plant_fmu import PlantBody
from hesr.extras.observer.observer_fmu import ObserverLimits
from hesr.extras.observer.observer_fmu import content as observer
from hesr_model.friction.model import FrictionModel
from hesr_model.robots.robot import Robot
from hesr_model.support.files import models_folder

STEP = 0.005
STOP = 10.0
SYSTEM = "SYSTEM.toml"


def open_system(folder: Path) -> Path:
    """Write the open system, a desired motion that drives the friction of Table I."""
    folder.mkdir(parents=True, exist_ok=True)
    friction = FrictionModel.read(model_file("uf850-table1"))
    joints = len(friction.joints)
    components = (
        ComponentSpec(
            name="trajectory",
            fmu=write_fmu(trajectory(joints), folder / "Trajectory.fmu"),
            start=start_values(MOTION),
        ),
        ComponentSpec(
            name="friction",
            fmu=export_fmu(friction, folder / "Friction.fmu"),
            start={"tau_load": 0.0},
        ),
    )
    spec = SystemSpec(
        name="open",
        step=STEP,
        stop=STOP,
        components=components,
        connections={"friction.dq": "trajectory.dq", "friction.q": "trajectory.q"},
        observe=("trajectory.dq", "friction.tau"),
    )
    return write_system(spec, folder / SYSTEM)


def observer_content() -> Content:
    """Return the observer of the UF850 with Table I."""
    body = PlantBody.from_robot(Robot(models_folder() / "uf850" / "robot.toml"))
    row = (1.0,) * body.robot.n
    limits = ObserverLimits(numbers=(row, row, (0.02,) * body.robot.n, row, row, row), factor=2.0)
    return observer(FrictionModel.read(model_file("uf850-table1")), body, limits)


def observed_system(folder: Path) -> Path:
    """Write a desired motion whose rigid-body torque is observed; friction is external."""
    folder.mkdir(parents=True, exist_ok=True)
    robot = Robot(models_folder() / "uf850" / "robot.toml")
    body = inverse_dynamics(robot, robot.nominal_parameters)
    components = (
        ComponentSpec(
            name="trajectory",
            fmu=write_fmu(trajectory(robot.n), folder / "Trajectory.fmu"),
            start=start_values(MOTION),
        ),
        ComponentSpec(name="body", fmu=write_fmu(body, folder / "InverseDynamics.fmu")),
        ComponentSpec(name="observer", fmu=write_fmu(observer_content(), folder / "Observer.fmu")),
    )
    connections = {f"body.{name}": f"trajectory.{name}" for name in ("q", "dq", "ddq")}
    connections |= {f"observer.{name}": f"trajectory.{name}" for name in ("q", "dq")}
    spec = SystemSpec(
        name="observed",
        step=STEP,
        stop=STOP,
        components=components,
        connections=connections | {"observer.tau_motor": "body.tau"},
        observe=("observer.tau_ext", "observer.contact_threshold"),
    )
    return write_system(spec, folder / SYSTEM)


def closed_system(folder: Path) -> Path:
    """Write the closed loop of the UF850: trajectory, models, controller and the native arm."""
    bench = build(folder, FrictionModel.read(model_file("uf850-table1")))
    loop = bench.loop(Scheme(compensation="servo_inversion", Kx=5.0))
    spec = bench.system(loop).model_copy(update={"name": "closed", "stop": STOP})
    return write_system(spec, folder / SYSTEM)
