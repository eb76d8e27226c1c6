"""Alternative plants: the arm of a digital twin with other friction than that of its MJCF.

Dry friction of variable level and, optionally, an elastic transmission replace the passive
dcmotors, which favour bristle laws:

    rotor  --elastic with dead band, in parallel with yielding elements-->  link
    I r'' = servo - level(load) sgn(r') - damping r' - torsion              (dry friction sticks)

Servo, encoder and measured torque are those of the rotor, which takes the joint's name; rigid-body
motion and gravity compensation are those of the link.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Self
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from pydantic import Field, model_validator

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
from hesr_model.errors import ConfigError
from hesr_model.robots.mjcf import compiled
from hesr_model.support.config import Config
from hesr_model.support.files import written_whole

_FIRM = "0.9999 0.9999 0.001 0.5 2"  # highest impedance of dry friction, to avoid creep under load

_LIGHT = {"pos": "0 0 0", "mass": "1e-6", "diaginertia": "1e-6 1e-6 1e-6"}
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
        for table in (gear, *gear.hysteresis) if gear else ():
            require_entries(table, len(self.losses.constant), besides=("hysteresis",))
        return self


TruthName = Annotated[str, Field(pattern=r"^[A-Za-z]\w*$")]


def write_truth(
    truth: Truth, model: Path, joints: tuple[str, ...], table: SignalTable, path: Path
) -> SignalTable:
    """Write the MJCF of an alternative plant to `path` and return the names of its signals."""
    if len(truth.viscous) != len(joints):
        raise ConfigError(
            f"{model}: the truth is of {len(truth.viscous)} joints; {len(joints)} are needed."
        )
    compiled_model = compiled(model)
    tree = ElementTree.parse(model)
    root = tree.getroot()
    gone = _without_elements(root, compiled_model)
    for i, name in enumerate(joints):
        if (joint := root.find(f".//worldbody//joint[@name='{name}']")) is None:
            raise ConfigError(f"{model}: has no joint '{name}', or another file has it.")
        if truth.transmission:
            joint = _divided(root, joint, compiled_model.joint(name), i, truth.transmission)
        joint.attrib |= {
            "damping": repr(truth.viscous[i]),
            "frictionloss": repr(truth.losses.constant[i]),
            "solreffriction": f"{2.0 * compiled_model.opt.timestep!r} 1",
            "solimpfriction": _FIRM,
        }
    with written_whole(path) as temporary:
        tree.write(temporary, encoding="utf-8")
    return _signals(table, joints, gone, truth)


def _without_elements(root: Element, model: Any) -> set[str]:
    elements = {model.actuator(i).name for i in passive_motors(model)}
    gone = set()
    for section in (*root.iterfind("actuator"), *root.iterfind("sensor")):
        for part in list(section):
            reads = part.get("actuator") in elements
            if reads or (part.tag == "dcmotor" and part.get("name") in elements):
                section.remove(part)
            if reads:
                gone.add(part.get("name", ""))
    return gone


def _link(joint: str) -> str:
    return f"{joint}_link"


def _divided(
    root: Element, joint: Element, known: Any, i: int, transmission: GearElasticity
) -> Element:
    """Divide a joint into rotor and link; return the rotor's joint.

    In link coordinates the rotor's reaction is that of a gear, up to one part in the gear ratio.
    """
    name, link = known.name, _link(known.name)
    joint.attrib |= {"name": link, "armature": "0"}
    body = SubElement(_section(root, "worldbody"), "body", name=f"{name}_rotor")
    SubElement(body, "inertial", _LIGHT)
    own = {"name": name, "type": joint.get("type", "hinge"), "axis": "0 0 1"}
    own |= {"armature": repr(float(known.armature[0])), "range": _numbers(known.range)}
    rotor = SubElement(body, "joint", own)
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
    found = root.find(name)
    return SubElement(root, name) if found is None else found


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _signals(
    table: SignalTable, joints: tuple[str, ...], gone: set[str], truth: Truth
) -> SignalTable:

    links = tuple(map(_link, joints)) if truth.transmission else ()

    def output(name: str) -> OutputTable:
        vector = table.outputs[name]
        if name == "tau_f_true":
            update = {"sensors": ({},) * len(joints), "losses": joints, "scaled": ()}
            return vector.model_copy(update=update)
        rows = tuple({s: k for s, k in row.items() if s not in gone} for row in vector.sensors)
        if links and name in ("q_true", "dq_true"):
            rows = tuple({f"{link}_{name.partition('_')[0]}": 1.0} for link in links)
        elif links and name in ("tau_meas", "tau_true"):
            pairs = zip(rows, links, strict=True)
            rows = tuple({**row, f"{link}_torque": 1.0} for row, link in pairs)
        return vector.model_copy(update={"sensors": rows})

    starts = dict(table.start)
    for name, vector in table.start.items() if links else ():
        starts[name] = vector.model_copy(update={"others": tuple(map(_link, vector.joints))})
    return table.model_copy(
        update={
            "outputs": {name: output(name) for name in table.outputs},
            "start": starts,
            "friction": (),
            "losses": LossTable(**truth.losses.model_dump(), joints=joints, carriers=links),
        }
    )
