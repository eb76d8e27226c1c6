"""Dissipation over cycles driven by torque."""

import numpy as np

from hesr.extras.properties.bench import DriveBench
from hesr.extras.properties.findings import curve, judged, plot
from hesr.extras.properties.scale import Scale
from hesr_model.audit.expectations import PASSIVE
from hesr_model.audit.properties import PropertyResult
from hesr_model.support.arrays import Array

AMPLITUDES = (0.02, 0.5, 2.0)  # in friction levels: pre-sliding, half the level, sliding
FREQUENCY = 1.0  # [Hz] of the torque; the load has twice as much
PHASES = (0.5 * np.pi, 1.5 * np.pi)  # load phase [rad]
_STEP = 4e-3  # [s] communication and inner step: rows contain all work
_ROWS = round(1.0 / (FREQUENCY * _STEP))  # per cycle
_CYCLES, _MEASURED = 10, 4
_SPRING = 20.0  # stretch at the friction level, in deflections


def dissipation(
    bench: DriveBench, scale: Scale, peaks: Array, loaded: Array
) -> list[PropertyResult]:
    """Drive spring-held joints back and forth and sum up the work of their friction.

    The load of `loaded` (n,) laws moves between 0 and `peaks` (n,) [N.m].
    """
    angle = 2.0 * np.pi / _ROWS * np.arange(1, _ROWS * _CYCLES + 1)
    dt = np.full(len(angle), _STEP)
    worst = np.full(bench.joints, -np.inf)
    shown: list[tuple[Array, Array]] = [(np.empty(0), np.empty(0))] * bench.joints
    at = np.zeros(bench.joints)
    for share in AMPLITUDES:
        for phase in PHASES[: 2 if loaded.any() else 1]:
            load = 0.5 * peaks * (1.0 + np.cos(2.0 * angle + phase))[:, None]
            load = np.where(loaded, load, scale.load)
            torque = scale.offset + share * np.sin(angle)[:, None] * scale.level
            bench.start(
                load=load[-1],
                torque=scale.offset,
                stiffness=scale.level / (_SPRING * scale.deflection),
                substep=_STEP,
            )
            q, dq, tau = (
                part[-_MEASURED * _ROWS :] for part in bench.run(dt, torque=torque, load=load)
            )
            # An offset does no work over a closed cycle.
            given = -((tau - scale.offset) * dq).sum(axis=0) * _STEP / _MEASURED
            given = np.where(np.isfinite(given), given, np.inf)
            for j in np.flatnonzero(given > worst):
                worst[j], at[j] = given[j], share
                shown[j] = (q[-_ROWS:, j] - bench.places[j], tau[-_ROWS:, j])
    return [_given(float(worst[j]), float(at[j]), *shown[j]) for j in range(bench.joints)]


def _given(given: float, share: float, q: Array, tau: Array) -> PropertyResult:
    said = f"Under a torque of {share:g} levels it generates {given:.3g} J per cycle."
    return judged(
        ("most energy given in a cycle", max(0.0, given), "J"),
        ("amplitude of the torque, of the level", share, "1"),
        wrong=[said] if given > PASSIVE else [],
        plot=plot("position", "torque", curve("", 1e3 * q, tau, closed=True)),
    )
