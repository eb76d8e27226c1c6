"""Day offsets: an offset of the torque and a level of friction of each log, as nuisances.

    tau = level_k f(...) + offset_k    in log k,    mean of the levels 1, of the offsets 0

Friction falls with temperature, and torque sensors drift. The nuisances are estimated with a coarse
law (Coulomb and viscous friction, alternating least squares) and removed before a law is fitted.
Blind predictions do not use them.
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
_LEAST, _MOST = 0.2, 5.0  # of a level


@dataclass(frozen=True, kw_only=True)
class OwnOfLog:
    """Level of friction [1] and offset [N.m; N] of a log."""

    level: float = 1.0
    offset: float = 0.0


def own_of_logs(
    records: Sequence[FrictionRecord], wanted: Sequence[Nuisance]
) -> dict[str, OwnOfLog]:
    """Estimate the nuisances of each log of a joint by name; a single log has none."""
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
    """Return records without the nuisances of their logs."""
    return [
        replace(record, tau=(record.tau - own[record.log].offset) / own[record.log].level)
        for record in records
    ]


def with_own(
    predicted: Sequence[Array], records: Sequence[FrictionRecord], wanted: Sequence[Nuisance]
) -> list[Array]:
    """Return predictions (N,) [N.m] with fitted nuisances of each log; these are not blind."""
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
    rows = np.concatenate([own[log].level * columns[log] for log in columns])
    target = np.concatenate([torque[log] - own[log].offset for log in columns])
    return np.asarray(np.linalg.lstsq(rows, target, rcond=None)[0])


def own_of_log(predicted: Array, torque: Array, wanted: Sequence[Nuisance]) -> OwnOfLog:
    """Solve for the nuisances of a log, from predicted and measured torque (N,) [N.m]."""
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
    """Normalise to the mean log: level 1 and offset 0."""
    weights = np.array(list(rows.values())) / sum(rows.values())
    level = float(weights @ [o.level for o in own.values()]) if "level" in wanted else 1.0
    offset = float(weights @ [o.offset for o in own.values()]) if "offset" in wanted else 0.0
    return {
        log: OwnOfLog(level=o.level / level, offset=o.offset - offset) for log, o in own.items()
    }
