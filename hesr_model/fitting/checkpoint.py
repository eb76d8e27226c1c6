"""Checkpoints: fitted laws of single joints, named by a hash of everything they depend on."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

from hesr_model.errors import ArtifactError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.residual import FrictionRecord

_COLUMNS = ("t", "dq", "q", "tau_load", "tau")
_VERSIONED = ("hesr", "numpy", "scipy", "sympy")


def key_of(
    law: str, records: Sequence[FrictionRecord], seed: int, options: Mapping[str, Any] | None
) -> str:
    """Return the hash of law, options, seed, versions and every row."""
    about = [law, dict(options or {}), seed, [version(name) for name in _VERSIONED]]
    key = hashlib.sha256(json.dumps(about, sort_keys=True, default=str).encode())
    for record in records:
        key.update(repr((record.joint, record.gear_ratio, record.sliding)).encode())
        for name in _COLUMNS:
            key.update(getattr(record, name).tobytes())
    return key.hexdigest()[:24]


def read_checkpoint(path: Path) -> FrictionLaw | None:
    """Return the law; None if missing or incomplete."""
    if path.is_file():
        with suppress(ArtifactError):
            return FrictionModel.read(path).laws[0]
    return None


def write_checkpoint(
    path: Path, law: FrictionLaw, record: FrictionRecord, sample_time: float
) -> None:
    """Write the law of one joint, sampled at `sample_time` [s], as a model."""
    FrictionModel(
        law=law.name,
        robot="robot",
        joints=(record.joint,),
        laws=(law,),
        sliding=(record.sliding,),
        sample_time=sample_time,
    ).write(path)
