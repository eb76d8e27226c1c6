"""Forces of an MJCF that the torque of its robot leaves out, and what each is worth.

The reference is `mj_inverse` with all passive forces and without constraints. What a force is worth
is the largest change of a joint's torque when it alone is removed. Forces that are not named here
are what remains without all of them, so that those of a later MuJoCo are found as well.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hesr_model.support.arrays import Array, Mask

SPRINGS = "stiffness of <joint>"
"""Springs that terms of the robot file can describe."""
DAMPING = "damping of <joint>"
ACTUATOR_DAMPING = "damping of <actuator>"
FRICTION = (DAMPING, ACTUATOR_DAMPING)
"""Forces that the friction laws of the logs describe."""
OTHERS = "another passive force"
_ARRAYS: Mapping[str, tuple[str, ...]] = {
    "gravcomp of <body>": ("body_gravcomp",),
    SPRINGS: ("jnt_stiffness",),
    "higher orders of stiffness of <joint>": ("jnt_stiffnesspoly",),
    DAMPING: ("dof_damping", "dof_dampingpoly"),
    "stiffness of <tendon>": ("tendon_stiffness", "tendon_stiffnesspoly"),
    "damping of <tendon>": ("tendon_damping", "tendon_dampingpoly"),
    "armature of <tendon>": ("tendon_armature",),
    ACTUATOR_DAMPING: ("actuator_damping", "actuator_dampingpoly"),
    "elasticity of <flex>": (
        "flex_stiffness",
        "flex_damping",
        "flex_edgestiffness",
        "flex_edgedamping",
    ),
}
"""Arrays of a compiled model that are 0 without a force, by element and attribute."""
_DIGITS = 1e-9  # of the largest torque; smaller forces are rounding


def measure_forces(
    mj_model: Any, compute: Callable[[Any], Array], own_torques: Array, at_tendons: Mask
) -> dict[str, list[float]]:
    """Return the torque (n,) that each force is worth.

    Parameters
    ----------
    mj_model : compiled model with all its forces.
    compute : torques (N, n) of a model at some states, with passive forces.
    own_torques : (N, n) torques at these states that HESR describes.
    at_tendons : (actuators,) true for actuators that do not act on a joint.
    """
    torques = compute(mj_model)
    worths = {}
    removed = []
    for force, remove in _list_removals(mj_model, at_tendons):
        restore = remove()
        worths[force] = np.abs(torques - compute(mj_model)).max(axis=0)
        removed.append(remove)
        restore()
    for remove in removed:
        remove()
    worths[OTHERS] = np.abs(own_torques - compute(mj_model)).max(axis=0)
    largest = max(np.abs(torques).max(initial=0.0), np.abs(own_torques).max(initial=0.0))
    return {
        force: np.where(worth > _DIGITS * largest, worth, 0.0).tolist()
        for force, worth in worths.items()
        if worth.max(initial=0.0) > _DIGITS * largest
    }


def _list_removals(
    mj_model: Any, at_tendons: Mask
) -> list[tuple[str, Callable[[], Callable[[], None]]]]:
    """Return by force a function that removes it and returns one that restores it."""

    def remove_arrays(*names: str) -> Callable[[], None]:
        arrays = [getattr(mj_model, name) for name in names]
        values = [array.copy() for array in arrays]
        for array in arrays:
            array[...] = 0.0

        def restore() -> None:
            for array, value in zip(arrays, values, strict=True):
                array[...] = value

        return restore

    def remove_fluid() -> Callable[[], None]:
        density = mj_model.opt.density
        viscosity = mj_model.opt.viscosity
        mj_model.opt.density = mj_model.opt.viscosity = 0.0

        def restore() -> None:
            mj_model.opt.density = density
            mj_model.opt.viscosity = viscosity

        return restore

    def remove_tendon_armature() -> Callable[[], None]:
        armature = mj_model.actuator_armature.copy()
        mj_model.actuator_armature[at_tendons] = 0.0

        def restore() -> None:
            mj_model.actuator_armature[:] = armature

        return restore

    removals = [(force, lambda n=names: remove_arrays(*n)) for force, names in _ARRAYS.items()]
    return [
        *removals,
        ("density and viscosity of <option>", remove_fluid),
        ("armature of <actuator> at a tendon", remove_tendon_armature),
    ]
