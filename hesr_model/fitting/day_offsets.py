"""Day offsets: an offset of the torque and a level of friction of each log, as nuisances.

tau = level_k f(...) + offset_k    in log k,    mean of the levels 1, of the offsets 0
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from hesr_model.fitting.joint_rows import log_of_rows
from hesr_model.logs.phases import MOVING
from hesr_model.rigid_body.residual import FrictionRecord
from hesr_model.support.arrays import Array, Integers

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
    own = [OwnOfLog() for _ in logs]
    if len(logs) > 1 and wanted:
        log, torque = log_of_rows(records), np.concatenate([r.tau for r in records])
        dq = np.concatenate([r.dq for r in records])
        columns = np.column_stack([np.tanh(dq / MOVING), dq, np.ones_like(dq)])
        for _ in range(_ROUNDS):
            level, offset = _of_rows(own, log)
            law = np.linalg.lstsq(level[:, None] * columns, torque - offset, rcond=None)[0]
            own = _normalised(_fitted(columns @ law, torque, log, wanted), np.bincount(log), wanted)
    return dict(zip(logs, own, strict=True))


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
    log, whole = log_of_rows(records), np.concatenate(predicted)
    own = _fitted(whole, np.concatenate([r.tau for r in records]), log, wanted)
    ends = np.cumsum([len(torque) for torque in predicted])
    level, offset = _of_rows(own, log)
    return np.split(level * whole + offset, ends[:-1])


def _of_rows(own: Sequence[OwnOfLog], log: Integers) -> Array:
    return np.array([[o.level, o.offset] for o in own])[log].T


def _fitted(
    predicted: Array, torque: Array, log: Integers, wanted: Sequence[Nuisance]
) -> list[OwnOfLog]:
    rows = (log == k for k in range(log[-1] + 1))
    return [own_of_log(predicted[own], torque[own], wanted) for own in rows]


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
    own: Sequence[OwnOfLog], rows: Integers, wanted: Sequence[Nuisance]
) -> list[OwnOfLog]:
    weights = rows / rows.sum()
    level = float(weights @ [o.level for o in own]) if "level" in wanted else 1.0
    offset = float(weights @ [o.offset for o in own]) if "offset" in wanted else 0.0
    return [OwnOfLog(level=o.level / level, offset=o.offset - offset) for o in own]
