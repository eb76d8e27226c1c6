"""Results of a fleet, its robots and their joints, their tables, and all as one Parquet file."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from cosim.report.tables.table import ResultTable, TableCell, fixed_cell, make_row, number
from cosim.workflow.answer import Answer, shorten_lines
from hesr.extras.fleet.deviation import MIN_SAMPLE_SIZE, Trend
from hesr_model.findings import Finding
from hesr_model.logs.tables import import_arrow
from hesr_model.support.typed_files import to_json


@dataclass(frozen=True, kw_only=True)
class JointResult:
    """Result of one joint and law, or of the rigid body (`BODY`, no joint).

    Attributes
    ----------
    structure : choices of the law, or names of the numbers of a body, as JSON.
    values : numbers by name, in their units.
    errors : standard errors of the numbers by name, where known.
    rmse : root mean square error over all logs [N.m; N].
    tau_std : standard deviation of the measured friction [N.m; N].
    trends : trends over the days of level, offset and error, as shares of the
        friction.
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
    logs, rows : numbers of logs and of their rows in use.
    refused : reasons for each log and law that is not used.
    failure : reason why the robot has no result; empty if it has one.
    joints : results of the rigid body, then by law and joint.
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
        """Reasons for an omitted robot, log or law."""
        return [*filter(None, [self.failure]), *self.refused]

    @property
    def laws(self) -> list[str]:
        """Names of the fitted laws."""
        law_names = dict.fromkeys(joint_result.law for joint_result in self.joints)
        return [law_name for law_name in law_names if law_name != BODY]

    def select_law(self, law_name: str) -> "list[JointResult]":
        """Return the results of a law by joint."""
        return [joint_result for joint_result in self.joints if joint_result.law == law_name]

    def structure(self, law_name: str) -> str:
        """Return the structures of a law, as JSON."""
        structures = [joint_result.structure for joint_result in self.select_law(law_name)]
        return f"[{', '.join(structures)}]"


@dataclass(frozen=True, kw_only=True)
class Deviant:
    """A number that deviates from the type of the robot.

    Attributes
    ----------
    name : name of the number.
    value, median : the number, and the median of the type, in its unit.
    z : distance from the median in robust standard deviations.
    p : two-sided p-value, adjusted for all numbers compared.
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
    """A change over the days.

    Attributes
    ----------
    kind : drift, shared drift, shift or error.
    change, per_day : change over all days and by day, as shares of friction.
    p : two-sided p-value, adjusted for all trends.
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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FleetResult(Answer):
    """Result of a fleet; unused logs are errors.

    Attributes
    ----------
    z : distances from the type in robust standard deviations, by (robot, law,
        joint) and name of the number.
    deviants : significant deviations, the largest first.
    changes : significant changes, worse ones first.
    fmus : files by (type, law, structure).
    reused : number of robots that were complete before.
    """

    format = "hesr-fleet-1"
    name: str
    robots: tuple[RobotResult, ...]
    z: Mapping[tuple[str, str, str], Mapping[str, float]]
    deviants: tuple[Deviant, ...]
    changes: tuple[Change, ...]
    fmus: Mapping[tuple[str, str, str], Path]
    folder: Path
    reused: int
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
_YES_OR_NO = {True: "yes", False: "no"}


def all_tables(fleet: FleetResult) -> Iterator[ResultTable]:
    """Yield the non-empty tables."""
    yield types(fleet)
    for table in (deviants(fleet), changes(fleet), broken(fleet)):
        if table.rows:
            yield table


def types(fleet: FleetResult) -> ResultTable:
    """Return the counts by type."""
    columns = {
        "robots": [robot.robot for robot in fleet.robots],
        "deviate": [deviant.robot for deviant in fleet.deviants],
        "got worse": [change.robot for change in fleet.changes if change.worse],
        "with findings": [robot.robot for robot in fleet.robots if robot.findings],
        "not all used": [robot.robot for robot in fleet.broken],
    }
    type_by_robot = {robot.robot: robot.type for robot in fleet.robots}
    counts = {column: _count_types(names, type_by_robot) for column, names in columns.items()}
    rows = []
    small_types = []
    for type_name in sorted(counts["robots"]):
        cells = [fixed_cell(column_counts[type_name], 0) for column_counts in counts.values()]
        rows.append(make_row(type_name, *cells))
        if counts["robots"][type_name] < MIN_SAMPLE_SIZE:
            small_types.append(type_name)
    note = ""
    if small_types:
        note = f"Fewer than {MIN_SAMPLE_SIZE} robots are not compared: {', '.join(small_types)}."
    return ResultTable(caption=f"Fleet {fleet.name}", head=("type", *columns), rows=rows, note=note)


def _count_types(names: Sequence[str], type_by_robot: Mapping[str, str]) -> Counter[str]:
    """Count robots by type; each counts once, however often it is named."""
    return Counter(type_by_robot[name] for name in set(names))


def deviants(fleet: FleetResult) -> ResultTable:
    """Return the deviating numbers."""
    rows = []
    for deviant in fleet.deviants[:_MAX_TABLE_ROWS]:
        law_name = deviant.law
        if law_name == BODY:
            law_name = "rigid body"
        row = make_row(
            deviant.robot,
            law_name,
            deviant.joint or "–",
            deviant.name,
            number(deviant.value, 4),
            number(deviant.median, 4),
            fixed_cell(deviant.z, 1),
            _p_cell(deviant.p),
        )
        rows.append(row)
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
        row = make_row(
            change.robot,
            change.law,
            change.joint,
            change.kind,
            _share_cell(change.change, 1),
            _share_cell(change.per_day, 2),
            _p_cell(change.p),
            _YES_OR_NO[change.worse],
            change.points_to,
        )
        rows.append(row)
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
    rows = []
    for robot in fleet.broken:
        rows += [make_row(robot.robot, sentence) for sentence in robot.sentences]
    return ResultTable(caption="Not used", head=("robot", "why"), rows=rows, numeric=False)


def _describe_omission(count: int) -> str:
    """Say how many of `count` rows a table leaves out, after a space; empty if none."""
    if count <= _MAX_TABLE_ROWS:
        return ""
    return f" {count - _MAX_TABLE_ROWS} more are in the Parquet file."


def _share_cell(share: float, decimals: int) -> TableCell:
    return TableCell(text=f"{100.0 * share:+.{decimals}f} %".replace("-", "−"), value=share)


def _p_cell(p: float) -> TableCell:
    text = f"{p:.3f}"
    if p < 1e-3:
        text = "< 0.001"
    return TableCell(text=text, value=p)


BODY = "rigid_body"  # name in place of a law for the rigid body


_TEXT_COLUMNS = ("type", "robot", "law", "joint", "structure", "fmu")
_COUNT_COLUMNS = ("logs", "rows")
_NUMBER_COLUMNS = ("rmse", "tau_std")
_MAP_COLUMNS = ("coefficients", "standard_errors", "z")  # numbers by name
_TRENDS = ("level", "offset", "error")
_FLAG_COLUMNS = ("deviates", "worse")
_LIST_COLUMNS = ("changes", "findings", "refused")  # of texts


def write_table(path: Path, fleet: FleetResult) -> None:
    """Write the file; a rigid body has no joint, a failed robot no law."""
    pa = import_arrow()
    table = pa.Table.from_pylist(list(_build_rows(fleet)), schema=_build_schema(pa))
    pa.parquet.write_table(table, path, compression="zstd")


def _build_schema(pa: Any) -> Any:
    """Return names and types of the columns, in the order of the file."""
    columns = [(name, pa.string()) for name in _TEXT_COLUMNS]
    columns += [(name, pa.int64()) for name in _COUNT_COLUMNS]
    columns += [(name, pa.float64()) for name in _NUMBER_COLUMNS]
    columns += [(name, pa.map_(pa.string(), pa.float64())) for name in _MAP_COLUMNS]
    for name in _TRENDS:
        columns.append((f"{name}_change", pa.float64()))
        columns.append((f"{name}_per_day", pa.float64()))
    columns += [(name, pa.bool_()) for name in _FLAG_COLUMNS]
    columns += [(name, pa.list_(pa.string())) for name in _LIST_COLUMNS]
    columns.append(("failure", pa.string()))
    return pa.schema(columns)


class _JointKey(NamedTuple):
    robot: str
    law: str
    joint: str

    @classmethod
    def from_row(cls, row: Deviant | Change) -> "_JointKey":
        return cls(row.robot, row.law, row.joint)


def _build_rows(fleet: FleetResult) -> Iterator[dict[str, Any]]:
    """Yield a row for each law and joint of a robot, and one for a failed robot."""
    deviant_keys = {_JointKey.from_row(deviant) for deviant in fleet.deviants}
    changes: dict[_JointKey, list[Change]] = {}
    for change in fleet.changes:
        changes.setdefault(_JointKey.from_row(change), []).append(change)
    for robot in fleet.robots:
        robot_row = _build_robot_row(robot)
        if robot.failure:
            yield robot_row
        for joint_result in robot.joints:
            key = _JointKey(robot.robot, joint_result.law, joint_result.joint)
            joint_changes = changes.get(key, [])
            joint_row = robot_row | _build_joint_row(joint_result)
            joint_row["z"] = list(fleet.z.get(key, {}).items())
            joint_row["fmu"] = _find_fmu(fleet, robot, joint_result.law)
            joint_row["deviates"] = key in deviant_keys
            joint_row["worse"] = any(change.worse for change in joint_changes)
            joint_row["changes"] = [change.kind for change in joint_changes]
            yield joint_row


def _build_robot_row(robot: RobotResult) -> dict[str, Any]:
    """Return the columns that all rows of a robot share."""
    return {
        "type": robot.type,
        "robot": robot.robot,
        "logs": robot.logs,
        "rows": robot.rows,
        "findings": [f"{finding.sentence} [{finding.check}]" for finding in robot.findings],
        "refused": list(robot.refused),
        "failure": robot.failure or None,
    }


def _build_joint_row(joint_result: JointResult) -> dict[str, Any]:
    """Return the columns of a law and joint that need no other robot."""
    row: dict[str, Any] = {
        "law": joint_result.law,
        "joint": joint_result.joint,
        "structure": joint_result.structure,
        "coefficients": list(joint_result.values.items()),
        "standard_errors": list(joint_result.errors.items()),
    }
    if joint_result.law != BODY:
        row["rmse"] = joint_result.rmse
        row["tau_std"] = joint_result.tau_std
    for name, trend in joint_result.trends.items():
        row[f"{name}_change"] = trend.change
        row[f"{name}_per_day"] = trend.slope
    return row


def _find_fmu(fleet: FleetResult, robot: RobotResult, law_name: str) -> str | None:
    """Return the path of the FMU of a robot's type within the folder; None if there is none."""
    fmu = fleet.fmus.get((robot.type, law_name, robot.structure(law_name)))
    if fmu is None:
        return None
    return fmu.relative_to(fleet.folder).as_posix()
