"""Results of a fleet, its robots and their joints, their tables, and all as one Parquet file."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cosim.report.tables.table import ResultTable, TableCell, fixed_cell, make_row, number
from cosim.workflow.answer import Answer, shorten_lines
from hesr.extras.fleet.deviation import MIN_SAMPLE_SIZE, Trend
from hesr_model.findings import Finding
from hesr_model.logs.tables import import_arrow
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
        return [
            law_name
            for law_name in dict.fromkeys(joint_result.law for joint_result in self.joints)
            if law_name != BODY
        ]

    def select_law(self, law_name: str) -> "list[JointResult]":
        """Return the results of a law by joint."""
        return [joint_result for joint_result in self.joints if joint_result.law == law_name]

    def structure(self, law_name: str) -> str:
        """Return the structures of a law, as JSON."""
        return (
            f"[{', '.join(joint_result.structure for joint_result in self.select_law(law_name))}]"
        )


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
        deviating = {row.robot for row in self.deviants}
        worse = [row for row in self.changes if row.worse]
        lines = [
            f"{len(self.robots)} robots: {len(deviating)} deviate from their type, "
            f"{len({row.robot for row in worse})} got worse."
        ]
        if self.reused:
            lines.append(f"Complete before: {self.reused} robots.")
        lines += [
            f"{row.robot}, {row.joint or 'rigid body'}: {row.name} is {row.value:.3g}, its type "
            f"has {row.median:.3g} (z = {row.z:.1f})"
            for row in self.deviants[:5]
        ]
        lines += [
            f"{row.robot}, {row.joint}: {row.kind} changed by {100 * row.change:+.0f} % of "
            f"friction; likely cause: {row.points_to}"
            for row in worse[:5]
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
            "deviants": [to_json(row) for row in self.deviants],
            "changes": [to_json(row) for row in self.changes],
            "not_used": {row.robot: row.sentences for row in self.broken},
        }


_MAX_TABLE_ROWS = 30  # maximum rows per table; the Parquet file is complete


def all_tables(fleet: FleetResult) -> Iterator[ResultTable]:
    """Yield the non-empty tables."""
    yield types(fleet)
    for table in (deviants(fleet), changes(fleet), broken(fleet)):
        if table.rows:
            yield table


def types(fleet: FleetResult) -> ResultTable:
    """Return the counts by type."""
    type_of = {robot.robot: robot.type for robot in fleet.robots}
    robot_sets = [
        {robot.robot for robot in fleet.robots},
        {deviant.robot for deviant in fleet.deviants},
        {change.robot for change in fleet.changes if change.worse},
        {robot.robot for robot in fleet.robots if robot.findings},
        {robot.robot for robot in fleet.broken},
    ]
    robot_counts = [Counter(type_of[name] for name in names) for names in robot_sets]
    small_types = [
        type_name
        for type_name in sorted(robot_counts[0])
        if robot_counts[0][type_name] < MIN_SAMPLE_SIZE
    ]
    return ResultTable(
        caption=f"Fleet {fleet.name}",
        head=("type", "robots", "deviate", "got worse", "with findings", "not all used"),
        rows=[
            make_row(type_name, *(fixed_cell(counts[type_name], 0) for counts in robot_counts))
            for type_name in sorted(robot_counts[0])
        ],
        note=f"Fewer than {MIN_SAMPLE_SIZE} robots are not compared: {', '.join(small_types)}."
        if small_types
        else "",
    )


def deviants(fleet: FleetResult) -> ResultTable:
    """Return the deviating numbers."""
    rows = []
    for deviant in fleet.deviants[:_MAX_TABLE_ROWS]:
        law_name = "rigid body" if deviant.law == BODY else deviant.law
        cells = (
            number(deviant.value, 4),
            number(deviant.median, 4),
            fixed_cell(deviant.z, 1),
            _p_cell(deviant.p),
        )
        rows.append(make_row(deviant.robot, law_name, deviant.joint or "–", deviant.name, *cells))
    return ResultTable(
        caption="Robots that deviate from their type",
        head=("robot", "law", "joint", "number", "value", "median", "z", "p"),
        rows=rows,
        words=(1, 2, 3),
        note="z in robust standard deviations, p adjusted for all numbers compared."
        f"{_describe_omission(len(fleet.deviants))}",
    )


def changes(fleet: FleetResult) -> ResultTable:
    """Return the changes, worse ones first."""
    rows = []
    for change in fleet.changes[:_MAX_TABLE_ROWS]:
        cells = (_share_cell(change.change, 1), _share_cell(change.per_day, 2), _p_cell(change.p))
        worse = "yes" if change.worse else "no"
        rows.append(
            make_row(
                change.robot, change.law, change.joint, change.kind, *cells, worse, change.points_to
            )
        )
    return ResultTable(
        caption="Robots that have changed",
        head=("robot", "law", "joint", "what", "change", "per day", "p", "worse", "points to"),
        rows=rows,
        words=(1, 2, 3, 7, 8),
        note="Shares of friction; p adjusted for all trends."
        f"{_describe_omission(len(fleet.changes))}",
    )


def broken(fleet: FleetResult) -> ResultTable:
    """Return omissions with their reasons."""
    rows = [make_row(robot.robot, text) for robot in fleet.broken for text in robot.sentences]
    return ResultTable(caption="Not used", head=("robot", "why"), rows=rows, numeric=False)


def _describe_omission(count: int) -> str:
    return (
        f" {count - _MAX_TABLE_ROWS} more are in the Parquet file."
        if count > _MAX_TABLE_ROWS
        else ""
    )


def _share_cell(share: float, decimals: int) -> TableCell:
    return TableCell(text=f"{100.0 * share:+.{decimals}f} %".replace("-", "−"), value=share)


def _p_cell(p: float) -> TableCell:
    return TableCell(text="< 0.001" if p < 1e-3 else f"{p:.3f}", value=p)


BODY = "rigid_body"  # name in place of a law for the rigid body


_COUNT_COLUMNS = ("logs", "rows")
_TRENDS = ("level", "offset", "error")


def write_table(path: Path, fleet: FleetResult) -> None:
    """Write the file; a rigid body has no joint, a failed robot no law."""
    pa = import_arrow()
    text_type = pa.string()
    number_type = pa.float64()
    map_type = pa.map_(text_type, number_type)
    list_type = pa.list_(text_type)
    schema = pa.schema(
        [
            *((name, text_type) for name in ("type", "robot", "law", "joint", "structure", "fmu")),
            *((name, pa.int64()) for name in _COUNT_COLUMNS),
            *((name, number_type) for name in ("rmse", "tau_std")),
            *((name, map_type) for name in ("coefficients", "standard_errors", "z")),
            *(
                (f"{name}_{measure}", number_type)
                for name in _TRENDS
                for measure in ("change", "per_day")
            ),
            *((name, pa.bool_()) for name in ("deviates", "worse")),
            *((name, list_type) for name in ("changes", "findings", "refused")),
            ("failure", text_type),
        ]
    )
    table = pa.Table.from_pylist(list(_build_rows(fleet)), schema=schema)
    pa.parquet.write_table(table, path, compression="zstd")


def _build_rows(fleet: FleetResult) -> Iterator[dict[str, Any]]:
    deviant_keys = {(deviant.robot, deviant.law, deviant.joint) for deviant in fleet.deviants}
    changes: dict[tuple[str, str, str], list[str]] = {}
    for change in fleet.changes:
        changes.setdefault((change.robot, change.law, change.joint), []).append(change.kind)
    worse_keys = {
        (worse_change.robot, worse_change.law, worse_change.joint)
        for worse_change in fleet.changes
        if worse_change.worse
    }
    for robot in fleet.robots:
        robot_row: dict[str, Any] = {
            "type": robot.type,
            "robot": robot.robot,
            "logs": robot.logs,
            "rows": robot.rows,
            "findings": [f"{finding.sentence} [{finding.check}]" for finding in robot.findings],
            "refused": list(robot.refused),
            "failure": robot.failure or None,
        }
        if robot.failure:
            yield robot_row
        for joint_result in robot.joints:
            key = (robot.robot, joint_result.law, joint_result.joint)
            fmu = fleet.fmus.get((robot.type, joint_result.law, robot.structure(joint_result.law)))
            row = robot_row | {
                "law": joint_result.law,
                "joint": joint_result.joint,
                "structure": joint_result.structure,
                "coefficients": list(joint_result.values.items()),
                "standard_errors": list(joint_result.errors.items()),
                "z": list(fleet.z.get(key, {}).items()),
                "fmu": fmu.relative_to(fleet.folder).as_posix() if fmu else None,
                "deviates": key in deviant_keys,
                "worse": key in worse_keys,
                "changes": changes.get(key, []),
            }
            if joint_result.law != BODY:
                row |= {"rmse": joint_result.rmse, "tau_std": joint_result.tau_std}
            for name, trend in joint_result.trends.items():
                row |= {f"{name}_change": trend.change, f"{name}_per_day": trend.slope}
            yield row
