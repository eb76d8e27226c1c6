"""Logs differ by day: an offset of the torque and a level of friction of each log, as nuisances.

    tau = level_k f(...) + offset_k    in log k,    mean of the levels 1, of the offsets 0

A warm gear rubs less than a cold one, and torque sensors drift. Where logs of several days are
trained on together, a law that must hold them all holds none. What is each log's own is estimated
with a coarse law (Coulomb and viscous friction, alternating least squares) and taken out before a
law is fitted; of a log that no fit has seen it is not known, so that blind predictions go without.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from hesr_model.logs.phases import MOVING
from hesr_model.rigid_body.residual import FrictionRecord
from hesr_model.support.arrays import Array

Nuisance = Literal["offset", "level"]

_ROUNDS = 30
_LEAST, _MOST = 0.2, 5.0
"""Of a level: beyond, a log is of another robot."""


@dataclass(frozen=True, kw_only=True)
class OwnOfLog:
    """What is a log's own: level of friction, without unit, and offset [N.m; N]."""

    level: float = 1.0
    offset: float = 0.0


def own_of_logs(
    records: Sequence[FrictionRecord], wanted: Sequence[Nuisance]
) -> dict[str, OwnOfLog]:
    """Estimate what is each log's own, by its name; parts of one log share it.

    Parameters
    ----------
    records : of one joint. With those of a single log nothing can be its own.
    wanted : which of both are estimated.
    """
    logs = list(dict.fromkeys(record.log for record in records))
    if len(logs) < 2 or not wanted:
        return {log: OwnOfLog() for log in logs}
    of_log = {log: [record for record in records if record.log == log] for log in logs}
    columns = {log: np.concatenate([_coarse(r.dq) for r in own]) for log, own in of_log.items()}
    torque = {log: np.concatenate([r.tau for r in own]) for log, own in of_log.items()}
    own = dict.fromkeys(logs, OwnOfLog())
    for _ in range(_ROUNDS):
        law = _law(columns, torque, own)
        predicted = {log: columns[log] @ law for log in logs}
        own = _normalised(
            {log: own_of_log(predicted[log], torque[log], wanted) for log in logs},
            {log: len(torque[log]) for log in logs},
            wanted,
        )
    return own


def without_own(
    records: Sequence[FrictionRecord], own: Mapping[str, OwnOfLog]
) -> list[FrictionRecord]:
    """Return records (N,) [N.m] as they would be without what is their logs' own."""
    return [
        replace(record, tau=(record.tau - own[record.log].offset) / own[record.log].level)
        for record in records
    ]


def with_own(
    predicted: Sequence[Array], records: Sequence[FrictionRecord], wanted: Sequence[Nuisance]
) -> list[Array]:
    """Fit what is each log's own to a prediction (N,) [N.m] of its torque, and put it in.

    What comes out has seen the torque that it is compared with: a figure of it is not blind.
    """
    logs = list(dict.fromkeys(record.log for record in records))
    found = {}
    for log in logs:
        of_log = [k for k, record in enumerate(records) if record.log == log]
        found[log] = own_of_log(
            np.concatenate([predicted[k] for k in of_log]),
            np.concatenate([records[k].tau for k in of_log]),
            wanted,
        )
    return [
        found[record.log].level * torque + found[record.log].offset
        for torque, record in zip(predicted, records, strict=True)
    ]


def _coarse(dq: Array) -> Array:
    return np.column_stack([np.tanh(dq / MOVING), dq, np.ones_like(dq)])


def _law(
    columns: Mapping[str, Array], torque: Mapping[str, Array], own: Mapping[str, OwnOfLog]
) -> Array:
    """Solve the coarse law, what is the logs' own being known."""
    rows = np.concatenate([own[log].level * columns[log] for log in columns])
    target = np.concatenate([torque[log] - own[log].offset for log in columns])
    return np.asarray(np.linalg.lstsq(rows, target, rcond=None)[0])


def own_of_log(predicted: Array, torque: Array, wanted: Sequence[Nuisance]) -> OwnOfLog:
    """Solve what is a log's own, its torque by the law (N,) and as measured (N,) known [N.m]."""
    if "level" not in wanted:
        return OwnOfLog(offset=float(np.mean(torque - predicted)))
    columns = [predicted, np.ones_like(predicted)][: 2 if "offset" in wanted else 1]
    x = np.linalg.lstsq(np.column_stack(columns), torque, rcond=None)[0]
    level = float(np.clip(x[0], _LEAST, _MOST))
    offset = float(np.mean(torque - level * predicted)) if "offset" in wanted else 0.0
    return OwnOfLog(level=level, offset=offset)


def _normalised(
    own: Mapping[str, OwnOfLog], rows: Mapping[str, int], wanted: Sequence[Nuisance]
) -> dict[str, OwnOfLog]:
    """Make the mean level 1 and the mean offset 0, so that the law is that of the mean log."""
    weights = np.array(list(rows.values())) / sum(rows.values())
    level = float(weights @ [o.level for o in own.values()]) if "level" in wanted else 1.0
    offset = float(weights @ [o.offset for o in own.values()]) if "offset" in wanted else 0.0
    return {
        log: OwnOfLog(level=o.level / level, offset=o.offset - offset) for log, o in own.items()
    }
