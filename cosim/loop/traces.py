"""Results of the closed loop: tracking errors, and positions over time."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from cosim.loop.closed_loop import Law, NamedScheme, Scheme
from hesr_model.errors import ArtifactError
from hesr_model.findings import Finding
from hesr_model.support.arrays import Array
from hesr_model.support.files import written_whole
from hesr_model.support.typed_json import Numbers, NumbersWithGaps

if TYPE_CHECKING:
    import pyarrow

TRACES = "closed_loop.parquet"


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """One run of the closed loop."""

    t: Numbers  # (N,) [s]
    q_d: Numbers  # desired (N, n) [rad]
    q: Numbers  # true (N, n) [rad]


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracked:
    """Tracking errors of a row."""

    scheme: NamedScheme
    law: Law
    rmse: NumbersWithGaps  # (M, n) by motion and joint [rad]; NaN if failed
    last: NumbersWithGaps  # (M, n) mean error over the last tenth [rad]
    failures: tuple[str, ...] = ()
    trace: Annotated[Trace | None, Field(exclude=True)] = None  # not in JSON

    @property
    def mean(self) -> Array:
        """Mean over the motions, (n,) [rad]."""
        return np.asarray(self.rmse.mean(axis=0))

    @property
    def spread(self) -> Array:
        """Standard deviation over the motions, (n,) [rad]."""
        return np.asarray(self.rmse.std(axis=0))


@dataclass(frozen=True, kw_only=True)
class Overcompensation:
    """Lowest factor on the friction torque that makes an arm at rest cycle."""

    law: str
    scheme: NamedScheme
    factor: float | None  # None if the arm rests at all `FACTORS`


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopOutcome:
    """Results of the closed loop of a study."""

    tracking: Sequence[Tracked]  # all laws, schemes and motions
    long: Sequence[Tracked]  # selected rows, one long motion
    sweeps: Sequence[Tracked]  # selected rows, changed arm or controller
    overcompensation: Sequence[Overcompensation]
    findings: Annotated[Sequence[Finding], Field(exclude=True)] = ()  # not in JSON


def write_traces(path: Path, traces: Iterable[tuple[Scheme, str, Trace]]) -> None:
    """Write traces of (scheme, law) as one long Parquet table: ``scheme, law, t, q_d1.., q1..``."""
    import pyarrow
    import pyarrow.parquet

    tables = [
        pyarrow.table(
            {"scheme": [scheme.name] * len(trace.t), "law": [law] * len(trace.t), "t": trace.t}
            | {f"q_d{k + 1}": column for k, column in enumerate(trace.q_d.T.copy())}
            | {f"q{k + 1}": column for k, column in enumerate(trace.q.T.copy())}
        )
        for scheme, law, trace in traces
    ]
    with written_whole(path) as temporary:
        pyarrow.parquet.write_table(pyarrow.concat_tables(tables), temporary, compression="zstd")


def read_traces(path: Path) -> dict[tuple[Scheme, str], Trace]:
    """Return the traces of a file by (scheme, law), in its order."""
    import pyarrow
    import pyarrow.parquet

    if not path.is_file():
        raise ArtifactError(
            f"{path}: no such file; 'hesr run' writes it for a study with [tracking]."
        )
    try:
        table = pyarrow.parquet.read_table(path)
        names = table["scheme"].to_pylist()
        schemes = {name: Scheme.of_name(name) for name in dict.fromkeys(names)}
        laws = table["law"].to_pylist()
        runs = [(schemes[name], law) for name, law in zip(names, laws, strict=True)]
        columns = [table[name].to_numpy() for name in ("t", *_of(table, "q_d"), *_of(table, "q"))]
    except (pyarrow.ArrowException, OSError, KeyError, ValueError) as error:
        raise ArtifactError(f"{path}: is not a file of closed-loop traces.") from error
    values = np.column_stack(columns)
    joints = (values.shape[1] - 1) // 2
    rows: dict[tuple[Scheme, str], list[int]] = {}
    for k, run in enumerate(runs):
        rows.setdefault(run, []).append(k)
    return {
        run: Trace(t=part[:, 0], q_d=part[:, 1 : 1 + joints], q=part[:, 1 + joints :])
        for run, of_run in rows.items()
        for part in [values[of_run]]
    }


def _of(table: "pyarrow.Table", vector: str) -> list[str]:
    names = [f"{vector}{k + 1}" for k in range(len(table.column_names))]
    found = [name for name in names if name in table.column_names]
    if not found:
        raise KeyError(vector)
    return found
