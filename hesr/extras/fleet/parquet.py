"""Results of a fleet as one Parquet file."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hesr.extras.fleet.result import BODY, Fleet, JointResult
from hesr_model.logs.tables import arrow

_NUMBERS = ("logs", "rows")
_TRENDS = ("level", "offset", "error")


def write_table(path: Path, fleet: Fleet) -> None:
    """Write the file; a rigid body has no joint, a failed robot no law."""
    pa = arrow()
    text, number = pa.string(), pa.float64()
    by_name, texts = pa.map_(text, number), pa.list_(text)
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


def _rows(fleet: Fleet) -> Iterator[dict[str, Any]]:
    deviating = {(d.robot, d.law, d.joint) for d in fleet.deviants}
    changes: dict[tuple[str, str, str], list[str]] = {}
    for change in fleet.changes:
        changes.setdefault((change.robot, change.law, change.joint), []).append(change.kind)
    worse = {(c.robot, c.law, c.joint) for c in fleet.changes if c.worse}
    for robot in fleet.robots:
        of_robot = {
            "type": robot.type,
            "robot": robot.robot,
            "logs": robot.logs,
            "rows": robot.rows,
            "findings": [f"{f.sentence} [{f.check}]" for f in robot.findings],
            "refused": list(robot.refused),
            "failure": robot.failure or None,
        }
        if robot.failure:
            yield of_robot
        for one in robot.joints:
            key = (robot.robot, one.law, one.joint)
            fmu = fleet.fmus.get((robot.type, one.law, robot.structure(one.law)))
            yield (
                of_robot
                | _numbers(one, fleet, key)
                | {
                    "fmu": fmu.relative_to(fleet.folder).as_posix() if fmu else None,
                    "deviates": key in deviating,
                    "worse": key in worse,
                    "changes": changes.get(key, []),
                }
            )


def _numbers(one: JointResult, fleet: Fleet, key: tuple[str, str, str]) -> dict[str, Any]:
    found: dict[str, Any] = {
        "law": one.law,
        "joint": one.joint,
        "structure": one.structure,
        "coefficients": list(one.values.items()),
        "standard_errors": list(one.errors.items()),
        "z": list(fleet.z.get(key, {}).items()),
    }
    if one.law != BODY:
        found |= {"rmse": one.rmse, "tau_std": one.tau_std}
    for name, trend in one.trends.items():
        found |= {f"{name}_change": trend.change, f"{name}_per_day": trend.slope}
    return found
