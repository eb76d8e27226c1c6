"""Creep of MuJoCo's Coulomb friction, which is a soft constraint."""

from hesr.extras.reduction.projection import ReducedJoint

STEP = 0.002  # [s], MuJoCo's own
DEFAULT_SOLREF = "0.02 1"
SOLREF = "0.004 1"
"""Time constant of two steps, the least that MuJoCo accepts, and damping ratio."""
_HELD_SHARE = 0.5  # of the Coulomb friction
_DURATION = 1.0  # [s], long against any time constant of the constraint


def simulate_creep(joint: ReducedJoint, *, solref: str = SOLREF) -> float:
    """Return the speed [rad/s] of a held joint that slips in MuJoCo.

    Parameters
    ----------
    joint : with Coulomb friction and inertia, half of whose friction is applied.
    solref : `solreffriction` of the joint.
    """
    import mujoco

    kind = "slide" if joint.sliding else "hinge"
    armature = joint.armature or 0.0
    link_inertia = max(joint.inertia - armature, 1e-3 * joint.inertia)
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="{STEP!r}" gravity="0 0 0"/><worldbody><body>
        <inertial pos="0 0 0" mass="{link_inertia!r}"
            diaginertia="{link_inertia!r} {link_inertia!r} {link_inertia!r}"/>
        <joint type="{kind}" axis="0 0 1" frictionloss="{joint.frictionloss!r}"
            damping="{joint.damping!r}" armature="{armature!r}" solreffriction="{solref}"/>
        </body></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    data.qfrc_applied[0] = _HELD_SHARE * joint.frictionloss
    mujoco.mj_step(model, data, round(_DURATION / STEP))
    return abs(float(data.qvel[0]))
