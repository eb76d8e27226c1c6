"""Proposed study of inspected logs."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from os.path import relpath
from pathlib import Path

import numpy as np

from hesr_model.friction.registry import laws_with
from hesr_model.health.proposal import Proposal
from hesr_model.inference.comparison import LEAST_SECONDS
from hesr_model.logs.phases import reversals
from hesr_model.logs.robot_log import Log

_TRAINED, _MOST_TRAINED = 0.6, 0.8
"""Share of a single log for training, and its maximum if a joint reverses late."""
_LEAST_TRAINED = 0.5  # share of all logs, if the test would otherwise be too short
_BEYOND = 0.02  # share trained beyond a joint's first reversal


@dataclass(frozen=True, kw_only=True)
class Split:
    """The last `tested` logs, or the rows of a single log from `cut` [s], are the test."""

    tested: int
    cut: float | None
    seconds: float  # [s] of the test

    @property
    def limit(self) -> str:
        """What a short test cannot show; empty for a sufficient one."""
        if round(self.seconds, 1) >= LEAST_SECONDS:
            return ""
        return (
            f"The proposed test lasts {self.seconds:.3g} s, too short to compare laws: even twice "
            f"the error would not show. Record a test of at least {LEAST_SECONDS:.0f} s."
        )


def split(logs: Sequence[Log]) -> Split:
    """Choose a test of at least `LEAST_SECONDS`, if that leaves enough for training."""
    durations = [float(log.t[-1] - log.t[0]) for log in logs]
    whole = sum(durations)
    if len(logs) == 1:
        cut = float(f"{_share(logs[0]) * whole:.4g}")
        return Split(tested=1, cut=cut, seconds=whole - cut)
    sums = {k: sum(durations[-k:]) for k in range(1, len(logs))}
    long = (k for k, tested in sums.items() if tested >= LEAST_SECONDS)
    tested = next(long, 1)
    tested = tested if whole - sums[tested] >= _LEAST_TRAINED * whole else 1
    return Split(tested=tested, cut=None, seconds=sums[tested])


def study_file(proposal: Proposal, robot: Path, path: Path) -> str:
    """Return a study file at `path`, with the logs used as in `split`."""
    folder = path.resolve().parent
    paths = [log.path.resolve() for log in proposal.logs if log.path]
    files = [Path(relpath(path, folder)).as_posix() for path in paths]
    lines = [
        "# Proposed by 'hesr inspect'; 'hesr run' runs it. Paths are relative to this file.",
        "",
        f"name = {json.dumps(_name(path))}  # results go to results/{_name(path)}",
        f"robot = {json.dumps(Path(relpath(robot.resolve(), folder)).as_posix())}",
        "seed = 0",
        f"laws = {json.dumps(laws_with('proposed'))}  # 'hesr fit --list' lists all",
        "# physical = true  # physically possible masses, if the logs determine too little",
        "",
        "[logs]",
    ]
    plan = split(proposal.logs)
    at = len(files) - plan.tested
    trained, tested = (files[:at], files[at:]) if plan.cut is None else (["first"], ["rest"])
    lines += [
        f"identification = {json.dumps(trained, ensure_ascii=False)}",
        "",
        *([f"# {plan.limit}"] if plan.limit else []),
        "[logs.test]",
        f"test = {json.dumps(tested, ensure_ascii=False)}",
    ]
    if plan.cut is not None:
        of_log = f"log = {json.dumps(files[0])}"
        lines += [
            "",
            "# Times in s, from the log's first row.",
            "[logs.parts]",
            f"first = {{ {of_log}, stop = {plan.cut:g} }}",
            f"rest = {{ {of_log}, start = {plan.cut:g} }}",
        ]
    return "\n".join(lines) + "\n"


def _share(log: Log) -> float:
    dq = np.gradient(log.q, log.t, axis=0) if log.dq is None else log.dq
    found = [reversals(np.asarray(v)) for v in dq.T]
    whole, first = log.t[-1] - log.t[0], [rows[0] for rows in found if len(rows)]
    late = float(np.max(log.t[first] - log.t[0], initial=0.0) / whole)
    left = 1.0 - LEAST_SECONDS / whole
    trained = left if _LEAST_TRAINED <= left < _TRAINED else _TRAINED
    return min(max(trained, late + _BEYOND), _MOST_TRAINED)


def _name(path: Path) -> str:
    stem = path.resolve().parent.name if path.stem == "study" else path.stem
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "_" for c in stem)
    return kept.lstrip("_-") or "study"
