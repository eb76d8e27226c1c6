"""Sources of a robot's constants, in the robot file, in results, and in sentences."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from hesr_model.support.config import Config
from hesr_model.support.typed_json import from_json, to_json

SourceKind = Literal["measured", "datasheet", "identified", "guessed", "not stated"]
"""Only the first three are evidence against a log."""

_KEY = "constants"  # of provenance
_SAID: Mapping[SourceKind, str] = {
    "measured": "measured",
    "datasheet": "taken from a data sheet",
    "identified": "identified from known masses",
    "guessed": "guessed: tau is proportional to it",
    "not stated": "of unknown source: state it in the robot file, under 'sources'",
}


class Sources(Config):
    """SourceKind of constants by key of the robot file, one or one per joint."""

    torque_per_ampere: SourceKind | tuple[SourceKind, ...] = "not stated"

    def each(self, key: str, joints: int) -> tuple[SourceKind, ...]:
        """Return the source of each joint's constant."""
        found = getattr(self, key)
        return found if isinstance(found, tuple) else (found,) * joints


@dataclass(frozen=True, kw_only=True)
class SourcedConstant:
    """A constant of a joint that a result rests on."""

    name: str
    joint: str
    value: float
    unit: str
    source: SourceKind


def sourced(
    name: str,
    unit: str,
    joints: Sequence[str],
    values: Sequence[float],
    sources: Sequence[SourceKind],
) -> dict[str, Any]:
    """Return the entry of a provenance for a constant of each joint."""
    return {
        _KEY: [
            to_json(SourcedConstant(name=name, joint=joint, value=value, unit=unit, source=source))
            for joint, value, source in zip(joints, values, sources, strict=True)
        ]
    }


def statements(provenance: Mapping[str, Any], *only: SourceKind) -> list[str]:
    """Return a sentence per constant and source in a provenance, maybe of some sources only."""
    entries = provenance.get(_KEY) or ()
    found = [from_json(SourcedConstant, one, Path("provenance"), "a constant") for one in entries]
    groups: dict[tuple[SourceKind, str], list[str]] = {}
    for one in found:
        groups.setdefault((one.source, one.name), []).append(one.joint)
    return [
        f"{name[0].upper()}{name[1:]} of {', '.join(joints)} {_SAID[source]}."
        for (source, name), joints in groups.items()
        if not only or source in only
    ]
