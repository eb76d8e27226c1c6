"""Friction of one joint in one log."""

from dataclasses import dataclass, replace
from typing import Any

from hesr_model.robots.transmission import Coupling
from hesr_model.support.arrays import Array, Mask, select_rows


@dataclass(frozen=True, kw_only=True, eq=False)
class FrictionRecord:
    """Friction of one joint in one log (eq. 8), unsmoothed, on the log's own rows.

    Attributes
    ----------
    log, joint : names.
    t : (N,) time [s].
    dq : (N,) smoothed velocity [rad/s].
    q : (N,) raw position [rad].
    tau_load : (N,) rigid-body torque [N.m], the load of friction; that of the
        pressures of a cylinder.
    tau : (N,) friction [N.m].
    tau_load_spread : (N, r) error of `tau_load` [N.m] for one standard
        deviation of each independent error of the rigid body.
    gear_ratio : turns of the motor per turn of the joint.
    sliding : True for a prismatic joint, which has m and N.
    temperature : (N,) of the joint [degC].
    coupling : None if uncoupled, and after `transform_records`.
    dq_causal : (N,) velocity behind a causal low pass [rad/s].
    tau_body : (N,) force on the bodies [N] of a cylinder; None if it is
        `tau_load`.
    """

    log: str
    joint: str
    t: Array
    dq: Array
    q: Array
    tau_load: Array
    tau: Array
    tau_load_spread: Array | None = None
    gear_ratio: float | None = None
    sliding: bool = False
    temperature: Array | None = None
    coupling: Coupling | None = None
    dq_causal: Array | None = None
    tau_body: Array | None = None

    @property
    def measured(self) -> Array:
        """The whole torque (N,) [N.m]."""
        return self.tau + self.of_bodies

    @property
    def of_bodies(self) -> Array:
        """The torque that the rigid bodies need, (N,) [N.m]."""
        if self.tau_body is None:
            return self.tau_load
        return self.tau_body

    @property
    def causal(self) -> "FrictionRecord":
        """The record with the velocity that a user of an FMU has, if known."""
        if self.dq_causal is None:
            return self
        return replace(self, dq=self.dq_causal)

    @property
    def motion(self) -> dict[str, Any]:
        """Inputs of laws by name, (N,) each."""
        return {name: getattr(self, name) for name in ("t", "dq", "q", "tau_load")}

    def rows(self, rows: slice | Mask) -> "FrictionRecord":
        """Return some of the rows."""
        return select_rows(self, rows)
