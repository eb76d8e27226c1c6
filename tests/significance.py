"""Whether laws are significantly worse than another one: paired blocks, Holm over all joints."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from cosim.study.results import Scored
from cosim.study.scores import SIGNIFICANCE, records_of
from hesr_model.inference.paired_test import Paired, compare_errors, holm


@dataclass(frozen=True, kw_only=True)
class Against:
    """Laws against another one, by law and number of the joint.

    Attributes
    ----------
    found : ratio of errors with its own probability.
    adjusted : probability adjusted for all of them (Holm).
    """

    found: Mapping[tuple[str, int], Paired]
    adjusted: Mapping[tuple[str, int], float]

    @property
    def worse(self) -> list[tuple[str, int]]:
        """Laws and joints of which it is sure."""
        return [k for k, p in self.adjusted.items() if p < SIGNIFICANCE and self.found[k].value > 1]

    def mean(self, law: str) -> float:
        """Return the geometric mean of a law's ratios over the joints."""
        return float(
            np.exp(np.mean([np.log(r.value) for k, r in self.found.items() if k[0] == law]))
        )

    def __str__(self) -> str:
        return "\n".join(
            f"{law} J{joint + 1}: {ratio.value:.3f}, p = {self.adjusted[law, joint]:.3f}"
            for (law, joint), ratio in self.found.items()
        )


def against(run: Scored, tests: str, laws: Iterable[str], other: str = "lugre") -> Against:
    """Compare laws with another one on a set of test logs, joint by joint."""
    records = records_of(run.study.logs.test[tests], run.records)
    torque = run.predictions[tests]
    found = {}
    for law in laws:
        for j, of_joint in enumerate(records):
            errors = [
                [p - r.tau for p, r in zip(torque[name][j], of_joint, strict=True)]
                for name in (law, other)
            ]
            periods = [float(np.median(np.diff(r.t))) for r in of_joint]
            found[law, j] = compare_errors(errors[0], errors[1], periods)
    return Against(found=found, adjusted=holm({key: one.p for key, one in found.items()}))
