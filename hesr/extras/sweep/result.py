"""Runs of a sweep."""

from dataclasses import dataclass

import numpy as np

from hesr.extras.sweep.plan import Plan
from hesr.extras.sweep.sensitivity import Sensitivity
from hesr.extras.sweep.store import RunTable


@dataclass(frozen=True, kw_only=True, eq=False)
class SweepRuns:
    """Runs of a sweep; `sensitivities` are those of the design ``"sobol"``.

    `reused` counts the runs that were complete before.
    """

    plan: Plan
    table: RunTable
    sensitivities: list[Sensitivity]
    reused: int

    def worst(self, output: int, most: int = 5) -> list[int]:
        """Return the runs with the largest magnitudes of an output, failed runs first."""
        values = np.abs(self.table.outputs[:, output])
        order = np.argsort(np.where(np.isnan(values), -np.inf, -values), kind="stable")
        return [int(run) for run in order[:most]]
