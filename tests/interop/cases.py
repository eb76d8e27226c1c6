"""Cases of all engines: each FMU alone, and the two systems."""

from dataclasses import replace
from pathlib import Path

from closed_loop import MOTION
from interop.case import Alone, Case, Together, opened_case
from interop.drive import driven
from systems import closed_system, observed_system, observer_content, open_system

from fmu_src import export_fmu, model_file
from fmu_src.blocks.controller import controller, velocity
from fmu_src.blocks.inverse_dynamics import inverse_dynamics
from fmu_src.blocks.trajectory import start_values, trajectory
from fmu_src.export.package import Version, write_fmu
from fmu_src.friction.friction_fmu import export_bare
from hesr.extras.adaptive.monitor import adaptive_content, export_adaptive
from hesr.extras.drive.drive_fmu import build_motors
from hesr.extras.drive.drive_fmu import content as drive
from hesr_model.fitting.estimator import registry
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.thermal import Thermal
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

NAMES = (
    "friction", "exact", "lugre", "adaptive", "trajectory", "body", "controller", "arm", "open",
    "observed", "closed",
)  # fmt: skip

OF_FMI_3 = (
    "friction", "exact", "lugre", "adaptive", "drive", "trajectory", "body", "controller",
    "velocity", "observer",
)  # fmt: skip
"""FMUs that are also run in FMI 3.0."""

# States at their start attributes: CasADi evaluates only the equations and starts there.
EXACT = {"discretisation": "exact", "start_mode": "given"}

LUGRE = {
    "sigma_0": 2.0e3, "sigma_1": 1.5, "sigma_2": 3.0,
    "F_c": 9.0, "F_s": 12.0, "v_s": 0.08, "tau_0": 0.2,
}  # fmt: skip


def every_case(folder: Path) -> list[Case]:
    """Build all FMUs and systems in a folder."""
    makers = {"open": open_system, "observed": observed_system, "closed": closed_system}
    systems = [system(make(folder / name), folder) for name, make in makers.items()]
    return [*alone(folder, systems[-1]), *systems]


def system(path: Path, folder: Path) -> Together:
    with opened_case(path, folder) as case:
        return case  # its FMUs are next to the file


def alone(folder: Path, closed: Together) -> list[Alone]:
    """Return each FMU of the closed loop with its settings in the loop, and two frictions."""
    friction = export_fmu(FrictionModel.read(model_file("uf850-table1")), folder / "Friction.fmu")
    used = {c.name: c for c in closed.spec.components}
    names = ("trajectory", "body", "controller", "arm")
    return [
        driven(friction, name="friction"),
        driven(friction, name="exact", start=EXACT),
        driven(export_fmu(lugre(), folder / "LuGre.fmu"), name="lugre"),
        driven(export_adaptive(followed(), folder / "Adaptive.fmu"), name="adaptive"),
        *(driven(used[name].fmu, name=name, start=used[name].start) for name in names),
    ]


def of_both_versions(folder: Path) -> dict[str, tuple[Alone, Alone]]:
    """Return each FMU in FMI 2.0 and in FMI 3.0, with the same inputs."""
    table1 = FrictionModel.read(model_file("uf850-table1"))
    robot = Robot(RobotDescription.read(models_folder() / "uf850" / "robot.toml"))
    joints = len(table1.joints)
    contents = {
        "adaptive": adaptive_content(followed()),
        "drive": drive(table1, build_motors(3, inertia=(3.0, 3.0, 0.6), stiffness=(1e4, 2e4, 1e4))),
        "trajectory": trajectory(joints),
        "body": inverse_dynamics(robot, robot.nominal_parameters),
        "controller": controller(joints),
        "velocity": velocity(joints),
        "observer": observer_content(),
    }
    frictions = {"friction": table1, "exact": table1, "lugre": lugre()}
    starts = {"exact": EXACT, "trajectory": start_values(MOTION)}

    def written(name: str, version: Version) -> Path:
        path = folder / f"{name}{version}.fmu"
        if name in frictions:
            return export_bare(frictions[name], path, fmi=version)
        return write_fmu(contents[name], path, fmi=version)

    return {
        name: (
            driven(written(name, 2), name=name, start=starts.get(name)),
            driven(written(name, 3), name=f"{name} 3.0", start=starts.get(name)),
        )
        for name in OF_FMI_3
    }


def lugre() -> FrictionModel:
    form = registry()["lugre"].core({})
    laws = (FrictionLaw(name="lugre", form=form, values=LUGRE),)
    return FrictionModel(law="lugre", robot="bench", joints=("j1",), laws=laws, sample_time=0.005)


def followed() -> FrictionModel:
    """The same law with a thermal model; its noise is the typical deviation of a run's inputs."""
    seen = TrainedRange(
        sample_time=0.005, dq=(-0.5, 0.5), q=(-0.5, 0.5), tau_load=(-0.5, 0.5), tau=(-15, 15)
    )
    thermal = Thermal(coulomb=0.004, viscous=0.02)
    return replace(lugre(), trained=(seen,), training_rmse=(5.0,), thermal=(thermal,))
