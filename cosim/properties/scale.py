"""The sizes to which the experiments on a law are scaled, measured on its FMU."""

from dataclasses import dataclass

import numpy as np

from cosim.properties.bench import FrictionBench
from hesr_model.audit.cycles import ENCODER
from hesr_model.support.arrays import Array

CREEP = 0.01
"""Slow sliding, as a share of the largest trained speed."""
SLIDING = 0.1
"""Sliding at which the friction level is taken, as a share of that speed."""
DEFLECTION = 1e-3
"""Amplitude of pre-sliding motions [rad] where a law shows no deflection of its own."""

_NO_FRICTION = 1e-6  # [N.m]; a level of less would divide by nothing
_SHARES = np.geomspace(1e-3, 1.0, 31)
_DEFLECTIONS = (ENCODER, 1e-2)  # [rad] that are taken for one: an encoder sees no less
_BACK = np.geomspace(1e-7, 0.5, 100)  # [rad] after a reversal


@dataclass(frozen=True, kw_only=True, eq=False)
class Scale:
    """Sizes of a model's joints; all arrays are (n,) unless said otherwise.

    Attributes
    ----------
    speed : largest trained speed, or what stands in for it [rad/s].
    speeds : (S, n) at which steady sliding was measured [rad/s].
    steady : (S, n) its torque, half the difference of both ways [N.m].
    level : its size at `SLIDING` [N.m].
    offset : mean of both ways there [N.m].
    load : load torque that was held [N.m].
    deflection : amplitude of pre-sliding motions [rad].
    """

    speed: Array
    speeds: Array
    steady: Array
    level: Array
    offset: Array
    load: float
    deflection: Array

    @property
    def drives(self) -> Array:
        """Whether slow steady sliding to and fro gives energy, (n,) without unit."""
        return np.asarray((self.steady[_SHARES <= SLIDING * 1.001] < 0.0).any(axis=0))

    @property
    def bears(self) -> Array:
        """(n,) [N.m] what friction bears at rest: the level, or less where it rises with speed."""
        slowest = np.abs(self.steady[0])
        return np.where(slowest > _NO_FRICTION, np.minimum(self.level, slowest), self.level)

    def steady_at(self, speeds: Array, joint: int) -> Array:
        """Return the steady torque (N,) [N.m] of a joint at speeds (N,) [rad/s].

        It is interpolated between those that were measured.
        """
        return np.interp(speeds, self.speeds[:, joint], self.steady[:, joint])


def measure_scale(bench: FrictionBench, speed: Array, load: float) -> Scale:
    """Slide and turn the joints of a friction FMU, and see how large its torques are.

    Parameters
    ----------
    bench : with the FMU.
    speed : (n,) largest trained speed of each joint [rad/s].
    load : load torque of every joint [N.m].
    """
    speeds = _SHARES[:, None] * speed
    both = []
    for sign in (1.0, -1.0):
        bench.start(load=load)
        both.append(bench.move(np.full(len(speeds), bench.forever), sign * speeds))
    steady, offset = 0.5 * (both[0] - both[1]), 0.5 * (both[0] + both[1])
    at = int(np.argmin(np.abs(_SHARES - SLIDING)))
    creep = CREEP * speed
    bench.start(load=load)
    before = bench.move(np.array([bench.forever]), creep[None])[0]
    # A time for each share of the way, so that all joints take it at once.
    back = _BACK / np.max(creep)
    tau = bench.move(np.diff(back, prepend=0.0), np.broadcast_to(-creep, (len(back), len(creep))))
    return Scale(
        speed=speed,
        speeds=speeds,
        steady=steady,
        level=np.maximum(np.abs(steady[at]), _NO_FRICTION),
        offset=offset[at],
        load=load,
        deflection=_deflections(before, tau, back[:, None] * creep),
    )


def _deflections(before: Array, tau: Array, way: Array) -> Array:
    """Return where the torque (K, n) has turned half around after a reversal [rad]."""
    turned = (before - tau) / np.where(before == tau[-1], 1.0, before - tau[-1])
    first = np.argmax(turned >= 0.5, axis=0)
    found = way[first, np.arange(len(before))]
    inside = (found >= _DEFLECTIONS[0]) & (found <= _DEFLECTIONS[1])
    return np.where(inside, found, DEFLECTION)
