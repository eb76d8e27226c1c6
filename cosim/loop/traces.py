"""Position traces of tracking runs, as a file of the results."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cosim.loop.closed_loop import Scheme
from hesr_model.errors import ArtifactError
from hesr_model.support.files import written_whole
from hesr_model.support.typed_json import Numbers

if TYPE_CHECKING:
    import pyarrow

TRACES = "closed_loop.parquet"
"""Name of the file in a folder of results."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """One run of the closed loop.

    Attributes
    ----------
    t : (N,) time [s].
    q_d : (N, n) desired positions [rad].
    q : (N, n) true positions of the arm [rad].
    """

    t: Numbers
    q_d: Numbers
    q: Numbers


def write_traces(path: Path, traces: Iterable[tuple[Scheme, str, Trace]]) -> None:
    """Write traces of (scheme, law) as one long Parquet table.

    Columns: ``scheme, law, t, q_d1.., q1..``. Repeated values are stored once.

    Raises
    ------
    ArtifactError
        If it cannot be written.
    """
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
    """Return the traces of a file by (scheme, law), in its order.

    Raises
    ------
    ArtifactError
        If the file is missing or is not what `write_traces` writes.
    """
    import pyarrow
    import pyarrow.parquet

    if not path.is_file():
        raise ArtifactError(
            f"{path}: no such file; 'hesr run' writes it for a study with [tracking], but not with "
            "--quick."
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
    """Return the columns of a vector; raise KeyError if there are none."""
    names = [f"{vector}{k + 1}" for k in range(len(table.column_names))]
    found = [name for name in names if name in table.column_names]
    if not found:
        raise KeyError(vector)
    return found
