"""What a law was found to do: the results of the property battery, and their file.

The experiments run FMUs and stand in `cosim.studies.properties`; what they are held against stands
in `hesr_model.friction.expectations`.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, Self, get_args

from hesr_model.artifacts import read_json, write_json
from hesr_model.errors import ArtifactError
from hesr_model.friction.expectations import EXPECTATIONS
from hesr_model.units import unit_of_joint

FORMAT = "hesr-friction-properties-1"

Verdict = Literal["pass", "fail", "not applicable", "not run"]
"""Not applicable: the law has nothing of which the question could be asked, which is no defect."""


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
    """A small plot: names of its axes with units, and its lines."""

    x: str
    y: str
    curves: tuple[Curve, ...]


@dataclass(frozen=True, kw_only=True)
class Finding:
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

    def of_joint(self, *, slides: bool) -> "Finding":
        """Return the finding with the units of its joint; it was written for one that turns."""

        def named(text: str) -> str:
            return unit_of_joint(text, slides=slides)

        plot = self.plot
        return replace(
            self,
            figures=tuple(replace(f, unit=named(f.unit)) for f in self.figures),
            reason=named(self.reason),
            plot=plot and replace(plot, x=named(plot.x), y=named(plot.y)),
        )

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Self:
        """Rebuild what `to_json` of the whole returned."""
        if data["verdict"] not in get_args(Verdict):
            raise ValueError(f"verdict is {data['verdict']!r}")
        plot = data["plot"]
        return cls(
            verdict=data["verdict"],
            figures=tuple(Figure(**figure) for figure in data["figures"]),
            reason=str(data["reason"]),
            plot=None
            if plot is None
            else Plot(
                x=plot["x"],
                y=plot["y"],
                curves=tuple(
                    Curve(label=c["label"], x=tuple(c["x"]), y=tuple(c["y"]))
                    for c in plot["curves"]
                ),
            ),
        )


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
    findings: Mapping[str, Finding]


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

    def to_json(self) -> dict[str, Any]:
        """Return JSON data in SI units."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Self:
        """Rebuild what `to_json` returned.

        Raises
        ------
        KeyError, TypeError, ValueError
            If a part of the data is missing, or not what it should be.
        """
        return cls(
            law=str(data["law"]),
            robot=str(data["robot"]),
            tau_load=float(data["tau_load"]),
            joints=tuple(
                JointProperties(
                    **{
                        **joint,
                        "findings": {
                            key: Finding.from_json(joint["findings"][key]) for key in EXPECTATIONS
                        },
                    }
                )
                for joint in data["joints"]
            ),
        )


def write_properties(path: Path, found: Mapping[str, Properties]) -> None:
    """Write the findings on several laws, by name, with what they are held against."""
    write_json(
        path,
        {
            "format": FORMAT,
            "expectations": {key: asdict(e) for key, e in EXPECTATIONS.items()},
            "laws": {name: of_law.to_json() for name, of_law in found.items()},
        },
    )


def read_properties(path: Path) -> dict[str, Properties]:
    """Read what `write_properties` wrote.

    Raises
    ------
    ArtifactError
        Naming the file and what is missing or wrong in it.
    """
    data = read_json(path, FORMAT)
    try:
        return {name: Properties.from_json(of_law) for name, of_law in data["laws"].items()}
    except KeyError as error:
        raise ArtifactError(f"{path}: key {error} is missing.") from error
    except (TypeError, ValueError, AttributeError) as error:
        raise ArtifactError(f"{path}: not findings of the property battery ({error}).") from error
