"""Results of a fleet, its robots and their joints."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from hesr_model.findings import Finding
from hesr_model.inference.deviation import Trend

BODY = "rigid_body"  # name in place of a law for the rigid body


@dataclass(frozen=True, kw_only=True)
class JointResult:
    """Result of one joint and law, or of the rigid body (`BODY`, no joint).

    RMSE and standard deviation of friction [N.m; N]; `trends` relative to friction.
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
    """Result of one robot; `key` hashes everything that affects it."""

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
        """Reasons for an omitted robot, log or law."""
        return [*filter(None, [self.failure]), *self.refused]

    @property
    def broken(self) -> bool:
        """Whether something was left out."""
        return bool(self.sentences)

    @property
    def laws(self) -> list[str]:
        """Names of the fitted laws."""
        return [law for law in dict.fromkeys(one.law for one in self.joints) if law != BODY]

    def of_law(self, law: str) -> "list[JointResult]":
        """Return the results of a law by joint."""
        return [one for one in self.joints if one.law == law]

    def structure(self, law: str) -> str:
        """Return the structures of a law, as JSON."""
        return f"[{', '.join(one.structure for one in self.of_law(law))}]"


@dataclass(frozen=True, kw_only=True)
class Deviant:
    """A number that deviates from the type of the robot; `p` is adjusted."""

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
    """A change over the days, as a share of friction; `p` is adjusted."""

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
    """Result of a fleet; `reused` robots were complete before.

    `z` is indexed by (robot, law, joint), then by name; `fmus` by (type, law, structure).
    """

    name: str
    robots: tuple[RobotResult, ...]
    z: Mapping[tuple[str, str, str], Mapping[str, float]]
    deviants: tuple[Deviant, ...]
    changes: tuple[Change, ...]
    fmus: Mapping[tuple[str, str, str], Path]
    folder: Path
    reused: int

    @property
    def broken(self) -> Iterator[RobotResult]:
        """Robots with omitted logs or laws."""
        return (robot for robot in self.robots if robot.broken)
