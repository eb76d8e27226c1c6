"""Effects that the motion of the logs does not show."""

from collections.abc import Iterator, Sequence

import numpy as np

from hesr_model.health.evidence import JointTorque
from hesr_model.health.examine import Examination
from hesr_model.health.torque import Explained
from hesr_model.logs.phases import moving, reversals

_RESTS = 0.02  # share of rests that shows stiction
_REVERSALS = 4
_SLOW, _SLOWLY = 0.1, 0.05  # share of the peak speed, share of slow rows needed
_LOAD = 0.5  # gravity over friction that shows load-dependent friction


def bears_load(fits: Explained) -> bool:
    """Return whether the load of a joint changes enough to show load-dependent friction."""
    return any(fit.bears_gravity and _changes_load(fit) for fit in fits.values())


def _changes_load(fit: JointTorque) -> bool:
    return fit.gravity_size >= _LOAD * fit.friction_size


def unseen(examination: Examination, joints: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield joints with effects that the logs do not show."""
    for j, joint in enumerate(joints):
        parts = [k for k, part in enumerate(examination.parts) if part.moves[j]]
        if not parts:
            yield joint, "it does not move in any log"
            continue
        own = [examination.parts[k].v[:, j] for k in parts]
        v = np.concatenate(own)
        if sum(len(reversals(one)) for one in own) < _REVERSALS:
            yield joint, f"fewer than {_REVERSALS} reversals: neither hysteresis nor an offset"
        if np.mean(~moving(v)) < _RESTS:
            yield joint, "hardly any rest: no stiction"
        if np.mean(np.abs(v) < _SLOW * np.max(np.abs(v))) < _SLOWLY:
            yield joint, "hardly any slow motion: no Stribeck effect"
        fits = [fits[j] for k, fits in enumerate(examination.explained) if k in parts and j in fits]
        if fits and not any(fit.bears_gravity for fit in fits):
            yield joint, "no gravity torque: its torque constant cannot be checked"
        elif fits and not any(map(_changes_load, fits)):
            yield joint, "hardly any change of load: no load-dependent friction"
