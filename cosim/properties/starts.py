"""Start in motion: the first torque of a joint that slides already when its simulation begins."""

import numpy as np

from cosim.properties.bench import FrictionBench
from cosim.properties.findings import curve, judged, plot
from cosim.properties.scale import Scale
from hesr_model.audit.expectations import BEGINS
from hesr_model.audit.properties import PropertyResult
from hesr_model.support.arrays import Array

SHARES = np.geomspace(0.05, 1.0, 5)
"""Speeds at which a joint begins, as shares of the trained one."""
_LAST = 1e-3  # [s] of the step at whose end the steady torque is read, as short as a servo's
_NO_FRICTION = 1e-6  # [N.m]


def start(bench: FrictionBench, scale: Scale) -> list[PropertyResult]:
    """Begin in motion at several speeds both ways, and slide on for as long as it takes."""
    dt = np.array([bench.forever, _LAST])
    ends = []
    for speed in SHARES[:, None] * scale.speed:
        for dq in (speed, -speed):
            first = bench.start(load=scale.load, dq=dq)
            ends.append((first, bench.move(dt, np.broadcast_to(dq, (2, len(dq))))[-1]))
    both = np.array(ends).reshape(len(SHARES), 2, 2, bench.joints)
    return [
        _begun(scale.speed[j] * SHARES, both[:, :, 0, j], both[:, :, 1, j])
        for j in range(bench.joints)
    ]


def _begun(speeds: Array, first: Array, steady: Array) -> PropertyResult:
    """Judge (S, 2) first and steady torques at speeds (S,), ahead and back."""
    # Relative to friction, half the difference of both ways: an offset could hide or inflate it.
    friction = np.maximum(0.5 * np.abs(steady[:, 0] - steady[:, 1]), _NO_FRICTION)
    off = (first - steady) / friction[:, None]
    row, way = np.unravel_index(int(np.argmax(np.abs(off))), off.shape)
    worst, speed = float(off[row, way]), float(speeds[row]) * (-1.0 if way else 1.0)
    said = f"At {speed:.3g} rad/s the first torque is off by {worst:.0%}."
    return judged(
        ("largest difference of the first torque, of the friction", abs(worst), "1"),
        ("at a velocity of", speed, "rad/s"),
        wrong=[] if abs(worst) <= BEGINS else [said],  # no number is wrong as well
        plot=plot(
            "velocity",
            "torque",
            curve("first", speeds, first[:, 0]),
            curve("steady", speeds, steady[:, 0]),
        ),
    )
