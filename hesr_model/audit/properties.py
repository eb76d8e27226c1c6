"""Subjects and results of the physics checks, which are a plug-in, and their file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator

from hesr_model.audit.expectations import EXPECTATIONS
from hesr_model.friction.model import FrictionModel
from hesr_model.support.typed_json import from_json, read_json, to_json, write_json
from hesr_model.units import unit_of_joint

FORMAT = "hesr-friction-properties-1"

PropertyVerdict = Literal["pass", "fail", "not applicable", "not run"]
"""Not applicable to the law; this is not a defect."""
MARKS = {"pass": "✓", "fail": "✗", "not applicable": "n/a", "not run": "–"}


@dataclass(frozen=True, kw_only=True)
class Subject:
    """A model or FMU to examine."""

    name: str  # display name without a model
    model: FrictionModel | None  # None if unknown
    fmu: Path | None = None  # exported from the model by default
    inertia: tuple[float, ...] | None = None  # [kg.m2]


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A measured value with its SI unit, if known."""

    name: str
    value: float | None
    unit: str


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A line of a plot."""

    label: str
    x: tuple[float, ...]
    y: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Plot:
    """A small plot with the names and units of its axes."""

    x: str
    y: str
    curves: tuple[Curve, ...]
    units: tuple[str, str] = ("", "")

    @property
    def labels(self) -> tuple[str, str]:
        """Names of the axes with their units."""
        x, y = (f" [{unit}]" if unit else "" for unit in self.units)
        return self.x + x, self.y + y


@dataclass(frozen=True, kw_only=True)
class PropertyResult:
    """Result of one experiment on one joint."""

    verdict: PropertyVerdict
    figures: tuple[Figure, ...] = ()  # tables show the first one
    reason: str = ""
    plot: Plot | None = None

    def at_joint(self, *, slides: bool) -> "PropertyResult":
        """Return the result in the units of its joint, from those of a revolute one."""
        figures = (replace(f, unit=unit_of_joint(f.unit, slides=slides)) for f in self.figures)
        if plot := self.plot:
            x, y = (unit_of_joint(unit, slides=slides) for unit in plot.units)
            plot = replace(plot, units=(x, y))
        return replace(self, figures=tuple(figures), plot=plot)


_NEWER = ("nested", "start", "drive")  # than version 1
_NOT_KNOWN = PropertyResult(
    verdict="not run", reason="Not run: the file is older than this experiment."
)


def _every(findings: Mapping[str, PropertyResult]) -> Mapping[str, PropertyResult]:
    known = dict.fromkeys(_NEWER, _NOT_KNOWN) | dict(findings)
    if missing := EXPECTATIONS.keys() - known.keys():
        raise ValueError(f"'{min(missing)}' is missing")
    return {key: known[key] for key in EXPECTATIONS}


@dataclass(frozen=True, kw_only=True)
class JointProperties:
    """Results of one joint, and the scales of the experiments."""

    joint: str
    speed: float  # [rad/s] largest trained one or its substitute
    level: float  # [N.m] half difference of the steady torques at a tenth of the speed
    deflection: float  # [rad] in pre-sliding
    inertia: float | None  # [kg.m2]
    findings: Annotated[Mapping[str, PropertyResult], AfterValidator(_every)]


@dataclass(frozen=True, kw_only=True)
class Properties:
    """Results of a friction model."""

    law: str  # or name of the FMU
    robot: str  # or empty
    tau_load: float  # [N.m] of every joint
    joints: tuple[JointProperties, ...]

    @property
    def failed(self) -> dict[str, list[int]]:
        """Numbers from 1 of the joints that fail, by title of the check."""
        found = {
            expectation.title: [
                number
                for number, joint in enumerate(self.joints, start=1)
                if joint.findings[key].verdict == "fail"
            ]
            for key, expectation in EXPECTATIONS.items()
        }
        return {title: joints for title, joints in found.items() if joints}

    @property
    def passed(self) -> int:
        """Number of properties that the law has on all joints."""
        return sum(
            all(joint.findings[key].verdict in ("pass", "not applicable") for joint in self.joints)
            for key in EXPECTATIONS
        )


def combined(name: str, found: Mapping[str, Properties], laws: Sequence[str]) -> Properties | None:
    """Return the results of a model that has the law `laws[k]` on joint k; None if unknown."""
    if not all(law in found for law in laws):
        return None
    own = tuple(found[law].joints[k] for k, law in enumerate(laws))
    return replace(found[laws[0]], law=name, joints=own)


@dataclass(frozen=True, kw_only=True)
class _File:
    laws: Mapping[str, Properties]


def write_properties(path: Path, found: Mapping[str, Properties]) -> None:
    """Write the results of several laws by name, together with the expectations."""
    write_json(
        path,
        {
            "format": FORMAT,
            "expectations": {key: to_json(e) for key, e in EXPECTATIONS.items()},
            "laws": {name: to_json(of_law) for name, of_law in found.items()},
        },
    )


def read_properties(path: Path) -> dict[str, Properties]:
    """Read a file of `write_properties`."""
    found = from_json(_File, read_json(path, FORMAT), path, "findings of the physics checks")
    return dict(found.laws)
