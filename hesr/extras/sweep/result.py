"""What a sweep gave."""

from dataclasses import dataclass

import numpy as np

from hesr.extras.sweep.plan import Plan
from hesr.extras.sweep.sensitivity import Sensitivity
from hesr.extras.sweep.store import Table


@dataclass(frozen=True, kw_only=True, eq=False)
class Swept:
    """What a sweep gave.

    Attributes
    ----------
    plan : the sweep.
    table : all runs.
    sensitivities : of each output, where the design gives them.
    reused : runs that were there already.
    """

    plan: Plan
    table: Table
    sensitivities: list[Sensitivity]
    reused: int

    def worst(self, output: int, most: int = 5) -> list[int]:
        """Return the runs with the largest magnitudes of an output, those that failed first."""
        values = np.abs(self.table.outputs[:, output])
        order = np.argsort(np.where(np.isnan(values), -np.inf, -values), kind="stable")
        return [int(run) for run in order[:most]]
