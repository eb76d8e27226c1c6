"""True friction of an arm: that of its MJCF as a model, and that of alternative plants.

In alternative plants, dry friction of variable level and, optionally, an elastic transmission
replace the passive dcmotors, which favour bristle laws:

    rotor  --elastic with dead band, in parallel with yielding elements-->  link
    I r'' = servo - level(load) sgn(r') - damping r' - torsion              (dry friction sticks)

Servo, encoder and measured torque are those of the rotor, which takes the joint's name; rigid-body
motion and gravity compensation are those of the link.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Self
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import mujoco
import sympy
from pydantic import Field, model_validator
from sympy.codegen.cfunctions import log1p

from fmu_src.arm.losses import AGE, LEVEL, NUMBERS, SPEED, TORQUE, level_steps, renewal_rate
from fmu_src.arm.signals import passive_motors
from fmu_src.arm.table import (
    Losses,
    LossTable,
    NotNegative,
    OutputTable,
    Positive,
    SignalTable,
    require_entries,
)
from hesr_model.equations.functions import absolute, sgn
from hesr_model.equations.memory import Relaxation
from hesr_model.errors import ConfigError
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.robots.mjcf import compile_model
from hesr_model.support.files import written_whole
from hesr_model.support.typed_files import Config

_COEFFICIENTS = (
    ("stiffness", "N.m/rad", "bristle stiffness"),
    ("coulomb", "N.m", "Coulomb friction"),
    ("static", "N.m", "static friction"),
    ("stribeck", "rad/s", "Stribeck velocity"),
    ("damping", "N.m.s/rad", "viscous friction"),
    ("cogging", "N.m", "amplitude of the ripple"),
    ("poles", "1/rad", "ripples in a radian"),
    ("phase", "rad", "phase of the ripple"),
)
_LOSS_COEFFICIENTS = (
    ("constant", "N.m", "dry friction"),
    ("load", "1", "share of the load"),
    ("direct", "N.m", "direct effect of speed"),
    ("speed", "rad/s", "reference speed"),
    ("evolution", "N.m", "effect of age"),
    ("age", "s", "reference age"),
    ("slip", "rad", "slip distance that renews contacts"),
    ("longest", "s", "upper bound of the age"),
    ("viscous", "N.m.s/rad", "viscous friction"),
)


def true_friction(
    mjcf: Path, joints: Sequence[str], *, sample_time: float, losses: LossTable | None = None
) -> FrictionModel:
    """Return the friction of an MJCF's passive dcmotors, or losses and damping, as laws by joint.

    Each dcmotor is a LuGre element without micro-damping, with viscous friction and cogging:

        z' = v - stiffness |v| / g(v) z,  g = coulomb + (static - coulomb) exp(-(v / stribeck)^2)
        tau = stiffness z + damping v - cogging sin(poles q + phase)
    """
    model = compile_model(mjcf)
    slide = mujoco.mjtJoint.mjJNT_SLIDE
    laws = []
    for i, joint in enumerate(joints):
        if losses is not None:
            law = _build_loss_law(losses, i, float(model.joint(joint).damping[0]))
        else:
            law = _law(model, passive_motors(model, joint))
        laws.append(law)
    return FrictionModel(
        law="true_friction",
        robot=mjcf.stem,
        joints=tuple(joints),
        laws=tuple(laws),
        sliding=tuple(bool(model.joint(joint).type[0] == slide) for joint in joints),
        sample_time=sample_time,
    )


def _build_loss_law(losses: LossTable, i: int, viscous: float) -> FrictionLaw:
    coefficients = [Coefficient(name=n, unit=u, description=d) for n, u, d in _LOSS_COEFFICIENTS]
    values = losses.select_joint(i) | {"viscous": viscous}
    *numbers, viscous_symbol = (quantity.symbol for quantity in coefficients)
    symbols = dict(zip(NUMBERS, numbers, strict=True)) | {SPEED: DQ, TORQUE: TAU_LOAD}
    rate = renewal_rate().xreplace(symbols)
    age = Relaxation(name="s", unit="s", drive=sympy.Integer(1), rate=rate)
    symbols[AGE] = age.state
    for symbol, expression in level_steps().items():  # each uses earlier ones only
        symbols[symbol] = expression.xreplace(symbols)
    level = symbols[LEVEL].replace(log1p, lambda x: sympy.log(1 + x))
    output = sgn(DQ) * level + viscous_symbol * DQ
    form = LawForm(coefficients=tuple(coefficients), memory=(age,), output=output)
    return FrictionLaw(name="true_friction", form=form, values=values)


def _law(model: Any, actuators: Sequence[int]) -> FrictionLaw:
    coefficients: list[Coefficient] = []
    values: dict[str, float] = {}
    relaxations: list[Relaxation] = []
    torque = sympy.Integer(0)
    for number, i in enumerate(actuators, start=1):
        bias = model.actuator_biasprm[i]
        dynamics = model.actuator_dynprm[i]
        numbers = (dynamics[5], *bias[3:6], model.actuator_damping[i], *bias[:3])
        element_coefficients = [
            Coefficient(name=f"{name}_{number}", unit=unit, description=f"{text}, element {number}")
            for name, unit, text in _COEFFICIENTS
        ]
        coefficients += element_coefficients
        values |= {
            quantity.name: float(x)
            for quantity, x in zip(element_coefficients, numbers, strict=True)
        }
        stiffness, coulomb, static, stribeck, damping, cogging, poles, phase = (
            quantity.symbol for quantity in element_coefficients
        )
        level = coulomb + (static - coulomb) * sympy.exp(-((DQ / stribeck) ** 2))
        element = Relaxation(
            name=f"z{number}", unit="rad", drive=DQ, rate=stiffness * absolute(DQ) / level
        )
        relaxations.append(element)
        torque += stiffness * element.state + damping * DQ - cogging * sympy.sin(poles * Q + phase)
    form = LawForm(coefficients=tuple(coefficients), memory=tuple(relaxations), output=torque)
    return FrictionLaw(name="true_friction", form=form, values=values)


# The highest impedance of dry friction, to avoid creep under load.
_FRICTION_IMPEDANCE = "0.9999 0.9999 0.001 0.5 2"

_ROTOR_INERTIAL = {"pos": "0 0 0", "mass": "1e-6", "diaginertia": "1e-6 1e-6 1e-6"}
"""Mass [kg] and inertia [kg.m2] of a rotor's body; the armature of its joint is the inertia."""


class Yielding(Config):
    """Yielding elastic elements, one per joint: stiffness [N.m/rad] and yield torque [N.m]."""

    stiffness: tuple[Positive, ...]
    limit: tuple[Positive, ...]


class GearElasticity(Config):
    """Elastic transmissions, one entry per joint [N.m, rad, s]; `backlash` is a dead band."""

    stiffness: tuple[Positive, ...]
    damping: tuple[NotNegative, ...]
    backlash: tuple[NotNegative, ...]
    hysteresis: tuple[Yielding, ...] = ()


class Truth(Config):
    """Friction, at the joints or the rotors of a transmission; `viscous` is in N.m.s/rad."""

    losses: Losses
    viscous: tuple[NotNegative, ...]
    transmission: GearElasticity | None = None

    @model_validator(mode="after")
    def _one_entry_per_joint(self) -> Self:
        require_entries(self, len(self.losses.constant))
        gear = self.transmission
        if gear is not None:
            for table in (gear, *gear.hysteresis):
                require_entries(table, len(self.losses.constant), besides=("hysteresis",))
        return self


TruthName = Annotated[str, Field(pattern=r"^[A-Za-z]\w*$")]


def write_truth(
    truth: Truth, model_path: Path, joints: tuple[str, ...], table: SignalTable, path: Path
) -> SignalTable:
    """Write the MJCF of an alternative plant to `path` and return the names of its signals."""
    if len(truth.viscous) != len(joints):
        raise ConfigError(
            f"{model_path}: the truth is of {len(truth.viscous)} joints; {len(joints)} are needed."
        )
    compiled_model = compile_model(model_path)
    tree = ElementTree.parse(model_path)
    root = tree.getroot()
    removed_sensors = _remove_elements(root, compiled_model)
    for i, name in enumerate(joints):
        joint = root.find(f".//worldbody//joint[@name='{name}']")
        if joint is None:
            raise ConfigError(f"{model_path}: has no joint '{name}', or another file has it.")
        if truth.transmission:
            joint = _divide_joint(root, joint, compiled_model.joint(name), i, truth.transmission)
        joint.attrib |= {
            "damping": repr(truth.viscous[i]),
            "frictionloss": repr(truth.losses.constant[i]),
            "solreffriction": f"{2.0 * compiled_model.opt.timestep!r} 1",
            "solimpfriction": _FRICTION_IMPEDANCE,
        }
    with written_whole(path) as temporary:
        tree.write(temporary, encoding="utf-8")
    return _signals(table, joints, removed_sensors, truth)


def _remove_elements(root: Element, model: Any) -> set[str]:
    elements = {model.actuator(i).name for i in passive_motors(model)}
    removed_sensors = set()
    for section in (*root.iterfind("actuator"), *root.iterfind("sensor")):
        for child in list(section):
            reads = child.get("actuator") in elements
            if reads or (child.tag == "dcmotor" and child.get("name") in elements):
                section.remove(child)
            if reads:
                removed_sensors.add(child.get("name", ""))
    return removed_sensors


def _link(joint: str) -> str:
    return f"{joint}_link"


def _divide_joint(
    root: Element, joint: Element, compiled_joint: Any, i: int, transmission: GearElasticity
) -> Element:
    """Divide a joint into rotor and link; return the rotor's joint.

    In link coordinates the rotor's reaction is that of a gear, up to one part in the gear ratio.
    """
    name = compiled_joint.name
    link = _link(compiled_joint.name)
    joint.attrib |= {"name": link, "armature": "0"}
    body = SubElement(_section(root, "worldbody"), "body", name=f"{name}_rotor")
    SubElement(body, "inertial", _ROTOR_INERTIAL)
    attributes = {"name": name, "type": joint.get("type", "hinge"), "axis": "0 0 1"}
    attributes |= {
        "armature": repr(float(compiled_joint.armature[0])),
        "range": _numbers(compiled_joint.range),
    }
    rotor = SubElement(body, "joint", attributes)
    half = transmission.backlash[i] / 2.0
    damping = {"damping": repr(transmission.damping[i]), "springlength": _numbers((-half, half))}
    springs = {"torsion": {"stiffness": repr(transmission.stiffness[i]), **damping}}
    for k, element in enumerate(transmission.hysteresis, start=1):
        deflection = {"springyield": repr(element.limit[i] / element.stiffness[i])}
        springs[f"hysteresis{k}"] = {"stiffness": repr(element.stiffness[i]), **deflection}
    for suffix, spring in springs.items():
        tendon = SubElement(
            _section(root, "tendon"), "fixed", {"name": f"{name}_{suffix}", **spring}
        )
        SubElement(tendon, "joint", joint=name, coef="1")
        SubElement(tendon, "joint", joint=link, coef="-1")
    for suffix, kind in (("q", "jointpos"), ("dq", "jointvel"), ("torque", "jointactuatorfrc")):
        SubElement(_section(root, "sensor"), kind, name=f"{link}_{suffix}", joint=link)
    return rotor


def _section(root: Element, name: str) -> Element:
    section = root.find(name)
    if section is None:
        return SubElement(root, name)
    return section


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _signals(
    table: SignalTable, joints: tuple[str, ...], removed_sensors: set[str], truth: Truth
) -> SignalTable:
    """Return the signals of an alternative plant, from those of the arm that it replaces."""
    links: tuple[str, ...] = ()
    starts = dict(table.start)
    if truth.transmission is not None:
        links = tuple(map(_link, joints))
        for name, vector in table.start.items():
            others = tuple(map(_link, vector.joints))
            starts[name] = vector.model_copy(update={"others": others})
    outputs = {}
    for name, output in table.outputs.items():
        if name == "tau_f_true":
            update = {"sensors": ({},) * len(joints), "losses": joints, "scaled": ()}
        else:
            update = {"sensors": _select_sensors(name, output, links, removed_sensors)}
        outputs[name] = output.model_copy(update=update)
    losses = LossTable(**truth.losses.model_dump(), joints=joints, carriers=links)
    return table.model_copy(
        update={"outputs": outputs, "start": starts, "friction": (), "losses": losses}
    )


def _select_sensors(
    name: str, output: OutputTable, links: tuple[str, ...], removed_sensors: set[str]
) -> tuple[dict[str, float], ...]:
    """Return the summed sensors of each element: true motion is that of the links, if any."""
    if links and name in ("q_true", "dq_true"):
        quantity, _, _ = name.partition("_")
        return tuple({f"{link}_{quantity}": 1.0} for link in links)
    rows = [_remove_sensors(row, removed_sensors) for row in output.sensors]
    if links and name in ("tau_meas", "tau_true"):
        for row, link in zip(rows, links, strict=True):
            row[f"{link}_torque"] = 1.0
    return tuple(rows)


def _remove_sensors(row: Mapping[str, float], removed_sensors: set[str]) -> dict[str, float]:
    return {sensor: factor for sensor, factor in row.items() if sensor not in removed_sensors}
