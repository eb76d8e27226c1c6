"""Significance of law comparisons, with Holm's adjustment over all joints."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.study.results import ScoredRun
from cosim.study.scores import select_records
from hesr_model.inference.comparison import SIGNIFICANCE, ErrorRatio, law_errors
from hesr_model.inference.covariance import Moments, compute_long_run


@dataclass(frozen=True, kw_only=True)
class Against:
    """Comparisons with a reference law by law and joint number; p is adjusted in `adjusted`."""

    found: Mapping[tuple[str, int], ErrorRatio]
    adjusted: Mapping[tuple[str, int], float]

    @property
    def worse(self) -> list[tuple[str, int]]:
        """Laws and joints with a significantly larger error."""
        return [k for k, p in self.adjusted.items() if p < SIGNIFICANCE and self.found[k].value > 1]

    def mean(self, law: str) -> float:
        """Return the geometric mean over the joints of a law's ratios."""
        return float(
            np.exp(np.mean([np.log(r.value) for k, r in self.found.items() if k[0] == law]))
        )

    def __str__(self) -> str:
        return "\n".join(
            f"{law} J{joint + 1}: {ratio.value:.3f}, p = {self.adjusted.get((law, joint), 1.0):.3f}"
            for (law, joint), ratio in self.found.items()
        )


def against(run: ScoredRun, tests: str, laws: Iterable[str], other: str = "lugre") -> Against:
    """Compare laws with a reference law on test logs, joint by joint."""
    records, torque, laws = (
        select_records(run.study.logs.test[tests], run.records),
        run.predictions[tests],
        tuple(laws),
    )
    found = {}
    for j, of_joint in enumerate(records):
        errors = {
            law: [p - r.tau for p, r in zip(torque[law][j], of_joint, strict=True)]
            for law in dict.fromkeys((*laws, other))
        }
        table = law_errors(
            errors,
            [float(np.median(np.diff(r.t))) for r in of_joint],
            log_names=[r.log for r in of_joint],
        )
        ratios = table.ratios(other)
        found |= {(law, j): ratios[law] for law in laws}
    # Holm over the laws of a joint, then Bonferroni over the joints.
    adjusted = {
        key: min(1.0, len(records) * ratio.adjusted_p)
        for key, ratio in found.items()
        if ratio.adjusted_p is not None
    }
    return Against(found=found, adjusted=adjusted)


def long_run_of(influences: Sequence[np.ndarray], rows: int = 100) -> list[np.ndarray]:
    """Return `compute_long_run` of whole logs, fed in pieces."""
    moments = [Moments(psi.shape[1]) for psi in influences]
    pieces = [
        (log, psi[k : k + rows])
        for log, psi in enumerate(influences)
        for k in range(0, len(psi), rows)
    ]
    for log, piece in pieces:
        moments[log].add(piece)
    return compute_long_run(moments, pieces)
