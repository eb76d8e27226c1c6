"""The two systems for every engine, each as a folder with its FMUs and a SYSTEM.toml."""

from pathlib import Path

from closed_loop import MOTION, build

from cosim.loop.closed_loop import Scheme
from cosim.systems.system import ComponentSpec, SystemSpec, write_system
from fmu_src import export_fmu, model_file
from fmu_src.blocks.trajectory import start_values, trajectory
from fmu_src.export.package import write_fmu
from hesr_model.friction.model import FrictionModel

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


def closed_system(folder: Path) -> Path:
    """Write the closed loop of the UF850: trajectory, models, controller and the native arm."""
    bench = build(folder, FrictionModel.read(model_file("uf850-table1")))
    loop = bench.loop(Scheme(compensation="servo_inversion", Kx=5.0))
    spec = bench.system(loop).model_copy(update={"name": "closed", "stop": STOP})
    return write_system(spec, folder / SYSTEM)
