"""Signals recorded in a run of a system."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from hesr_model.errors import HesrError, SimulationError
from hesr_model.logs.tables import write_table
from hesr_model.support import frames
from hesr_model.support.arrays import Array
from hesr_model.support.files import PathArg, to_path, written_whole


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Signals:
    """Observed signals of a run, up to its end or its failure.

    Examples
    --------
    >>> import hesr
    >>> signals = hesr.System.read("loop.toml").run()
    >>> signals.to_pandas().index.name
    't'
    >>> signals.write("result.csv")
    """

    t: Array  #: communication points (N,) [s]
    signals: dict[str, Array]  #: (N,) of every observed scalar in its unit, by component.variable
    failure: HesrError | None = None  #: reason for an early end

    def __repr__(self) -> str:
        return f"Signals({len(self.signals)} signals, {len(self.t)} samples to {self.end:g} s)"

    def _repr_html_(self) -> str:
        rows = ((name, *values[:1], *values[-1:]) for name, values in self.signals.items())
        return frames.html_table(repr(self), ("signal", "first", "last"), rows)

    @property
    def end(self) -> float:
        """Time of the last sample [s]; 0 without samples."""
        return float(self.t[-1]) if len(self.t) else 0.0

    def vector(self, signal: str) -> Array:
        """Return all elements of an observed signal, (N, n) in its unit.

        Raises SimulationError if it was not observed.
        """
        names = []
        if signal in self.signals:
            names.append(signal)
        while (name := f"{signal}[{len(names) + 1}]") in self.signals:
            names.append(name)
        if not names:
            raise SimulationError(f"signal '{signal}' has not been observed.")
        return np.column_stack([self.signals[name] for name in names])

    def require_success(self) -> "Signals":
        """Return itself, or raise the failure."""
        if self.failure:
            raise self.failure
        return self

    def to_pandas(self) -> Any:
        """Return a `pandas.DataFrame` with a column per signal over ``t`` [s].

        Raises ConfigError if pandas is not installed.
        """
        return frames.pandas_frame({"t": self.t} | self.signals, index="t")

    def write(self, path: PathArg) -> None:
        """Write time and signals as CSV or, with suffix ``.parquet``, as Parquet.

        Raises ArtifactError if the file cannot be written.
        """
        with written_whole(to_path(path, "an output")) as temporary:
            write_table(temporary, {"t": self.t} | self.signals)
