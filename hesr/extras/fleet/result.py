"""Results of a fleet, its robots and their joints."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from hesr_model.findings import Finding
from hesr_model.inference.deviation import Trend

BODY = "rigid_body"
"""What stands in the place of a law where numbers are those of the rigid body."""


@dataclass(frozen=True, kw_only=True)
class JointResult:
    """One joint of a robot under one law, or the robot's rigid body.

    Attributes
    ----------
    law, joint : names; `BODY` and nothing for the rigid body.
    structure : of the law, as JSON.
    values, errors : coefficients and their standard errors, where known.
    rmse, tau_std : error over all rows of all logs, and standard deviation of friction [N.m]; of
        sliding joints [N], of the rigid body 0.
    trends : of what changes over days, relative to friction: `level`, `offset`, `error`.
    """

    law: str
    joint: str
    structure: str
    values: Mapping[str, float]
    errors: Mapping[str, float]
    rmse: float = 0.0
    tau_std: float = 0.0
    trends: Mapping[str, Trend] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class RobotResult:
    """What is found of one robot.

    Attributes
    ----------
    key : changes with anything that it depends on.
    robot, type : names.
    logs, rows : that were used.
    refused : why logs, or laws, were left out; a sentence each.
    failure : why there is nothing else; empty where there is.
    findings : of the checks.
    joints : of each joint under each law, and of the rigid body.
    """

    key: str
    robot: str
    type: str
    logs: int = 0
    rows: int = 0
    refused: tuple[str, ...] = ()
    failure: str = ""
    findings: tuple[Finding, ...] = ()
    joints: tuple[JointResult, ...] = ()

    @property
    def sentences(self) -> list[str]:
        """Reasons why the robot, logs or laws were left out."""
        return [*filter(None, [self.failure]), *self.refused]

    @property
    def broken(self) -> bool:
        """Whether the robot, a log or a law was left out."""
        return bool(self.sentences)

    @property
    def laws(self) -> list[str]:
        """Names of the laws that could be fitted."""
        return [law for law in dict.fromkeys(one.law for one in self.joints) if law != BODY]

    def of_law(self, law: str) -> "list[JointResult]":
        """Return what is found of each joint under a law."""
        return [one for one in self.joints if one.law == law]

    def structure(self, law: str) -> str:
        """Return the structures of a law of all joints, as JSON."""
        return f"[{', '.join(one.structure for one in self.of_law(law))}]"


@dataclass(frozen=True, kw_only=True)
class Deviant:
    """A number of a robot that is unlike that of its type.

    Attributes
    ----------
    robot, type, law, joint, name : whose number, and which.
    value, median : in one unit.
    z, p : distance in robust standard deviations; probability, adjusted for all comparisons.
    """

    robot: str
    type: str
    law: str
    joint: str
    name: str
    value: float
    median: float
    z: float
    p: float


@dataclass(frozen=True, kw_only=True)
class Change:
    """What of a robot has changed over days.

    Attributes
    ----------
    robot, type, law, joint : of what.
    kind : of the change.
    change : from the first day to the last one, as a share of friction.
    per_day : the same by day.
    p : probability by chance, adjusted for all trends.
    worse : whether it is more friction, an offset, or more that no law explains.
    points_to : what it may come from.
    """

    robot: str
    type: str
    law: str
    joint: str
    kind: str
    change: float
    per_day: float
    p: float
    worse: bool
    points_to: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Fleet:
    """Result of a fleet.

    Attributes
    ----------
    name : name of the fleet.
    robots : results of the robots, sorted by name.
    z : z of each number by robot, law and joint, then by name.
    deviants : deviating numbers, the largest z first.
    changes : changes over days, worse ones first, then by size.
    fmus : FMUs by type, law and structure of the law as JSON.
    folder : folder of the results.
    reused : number of robots that were complete before.
    """

    name: str
    robots: tuple[RobotResult, ...]
    z: Mapping[tuple[str, str, str], Mapping[str, float]]
    deviants: tuple[Deviant, ...]
    changes: tuple[Change, ...]
    fmus: Mapping[tuple[str, str, str], Path]
    folder: Path
    reused: int

    def z_of(self, robot: str, law: str, joint: str) -> Mapping[str, float]:
        """Return the z of each number there, by its name; of those that could be compared."""
        return self.z.get((robot, law, joint), {})

    @property
    def broken(self) -> Iterator[RobotResult]:
        """Robots whose logs could not all be used."""
        return (robot for robot in self.robots if robot.broken)
