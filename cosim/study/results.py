"""What a run saves beside its artifacts, so that a report needs nothing but the saved results.

`run.json` says what was run on which logs; `traces/` holds torques over time, one table for each
log that is shown.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import ConfigDict

from cosim.study.study import Band
from hesr_model.equations.over_log import Array
from hesr_model.logs.tables import read_table, write_table
from hesr_model.rigid_body.residual import FrictionRecord
from hesr_model.support.typed_json import from_json, read_json, to_json, write_json

RUN, TRACES, TRUTHS = "run.json", "traces", "truths.json"
RUN_FORMAT = "hesr-run-1"
MOST_ROWS = 20_000
"""Rows of a trace; what comes later in a longer log is not shown."""


@dataclass(frozen=True, kw_only=True)
class SavedLog:
    """A log of a run.

    Attributes
    ----------
    name, file : of the log; the file without its folder.
    sha256 : of the file.
    roles : what it served for: "identification", "training", or names of test sets.
    rows : number of samples.
    duration : [s].
    rate : samples per second [Hz].
    trace : file in `traces/`, empty where its torques are not saved.
    sample : whether it is one of the simulated logs that `hesr new` lays.
    """

    name: str
    file: str
    sha256: str
    roles: tuple[str, ...]
    rows: int
    duration: float
    rate: float
    trace: str = ""
    sample: bool = False


@dataclass(frozen=True, kw_only=True)
class SavedRun:
    """What was run.

    Attributes
    ----------
    study : its name.
    command : by which it can be run again.
    robot : its name.
    model : name of its model file.
    joints : their names.
    gear_ratio : turns of the motor per turn of each joint; empty where not known.
    twin : whether the logs come from the digital twin.
    truth : of the twin, in place of the friction of its MJCF; empty for none.
    quick : whether it was a quick run.
    seed : of every fit.
    logs : all logs.
    bands : parts of test sets that are scored by themselves.
    inputs : inputs that each law uses.
    variants : law of which each variant is one.
    controller : parameters of the closed loop's study; empty where there is none.
    versions : of the programs.
    left_out : why a law of the study was not fitted, by law.
    """

    __pydantic_config__: ClassVar = ConfigDict(extra="forbid")

    study: str
    command: str
    robot: str
    model: str
    joints: tuple[str, ...]
    gear_ratio: tuple[float, ...]
    twin: bool
    quick: bool
    seed: int
    logs: tuple[SavedLog, ...]
    bands: tuple[Band, ...]
    inputs: Mapping[str, str]
    variants: Mapping[str, str]
    controller: Mapping[str, Any]
    versions: Mapping[str, str]
    left_out: Mapping[str, str] = field(default_factory=dict)
    truth: str = ""

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read what `write_run` wrote.

        Raises
        ------
        ArtifactError
            Naming the file and what is missing or wrong in it.
        """
        return from_json(cls, read_json(path, RUN_FORMAT), path, "the description of a run")


def write_run(folder: Path, run: SavedRun) -> None:
    """Write what was run into the folder of its results."""
    write_json(folder / RUN, {"format": RUN_FORMAT, **to_json(run)})


def write_torques(
    path: Path,
    records: Sequence[FrictionRecord],
    predicted: Mapping[str, Sequence[Array]] | None = None,
) -> None:
    """Write the torques of one log: measured, of the rigid body, and of every law.

    Parameters
    ----------
    path : Parquet file; columns t, then for joint k of 1..n: q{k}, dq{k}, tau{k} (measured),
        tau_rb{k} (rigid body) and {law}.tau_f{k} (friction).
    records : of each joint.
    predicted : friction torque (N,) of each law and joint [N.m].
    """
    rows = slice(0, MOST_ROWS)
    columns: dict[str, Array] = {"t": records[0].t[rows] - records[0].t[0]}
    for k, record in enumerate(records, start=1):
        columns |= {
            f"q{k}": record.q[rows],
            f"dq{k}": record.dq[rows],
            f"tau{k}": (record.tau + record.tau_load)[rows],
            f"tau_rb{k}": record.tau_load[rows],
        }
        for law, torques in (predicted or {}).items():
            columns[f"{law}.tau_f{k}"] = torques[k - 1][rows]
    write_columns(path, columns)


def write_columns(path: Path, columns: Mapping[str, Array]) -> None:
    """Write columns (N,), of any unit, in single precision: more than any picture shows."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_table(path, {name: values.astype(np.float32) for name, values in columns.items()})


def read_columns(path: Path) -> dict[str, Array]:
    """Read what `write_columns` wrote, columns (N,) in their units.

    Raises
    ------
    LogError
        If the file is missing, damaged, or not finite.
    """
    table = read_table(path)
    return dict(zip(table.names, table.numbers(table.names).T, strict=True))
