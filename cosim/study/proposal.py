"""Proposed study of inspected logs."""

import json
from os.path import relpath
from pathlib import Path

import numpy as np

from hesr_model.friction.registry import laws_with
from hesr_model.health.proposal import Proposal
from hesr_model.logs.phases import reversals
from hesr_model.logs.robot_log import Log

_TRAINED, _MOST_TRAINED = 0.6, 0.8
"""Share of a single log for training, and its maximum if a joint reverses late."""
_BEYOND = 0.02  # share trained beyond a joint's first reversal


def study_file(proposal: Proposal, robot: Path, path: Path) -> str:
    """Return a study file at `path`: the last log, or the end of a single log, is the test."""
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
    trained, tested = (files[:-1], files[-1:]) if len(files) > 1 else (["first"], ["rest"])
    lines += [
        f"identification = {json.dumps(trained, ensure_ascii=False)}",
        "",
        "[logs.test]",
        f"test = {json.dumps(tested, ensure_ascii=False)}",
    ]
    if len(files) == 1:
        (log,) = proposal.logs
        cut = float(f"{_share(log) * (log.t[-1] - log.t[0]):.4g}")
        of_log = f"log = {json.dumps(files[0])}"
        lines += [
            "",
            "# Times in s, from the log's first row.",
            "[logs.parts]",
            f"first = {{ {of_log}, stop = {cut:g} }}",
            f"rest = {{ {of_log}, start = {cut:g} }}",
        ]
    return "\n".join(lines) + "\n"


def _share(log: Log) -> float:
    """Return the share of a log to train on, at least until every joint has reversed."""
    dq = np.gradient(log.q, log.t, axis=0) if log.dq is None else log.dq
    found = [reversals(np.asarray(v)) for v in dq.T]
    whole, first = log.t[-1] - log.t[0], [rows[0] for rows in found if len(rows)]
    late = float(np.max(log.t[first] - log.t[0], initial=0.0) / whole)
    return min(max(_TRAINED, late + _BEYOND), _MOST_TRAINED)


def _name(path: Path) -> str:
    """Return the name of the study, that of the folder if its file is named 'study'."""
    stem = path.resolve().parent.name if path.stem == "study" else path.stem
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "_" for c in stem)
    return kept.lstrip("_-") or "study"
