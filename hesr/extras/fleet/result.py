"""Results of a fleet, its robots and their joints."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from hesr_model.findings import Finding
from hesr_model.inference.deviation import Trend

BODY = "rigid_body"
"""Name in place of a law for the rigid body."""


@dataclass(frozen=True, kw_only=True)
class JointResult:
    """Result of one joint and law, or of the rigid body.

    Attributes
    ----------
    law, joint : names; `BODY` and an empty name for the rigid body.
    structure : structure of the law, as JSON.
    values, errors : coefficients and their standard errors, if known.
    rmse, tau_std : error over all logs and standard deviation of friction [N.m; N]; 0 for the
        rigid body.
    trends : trends over days of `level`, `offset` and `error`, relative to friction.
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
    """Result of one robot.

    Attributes
    ----------
    key : hash of everything that affects the result.
    robot, type : names.
    logs, rows : numbers of used logs and rows.
    refused : reasons of omitted logs and laws, a sentence each.
    failure : reason of a missing result, otherwise empty.
    findings : findings of the checks.
    joints : results of each joint and law, and of the rigid body.
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
        """Return the results of each joint for a law."""
        return [one for one in self.joints if one.law == law]

    def structure(self, law: str) -> str:
        """Return the structures of a law for all joints, as JSON."""
        return f"[{', '.join(one.structure for one in self.of_law(law))}]"


@dataclass(frozen=True, kw_only=True)
class Deviant:
    """A number of a robot that deviates from its type.

    Attributes
    ----------
    robot, type, law, joint, name : names.
    value, median : value of the robot and median of its type.
    z, p : distance in robust standard deviations, and adjusted probability.
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
    """A change of a robot over days.

    Attributes
    ----------
    robot, type, law, joint : names.
    kind : kind of change.
    change : change from the first to the last day, as a share of friction.
    per_day : change per day.
    p : probability, adjusted for all trends.
    worse : whether friction, offset or error increased.
    points_to : likely cause.
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
        """Return the z of each compared number by name."""
        return self.z.get((robot, law, joint), {})

    @property
    def broken(self) -> Iterator[RobotResult]:
        """Robots whose logs could not all be used."""
        return (robot for robot in self.robots if robot.broken)
