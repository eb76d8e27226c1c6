"""A study of logs that were looked at: it trains on some of them, and tests on what is left."""

import json
from collections.abc import Sequence
from os.path import relpath
from pathlib import Path

import numpy as np

from hesr_model.friction.registry import laws_with
from hesr_model.health.proposal import Proposal
from hesr_model.logs.phases import reversals
from hesr_model.logs.robot_log import RobotLog

_TRAINED, _MOST_TRAINED = 0.6, 0.8
"""Share of a log that is the only one, in time, on which laws are trained; the most of it where a
joint is late to reverse."""
_BEYOND = 0.02
"""Of a log, by which training goes on after a joint's first reversal."""


def study_file(proposal: Proposal, robot: Path, path: Path) -> str:
    """Return the text of a study file that stands at `path`.

    Of several logs the last one is the test. A single one is cut in time, and its end is the test.

    Parameters
    ----------
    robot : the robot file that reads the logs.
    """
    folder = path.resolve().parent
    files = [Path(relpath(_file(log.path), folder)).as_posix() for log in proposal.logs]
    lines = [
        "# Proposed by 'hesr inspect'; 'hesr run' runs it. Paths are relative to this file.",
        "",
        f"name = {json.dumps(_name(path))}  # results go to results/{_name(path)}",
        f"robot = {json.dumps(Path(relpath(robot.resolve(), folder)).as_posix())}",
        "seed = 0",
        f"laws = {json.dumps(laws_with('proposed'))}  # 'hesr laws' lists all and what they need",
        "# physical = true  # a rigid body that can exist, where the logs determine too little",
        "",
        "[logs]",
    ]
    if len(files) > 1:
        return _text([*lines, *_sets(files[:-1], files[-1:])])
    (log,) = proposal.logs
    cut = float(f"{_share(log) * (log.t[-1] - log.t[0]):.4g}")
    of_log = f"log = {json.dumps(files[0])}"
    return _text(
        [
            *lines,
            *_sets(["first"], ["rest"]),
            "",
            "# Times in s, from the log's first row.",
            "[logs.parts]",
            f"first = {{ {of_log}, stop = {cut:g} }}",
            f"rest = {{ {of_log}, start = {cut:g} }}",
        ]
    )


def _share(log: RobotLog) -> float:
    """Share of a log to train on: no friction is learnt of a joint that has not reversed."""
    dq = np.gradient(log.q, log.t, axis=0) if log.dq is None else log.dq
    found = [reversals(np.asarray(v)) for v in dq.T]
    whole, first = log.t[-1] - log.t[0], [rows[0] for rows in found if len(rows)]
    late = float(np.max(log.t[first] - log.t[0], initial=0.0) / whole)
    return min(max(_TRAINED, late + _BEYOND), _MOST_TRAINED)


def _sets(trained: Sequence[str], tested: Sequence[str]) -> list[str]:
    return [
        f"identification = {json.dumps(trained, ensure_ascii=False)}",
        "",
        "[logs.test]",
        f"test = {json.dumps(tested, ensure_ascii=False)}",
    ]


def _file(path: Path | None) -> Path:
    assert path is not None  # logs of a proposal were read from files
    return path.resolve()


def _name(path: Path) -> str:
    """Name of the study: its file's, or that of its folder where the file is plainly 'study'."""
    stem = path.resolve().parent.name if path.stem == "study" else path.stem
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "_" for c in stem)
    return kept.lstrip("_-") or "study"


def _text(lines: Sequence[str]) -> str:
    return "\n".join(lines) + "\n"
