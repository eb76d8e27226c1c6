"""What a law was found to do: the results of the property battery, and their file.

The experiments run FMUs and stand in `cosim.properties`; what they are held against stands
in `hesr_model.audit.expectations`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator

from hesr_model.audit.expectations import EXPECTATIONS
from hesr_model.support.typed_json import from_json, read_json, to_json, write_json
from hesr_model.units import unit_of_joint

FORMAT = "hesr-friction-properties-1"

Verdict = Literal["pass", "fail", "not applicable", "not run"]
"""Not applicable: the law has nothing of which the question could be asked, which is no defect."""
MARKS = {"pass": "✓", "fail": "✗", "not applicable": "n/a", "not run": "–"}
"""Verdicts in tables."""


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A measured number with its SI unit; None where there is none to be had."""

    name: str
    value: float | None
    unit: str


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A line of a small plot."""

    label: str
    x: tuple[float, ...]
    y: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Plot:
    """A small plot: names of its axes, its lines, and the units of the axes."""

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
    """What one experiment found on one joint.

    Attributes
    ----------
    verdict : whether the joint's law has the property.
    figures : what was measured; the first one stands in tables.
    reason : why not, or what else is to be known, in a sentence or two.
    plot : to be drawn beside it.
    """

    verdict: Verdict
    figures: tuple[Figure, ...] = ()
    reason: str = ""
    plot: Plot | None = None

    def at_joint(self, *, slides: bool) -> "PropertyResult":
        """Return the finding with the units of its joint, from that at one that turns."""
        figures = (replace(f, unit=unit_of_joint(f.unit, slides=slides)) for f in self.figures)
        plot = self.plot
        if plot:
            x, y = (unit_of_joint(unit, slides=slides) for unit in plot.units)
            plot = replace(plot, units=(x, y))
        return replace(self, figures=tuple(figures), plot=plot)


_NEWER = ("nested", "start", "drive")  # than the first files
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
    """All findings on one joint, and the sizes to which the experiments were scaled.

    Attributes
    ----------
    joint : its name.
    speed : largest trained speed, or the one that stands in for it [rad/s].
    level : friction level: half the difference of the steady torques at plus and minus a tenth of
        the speed [N.m], by its size.
    deflection : amplitude of pre-sliding motions [rad].
    inertia : of the joint [kg.m2]; None where none is known.
    findings : by key of the property.
    """

    joint: str
    speed: float
    level: float
    deflection: float
    inertia: float | None
    findings: Annotated[Mapping[str, PropertyResult], AfterValidator(_every)]


@dataclass(frozen=True, kw_only=True)
class Properties:
    """What the battery found on the laws of a friction model.

    Attributes
    ----------
    law : name of the model's law, or of the FMU where it carries no model.
    robot : name of the robot; empty where it is not known.
    tau_load : load torque that was fed to every joint where nothing else is said [N.m].
    joints : findings on each joint.
    """

    law: str
    robot: str
    tau_load: float
    joints: tuple[JointProperties, ...]

    @property
    def passed(self) -> int:
        """How many properties the law has on all of its joints."""
        return sum(
            all(joint.findings[key].verdict in ("pass", "not applicable") for joint in self.joints)
            for key in EXPECTATIONS
        )


@dataclass(frozen=True, kw_only=True)
class _File:
    laws: Mapping[str, Properties]


def write_properties(path: Path, found: Mapping[str, Properties]) -> None:
    """Write the findings on several laws, by name, with what they are held against."""
    write_json(
        path,
        {
            "format": FORMAT,
            "expectations": {key: to_json(e) for key, e in EXPECTATIONS.items()},
            "laws": {name: to_json(of_law) for name, of_law in found.items()},
        },
    )


def read_properties(path: Path) -> dict[str, Properties]:
    """Read what `write_properties` wrote.

    Raises
    ------
    ArtifactError
        Naming the file and what is missing or wrong in it.
    """
    found = from_json(_File, read_json(path, FORMAT), path, "findings of the property battery")
    return dict(found.laws)
