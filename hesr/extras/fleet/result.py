"""Results of a fleet, its robots and their joints, their tables, and all as one Parquet file."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cosim.report.tables.table import ResultTable, TableCell, fixed, number, row_of
from cosim.workflow.answer import Answer, shorten_lines
from hesr.extras.fleet.deviation import ENOUGH, Trend
from hesr_model.findings import Finding
from hesr_model.logs.tables import arrow
from hesr_model.support.typed_files import to_json


@dataclass(frozen=True, kw_only=True)
class JointResult:
    """Result of one joint and law, or of the rigid body (`BODY`, no joint)."""

    law: str
    joint: str
    structure: str
    values: Mapping[str, float]
    errors: Mapping[str, float]
    rmse: float = 0.0  # [N.m; N]
    tau_std: float = 0.0  # of friction [N.m; N]
    trends: Mapping[str, Trend] = field(default_factory=dict)  # relative to friction


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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FleetResult(Answer):
    """Result of a fleet; unused logs are errors."""

    format = "hesr-fleet-1"
    name: str
    robots: tuple[RobotResult, ...]
    z: Mapping[tuple[str, str, str], Mapping[str, float]]  # by (robot, law, joint) and name
    deviants: tuple[Deviant, ...]
    changes: tuple[Change, ...]
    fmus: Mapping[tuple[str, str, str], Path]  # by (type, law, structure)
    folder: Path
    reused: int  # robots that were complete before
    findings: Sequence[Finding] = ()
    files: Sequence[Path] = ()

    @property
    def broken(self) -> Iterator[RobotResult]:
        """Robots with omitted logs or laws."""
        return (robot for robot in self.robots if robot.sentences)

    def heading(self) -> str:
        """Return the name of the fleet."""
        return f"Fleet ‘{self.name}’"

    def introduction(self) -> str:
        """Return the amount of data and the files of the folder."""
        rows = sum(robot.rows for robot in self.robots)
        logs = sum(robot.logs for robot in self.robots)
        return (
            f"{len(self.robots)} robots, {logs} logs, {rows} rows. fleet.parquet has a row for "
            "each robot, law and joint; robots/ has the rigid body, laws and parameter sets of "
            "each robot, types/ the FMUs."
        )

    def summary(self) -> str:
        """Return the largest deviations and changes."""
        deviating = {one.robot for one in self.deviants}
        worse = [one for one in self.changes if one.worse]
        lines = [
            f"{len(self.robots)} robots: {len(deviating)} deviate from their type, "
            f"{len({one.robot for one in worse})} got worse."
        ]
        if self.reused:
            lines.append(f"Complete before: {self.reused} robots.")
        lines += [
            f"{one.robot}, {one.joint or 'rigid body'}: {one.name} is {one.value:.3g}, its type "
            f"has {one.median:.3g} (z = {one.z:.1f})"
            for one in self.deviants[:5]
        ]
        lines += [
            f"{one.robot}, {one.joint}: {one.kind} changed by {100 * one.change:+.0f} % of "
            f"friction; likely cause: {one.points_to}"
            for one in worse[:5]
        ]
        lines += [finding.sentence for finding in self.findings[:5]]
        return shorten_lines(lines, self.files)

    def tables(self) -> Sequence[ResultTable | str]:
        """Return the tables."""
        return list(all_tables(self))

    def result(self) -> Any:
        """Return deviations, changes and unusable logs."""
        return {
            "folder": str(self.folder),
            "robots": len(self.robots),
            "reused": self.reused,
            "deviants": [to_json(one) for one in self.deviants],
            "changes": [to_json(one) for one in self.changes],
            "not_used": {one.robot: one.sentences for one in self.broken},
        }


_MOST = 30  # maximum rows per table; the Parquet file is complete


def all_tables(fleet: FleetResult) -> Iterator[ResultTable]:
    """Yield the non-empty tables."""
    yield types(fleet)
    for table in (deviants(fleet), changes(fleet), broken(fleet)):
        if table.rows:
            yield table


def types(fleet: FleetResult) -> ResultTable:
    """Return the counts by type."""
    type_of = {robot.robot: robot.type for robot in fleet.robots}
    columns = [
        {robot.robot for robot in fleet.robots},
        {d.robot for d in fleet.deviants},
        {c.robot for c in fleet.changes if c.worse},
        {robot.robot for robot in fleet.robots if robot.findings},
        {robot.robot for robot in fleet.broken},
    ]
    counts = [Counter(type_of[name] for name in names) for names in columns]
    few = [t for t in sorted(counts[0]) if counts[0][t] < ENOUGH]
    return ResultTable(
        caption=f"Fleet {fleet.name}",
        head=("type", "robots", "deviate", "got worse", "with findings", "not all used"),
        rows=[row_of(t, *(fixed(c[t], 0) for c in counts)) for t in sorted(counts[0])],
        note=f"Fewer than {ENOUGH} robots are not compared: {', '.join(few)}." if few else "",
    )


def deviants(fleet: FleetResult) -> ResultTable:
    """Return the deviating numbers."""
    rows = []
    for d in fleet.deviants[:_MOST]:
        law = "rigid body" if d.law == BODY else d.law
        numbers = (number(d.value, 4), number(d.median, 4), fixed(d.z, 1), _p(d.p))
        rows.append(row_of(d.robot, law, d.joint or "–", d.name, *numbers))
    return ResultTable(
        caption="Robots that deviate from their type",
        head=("robot", "law", "joint", "number", "value", "median", "z", "p"),
        rows=rows,
        words=(1, 2, 3),
        note=f"z in robust standard deviations, p adjusted for all numbers compared."
        f"{_more(len(fleet.deviants))}",
    )


def changes(fleet: FleetResult) -> ResultTable:
    """Return the changes, worse ones first."""
    rows = []
    for c in fleet.changes[:_MOST]:
        numbers = (_share(c.change, 1), _share(c.per_day, 2), _p(c.p))
        worse = "yes" if c.worse else "no"
        rows.append(row_of(c.robot, c.law, c.joint, c.kind, *numbers, worse, c.points_to))
    return ResultTable(
        caption="Robots that have changed",
        head=("robot", "law", "joint", "what", "change", "per day", "p", "worse", "points to"),
        rows=rows,
        words=(1, 2, 3, 7, 8),
        note=f"Shares of friction; p adjusted for all trends.{_more(len(fleet.changes))}",
    )


def broken(fleet: FleetResult) -> ResultTable:
    """Return omissions with their reasons."""
    rows = [row_of(robot.robot, text) for robot in fleet.broken for text in robot.sentences]
    return ResultTable(caption="Not used", head=("robot", "why"), rows=rows, numeric=False)


def _more(count: int) -> str:
    return f" {count - _MOST} more are in the Parquet file." if count > _MOST else ""


def _share(share: float, decimals: int) -> TableCell:
    return TableCell(text=f"{100.0 * share:+.{decimals}f} %".replace("-", "−"), value=share)


def _p(p: float) -> TableCell:
    return TableCell(text="< 0.001" if p < 1e-3 else f"{p:.3f}", value=p)


BODY = "rigid_body"  # name in place of a law for the rigid body


_NUMBERS = ("logs", "rows")
_TRENDS = ("level", "offset", "error")


def write_table(path: Path, fleet: FleetResult) -> None:
    """Write the file; a rigid body has no joint, a failed robot no law."""
    pa = arrow()
    text = pa.string()
    number = pa.float64()
    by_name = pa.map_(text, number)
    texts = pa.list_(text)
    schema = pa.schema(
        [
            *((name, text) for name in ("type", "robot", "law", "joint", "structure", "fmu")),
            *((name, pa.int64()) for name in _NUMBERS),
            *((name, number) for name in ("rmse", "tau_std")),
            *((name, by_name) for name in ("coefficients", "standard_errors", "z")),
            *((f"{name}_{what}", number) for name in _TRENDS for what in ("change", "per_day")),
            *((name, pa.bool_()) for name in ("deviates", "worse")),
            *((name, texts) for name in ("changes", "findings", "refused")),
            ("failure", text),
        ]
    )
    table = pa.Table.from_pylist(list(_rows(fleet)), schema=schema)
    pa.parquet.write_table(table, path, compression="zstd")


def _rows(fleet: FleetResult) -> Iterator[dict[str, Any]]:
    deviating = {(d.robot, d.law, d.joint) for d in fleet.deviants}
    changes: dict[tuple[str, str, str], list[str]] = {}
    for change in fleet.changes:
        changes.setdefault((change.robot, change.law, change.joint), []).append(change.kind)
    worse = {(c.robot, c.law, c.joint) for c in fleet.changes if c.worse}
    for robot in fleet.robots:
        of_robot: dict[str, Any] = {
            "type": robot.type,
            "robot": robot.robot,
            "logs": robot.logs,
            "rows": robot.rows,
            "findings": [f"{finding.sentence} [{finding.check}]" for finding in robot.findings],
            "refused": list(robot.refused),
            "failure": robot.failure or None,
        }
        if robot.failure:
            yield of_robot
        for one in robot.joints:
            key = (robot.robot, one.law, one.joint)
            fmu = fleet.fmus.get((robot.type, one.law, robot.structure(one.law)))
            found = of_robot | {
                "law": one.law,
                "joint": one.joint,
                "structure": one.structure,
                "coefficients": list(one.values.items()),
                "standard_errors": list(one.errors.items()),
                "z": list(fleet.z.get(key, {}).items()),
                "fmu": fmu.relative_to(fleet.folder).as_posix() if fmu else None,
                "deviates": key in deviating,
                "worse": key in worse,
                "changes": changes.get(key, []),
            }
            if one.law != BODY:
                found |= {"rmse": one.rmse, "tau_std": one.tau_std}
            for name, trend in one.trends.items():
                found |= {f"{name}_change": trend.change, f"{name}_per_day": trend.slope}
            yield found
