"""How well laws predict logs: as Python models, or as the FMUs made of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import ArtifactError
from hesr_model.friction.evaluate import Array, predict
from hesr_model.friction.law import FrictionModel
from hesr_model.metrics import Score, score
from hesr_model.residual import FrictionRecord

Records = Sequence[Sequence[FrictionRecord]]
"""For each joint its records, one for each log."""

MEASURES = ("rmse", "rmse_reversal", "rmse_moving", "r2")


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Scores of several laws on the same logs.

    Attributes
    ----------
    joints : names of the joints.
    laws : scores of each law, one for each joint.
    """

    joints: tuple[str, ...]
    laws: Mapping[str, tuple[Score, ...]]

    def to_json(self) -> dict[str, Any]:
        """Return JSON data, in Nm, per joint."""
        first = next(iter(self.laws.values()))
        return {
            "joints": list(self.joints),
            "tau_std": [score.tau_std for score in first],
            "laws": {
                law: {measure: [getattr(s, measure) for s in scores] for measure in MEASURES}
                for law, scores in self.laws.items()
            },
        }


def by_joint(logs: Sequence[Sequence[FrictionRecord]]) -> list[list[FrictionRecord]]:
    """Turn records by log and joint into records by joint and log."""
    return [list(of_joint) for of_joint in zip(*logs, strict=True)]


def compare(records: Records, predictions: Mapping[str, Sequence[Sequence[Array]]]) -> Comparison:
    """Score predictions [law][joint][log], (N,) [N.m] each, on records [joint][log]."""
    return Comparison(
        joints=tuple(of_joint[0].joint for of_joint in records),
        laws={
            law: tuple(score(r, p) for r, p in zip(records, predicted, strict=True))
            for law, predicted in predictions.items()
        },
    )


def predict_model(model: FrictionModel, records: Records) -> list[list[Array]]:
    """Return the model's torque [joint][log] for records.

    Raises
    ------
    ArtifactError
        If the model is not of these joints.
    """
    joints = tuple(of_joint[0].joint for of_joint in records)
    if joints != model.joints:
        raise ArtifactError(
            f"friction model '{model.law}' is for the joints {', '.join(model.joints)}; the robot "
            f"has {', '.join(joints)}."
        )
    return [
        [predict(law, t=r.t, dq=r.dq, q=r.q, tau_load=r.tau_load) for r in of_joint]
        for law, of_joint in zip(model.laws, records, strict=True)
    ]


def predict_fmu(fmu: Path, records: Records) -> list[list[Array]]:
    """Return the torque [joint][log] that an FMU computes for records, through FMPy."""
    from cosim.replay import replay

    torques = []
    for log in zip(*records, strict=True):
        columns = (np.column_stack([getattr(r, u) for r in log]) for u in ("dq", "q", "tau_load"))
        torques.append(replay(fmu, log[0].t, *columns))
    return [[torque[:, joint] for torque in torques] for joint in range(len(records))]
