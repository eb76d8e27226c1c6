"""Friction over days of logs: factors, alarms and their likely causes."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hesr.extras.adaptive.component import TUNING
from hesr.extras.adaptive.follow import Followed, Follower
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import rmse
from hesr_model.rigid_body.residual import FrictionRecord
from hesr_model.support.arrays import Array

_SHARED = 0.5  # share of joints above which a change is shared
_ESTIMATES = ("level", "level_sd", "viscosity", "viscosity_sd", "offset", "offset_sd")

POINTS_TO = {
    "drift": "wear, damage or heat of this joint",
    "shared drift": "temperature or lubrication: most joints change in the same way",
    "shift": "a payload, a gravity error, or a sensor",
}
"""Likely cause by kind of alarm."""


@dataclass(frozen=True, kw_only=True)
class Alarm:
    """A change of friction at a time [s]; `sign` is 1 for more friction or torque."""

    log: str
    joint: str
    time: float
    kind: str
    sign: int

    @property
    def change(self) -> str:
        """Direction of the change: "more" or "less"."""
        return "more" if self.sign > 0 else "less"

    @property
    def points_to(self) -> str:
        """Likely cause."""
        return POINTS_TO[self.kind]


@dataclass(frozen=True, kw_only=True)
class State:
    """One joint at the end of a log: offset and errors [N.m; N], share of rows with adaptation."""

    log: str
    joint: str
    level: float
    level_sd: float
    viscosity: float
    viscosity_sd: float
    offset: float
    offset_sd: float
    learning: float
    rmse_fixed: float
    rmse: float

    def intervals(self) -> tuple[str, str, str]:
        """Return the factors with two standard deviations."""
        return (
            f"{self.level:.3f} ± {2 * self.level_sd:.3f}",
            f"{self.viscosity:.3f} ± {2 * self.viscosity_sd:.3f}",
            f"{self.offset:.3g} ± {2 * self.offset_sd:.2g}",
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class FollowedLogs:
    """Friction of a robot over logs; `followed` is [log][joint]."""

    model: FrictionModel
    followed: tuple[tuple[Followed, ...], ...]
    states: tuple[State, ...]
    alarms: tuple[Alarm, ...]


def watch(model: FrictionModel, logs: Sequence[Sequence[FrictionRecord]]) -> FollowedLogs:
    """Follow friction over logs [log][joint] in order of time."""
    follower = Follower(model, TUNING)
    followed = tuple(tuple(follower.follow(records)) for records in logs)
    return FollowedLogs(
        model=model,
        followed=followed,
        states=tuple(_state(one) for log in followed for one in log),
        alarms=tuple(alarm for log in followed for alarm in _alarms(log)),
    )


def _state(one: Followed) -> State:
    last = {name: float(column[-1]) for name, column in one.outputs.items()}
    known = np.isfinite(one.record.tau)
    return State(
        log=one.record.log,
        joint=one.record.joint,
        **{name: last[name] for name in _ESTIMATES},
        learning=float(np.mean(one.outputs["health"] == 0.0)),
        rmse_fixed=rmse((one.fixed - one.record.tau)[known]),
        rmse=rmse((one.outputs["tau"] - one.record.tau)[known]),
    )


def _alarms(log: Sequence[Followed]) -> Iterator[Alarm]:
    found = [
        Alarm(
            log=one.record.log,
            joint=one.record.joint,
            time=float(one.record.t[row]),
            kind=kind,
            sign=int(one.outputs[kind][row]),
        )
        for one in log
        for kind in ("drift", "shift")
        for row in _begins(one.outputs[kind])
    ]
    shared = shared_signs(((a.joint, a.sign) for a in found if a.kind == "drift"), len(log))
    for alarm in sorted(found, key=lambda a: a.time):
        kind = "shared drift" if alarm.kind == "drift" and alarm.sign in shared else alarm.kind
        yield replace(alarm, kind=kind)


def shared_signs(drifts: Iterable[tuple[str, int]], joints: int) -> list[int]:
    """Return the signs of drifts (joint, sign) that most joints share."""
    found = set(drifts)
    most = max(1.0, _SHARED * joints)
    return [sign for sign in (1, -1) if sum(own == sign for _, own in found) > most]


def _begins(alarm: Array) -> list[int]:
    before = np.concatenate([[0.0], alarm[:-1]])
    return [int(row) for row in np.flatnonzero((alarm != 0.0) & (alarm != before))]
