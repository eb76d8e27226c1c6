"""Artefacts of the acceptance matrix: laws with structures, in every format."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from acceptance.cells import NO_FMI, Scope
from closed_loop import build

from cosim.loop.closed_loop import Scheme
from cosim.systems.system import SystemSpec
from fmu_src.export.package import Version
from fmu_src.friction.friction_fmu import export_bare, export_fmu
from fmu_src.plant.plant_fmu import PlantBody, export_plant
from hesr.extras.adaptive.monitor import export_adaptive
from hesr.extras.drive.drive_fmu import export_drive
from hesr.extras.observer.observation import export_observer
from hesr_model.equations.memory import Stop
from hesr_model.fitting.estimator import Estimator, registry
from hesr_model.friction.band import Band
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.robots.transmission import Coupling, Transmission
from hesr_model.support.files import models_folder

STEP = 0.005
"""Communication step [s]."""

_SMALL = {"lag", "smoothing", "v_s", "v_a", "deflection"}
_ARM = """<mujoco model="arm"><compiler angle="radian"/><worldbody>{links}</worldbody></mujoco>"""
_LINK = """<body pos="0.1 0 0.3" euler="0.4 0.3 0.2">
<joint name="j{k}" axis="{axis}" armature="0.5"/>
<geom size=".05 .2" type="capsule" pos=".13 .02 .11" mass="2.3"/>"""
_AXES = ("0 0 1", "0 1 0", "0 1 0")
_TRAINED = TrainedRange(
    sample_time=STEP, dq=(-1.0, 1.0), q=(-1.0, 1.0), tau_load=(-9.0, 9.0), tau=(-9.0, 9.0)
)
_BAND = Band(
    floor=0.7, slow=1.3, slow_speed=0.02, rest=0.4, fast=0.5, load=0.05, tail=0.7, envelope=1.0
)
_KV = (90.5, 150.8, 52.8)
_TURNS = ((1.0, 0.0, 0.0), (0.25, 1.0, 0.0), (0.0, -0.8, 1.0))

# --- laws and structures --------------------------------------------------------------------------


def _usual_size(coefficient: str) -> float:
    """Return a value of a usual size; without an offset a servo carries all torques at rest."""
    if coefficient == "tau_0":
        return 0.0
    if coefficient == "sigma_0" or coefficient.startswith("kappa"):
        return 300.0
    if coefficient.startswith("mu"):
        return 0.05  # friction that grows faster than its load jams, and motion is chaotic
    return 0.01 if coefficient in _SMALL else 0.5


def typical_law(name: str) -> FrictionLaw:
    """Return a law of the typical structure with coefficients of a usual size."""
    estimator: type[Estimator] = registry()[name]
    structure = dict(estimator.typical)
    form = estimator.form(structure)
    values = {c.name: _usual_size(c.name) for c in form.coefficients}
    return FrictionLaw(name=name, structure=structure, form=form, values=values, band=_BAND)


def model_of(law: str, others: tuple[str, ...] = (), joints: int = 3) -> FrictionModel:
    """Return a model with one law on all joints, or with others on the last joints."""
    names = (law,) * (joints - len(others)) + others
    of_uf850 = RobotDescription.read(models_folder() / "uf850" / "robot.toml").joints
    return FrictionModel(
        law="recommended" if others else law,
        robot="arm",
        joints=of_uf850 if joints == 3 else tuple(f"j{k}" for k in range(1, joints + 1)),
        laws=tuple(typical_law(name) for name in names),
        sample_time=STEP,
        trained=(_TRAINED,) * joints,
        training_rmse=(0.1,) * joints,
    )


STRUCTURES: Mapping[str, Callable[[str], FrictionModel]] = {
    "one joint": lambda law: model_of(law, joints=1),
    "six joints": lambda law: model_of(law, joints=6),
    "mixed laws": lambda law: model_of(law, ("lugre", "parfam_s_v")),
    "coupled joints": lambda law: replace(model_of(law), coupling=Coupling(_TURNS)),
    "ripple": model_of,
    "load": model_of,
}
"""Models by structure; the last two exist for laws that have such a term."""


def structures_of(law: str) -> list[str]:
    """Return the structures that a law can have."""
    form = typical_law(law).form
    has_term = {
        "ripple": any(c.name.startswith("ripple") for c in form.coefficients),
        "load": "tau_load" in map(str, form.inputs),
    }
    return [name for name in STRUCTURES if has_term.get(name, True)]


def adapts(law: str) -> bool:
    """Return whether a law has friction that an adaptive FMU can scale."""
    memory = typical_law(law).form.memory
    return any(isinstance(m, Stop) or DQ not in m.drive.diff(DQ).free_symbols for m in memory)


def arm_of(model: FrictionModel, folder: Path) -> Robot:
    """Return the UF850 for three joints, else a chain of links, with the coupling of a model."""
    joints = len(model.joints)
    description = RobotDescription.read(models_folder() / "uf850" / "robot.toml")
    if joints != len(description.joints):
        opened = [_LINK.format(k=k, axis=_AXES[k % 3]) for k in range(1, joints + 1)]
        path = folder / "arm.xml"
        links = "".join(opened) + "</body>" * joints
        path.write_text(_ARM.format(links=links), encoding="utf-8")
        return Robot(RobotDescription(name="arm", model=path, joints=model.joints))
    if model.coupling is not None:
        description = description.model_copy(update={"transmission": Transmission(matrix=_TURNS)})
    return Robot(description)


# --- formats --------------------------------------------------------------------------------------

Export = Callable[[FrictionModel, Path, Version], Path]


def _friction(model: FrictionModel, folder: Path, fmi: Version) -> Path:
    return export_bare(model, folder / "Friction.fmu", fmi=fmi)


def _friction_with_outputs(model: FrictionModel, folder: Path, fmi: Version) -> Path:
    path = folder / "Friction.fmu"
    more = {"power": True, "band": True, "no_documentation": True}
    return export_fmu(model, path, low_pass=20.0, fmi=fmi, **more)


def _adaptive(model: FrictionModel, folder: Path, fmi: Version) -> Path:
    return export_adaptive(model, folder / "Adaptive.fmu", fmi=fmi)


def _drive(model: FrictionModel, folder: Path, fmi: Version) -> Path:
    inertia = [0.5] * len(model.joints)
    return export_drive(model, folder / "Drive.fmu", inertia=inertia, bare=True, fmi=fmi)


def _elastic_drive(model: FrictionModel, folder: Path, fmi: Version) -> Path:
    one = [1.0] * len(model.joints)
    return export_drive(
        model,
        folder / "Drive.fmu",
        inertia=[0.5 * x for x in one],
        stiffness=[1e4 * x for x in one],
        damping=one,
        bare=True,
        fmi=fmi,
    )


def _plant(model: FrictionModel, folder: Path, fmi: Version) -> Path:
    body = PlantBody.from_robot(arm_of(model, folder))
    return export_plant(model, folder / "Plant.fmu", plant_body=body, bare=True, fmi=fmi)


def _servo_plant(model: FrictionModel, folder: Path, fmi: Version) -> Path:
    body = PlantBody.from_robot(arm_of(model, folder))
    joints = range(len(model.joints))
    gains = {"kv": [_KV[j % 3] for j in joints], "ki": [10.0 * _KV[j % 3] for j in joints]}
    return export_plant(model, folder / "Plant.fmu", plant_body=body, bare=True, fmi=fmi, **gains)


def _observer(model: FrictionModel, folder: Path, fmi: Version) -> Path:
    body = PlantBody.from_robot(arm_of(model, folder))
    return export_observer(model, folder / "Observer.fmu", plant_body=body, fmi=fmi)


FMUS: Mapping[str, Export] = {
    "fmu": _friction,
    "fmu with band": _friction_with_outputs,
    "adaptive": _adaptive,
    "drive": _drive,
    "elastic drive": _elastic_drive,
    "plant": _plant,
    "plant with servo": _servo_plant,
    "observer": _observer,
}
"""Formats that are one FMU."""

LOWERED: Mapping[str, str] = {
    "mujoco-plugin": "mujoco",
    "c": "c_header",
    "torch": "torch",
    "jax": "jax",
}
"""Formats without FMI whose torques are compared with the law, by their names in `LOWERINGS`."""

LAWS = tuple(registry())
_EVERY = tuple(STRUCTURES)
_UNCOUPLED = tuple(name for name in STRUCTURES if name != "coupled joints")
_OF_THREE_JOINTS = tuple(name for name in STRUCTURES if name not in ("one joint", "six joints"))

SCOPES: Mapping[str, Scope] = {
    **dict.fromkeys(FMUS, Scope(_EVERY)),
    "adaptive": Scope(_UNCOUPLED, refused_laws=tuple(law for law in LAWS if not adapts(law))),
    "observer": Scope(_UNCOUPLED),
    "loop": Scope(_OF_THREE_JOINTS, versions=(2,), corners=("defaults",)),
    **dict.fromkeys(
        (*LOWERED, "modelica"), Scope(_UNCOUPLED, versions=(NO_FMI,), corners=("defaults",))
    ),
}
"""Structures, versions and corners of each format."""


def write_loop(model: FrictionModel, folder: Path) -> SystemSpec:
    """Write the closed loop of the UF850 with a friction model."""
    bench = build(folder, model)
    loop = bench.loop(Scheme(compensation="servo_inversion", Kx=5.0))
    return bench.system(loop).model_copy(update={"name": "closed", "stop": 0.1})
