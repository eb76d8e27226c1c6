"""Shapes of an arm."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from hesr_model.errors import RobotError

Colour = tuple[float, float, float, float]

_LINK = 0.045  # radius of links over the reach of the arm
_JOINT = 1.35  # radius of joints over that of links
_END = 1.1  # radius of the ball at the end over that of links
_SMALL = 1e-3  # over the reach: shorter links are not drawn


@dataclass(frozen=True, kw_only=True)
class Paint:
    """Colours of an arm, and a factor on thickness."""

    links: Colour
    joints: Colour
    end: Colour
    thick: float = 1.0


def arm(mjcf: str, joints: Sequence[str], *, paint: Paint) -> Any:
    """Return an arm as an MjSpec with only bodies, joints and shapes.

    Without own shapes, capsules between the joints are drawn.
    """
    try:
        spec = mujoco.MjSpec.from_string(mjcf)
        _strip(spec)
        for name in joints:
            if spec.joint(name) is None:
                raise RobotError(f"the arm's model has no joint '{name}', so it cannot be shown.")
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise RobotError(f"the arm's model cannot be shown ({reason}).") from error
    if spec.geoms:
        for geom in spec.geoms:
            geom.rgba, geom.material = paint.links, ""
    else:
        _draw(spec, reach(model), paint)
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    return spec


def reach(model: mujoco.MjModel) -> float:
    """Return the sum of the link lengths [m]."""
    return float(np.linalg.norm(model.body_pos, axis=1).sum()) or 1.0


def _strip(spec: Any) -> None:
    files = (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF)
    elements = (
        *(spec.sensors, spec.actuators, spec.tendons, spec.equalities, spec.pairs, spec.excludes),
        *(spec.keys, spec.cameras, spec.lights, spec.skins, spec.flexes),
        *([geom for geom in spec.geoms if geom.type in files], spec.meshes, spec.hfields),
    )
    for group in elements:
        for element in list(group):
            spec.delete(element)
    # Nothing is simulated; all options must be those of the scene.
    usual = mujoco.MjSpec().option
    for name in (name for name in dir(usual) if not name.startswith("_")):
        setattr(spec.option, name, getattr(usual, name))


def _draw(spec: Any, length: float, paint: Paint) -> None:
    radius = _LINK * length * paint.thick
    for body in _below(spec.worldbody):
        for child in body.bodies:
            if np.linalg.norm(child.pos) > _SMALL * length:
                body.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                    fromto=[0.0, 0.0, 0.0, *child.pos],
                    size=[radius, 0.0, 0.0],
                    rgba=paint.links,
                    mass=0.0,
                )
        for joint in body.joints:
            turns = joint.type == mujoco.mjtJoint.mjJNT_HINGE
            half = (1.2 if turns else 2.0) * radius * np.array(joint.axis)
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CYLINDER if turns else mujoco.mjtGeom.mjGEOM_BOX,
                fromto=[*(joint.pos - half), *(joint.pos + half)],
                size=[radius * (_JOINT if turns else 0.8), radius * 0.8, 0.0],
                rgba=paint.joints,
                mass=0.0,
            )
        if not body.bodies:
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                size=[_END * radius, 0.0, 0.0],
                rgba=paint.end,
                mass=0.0,
            )


def _below(body: Any) -> Iterator[Any]:
    for child in body.bodies:
        yield child
        yield from _below(child)
