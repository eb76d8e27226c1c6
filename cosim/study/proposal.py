"""Proposed study of inspected logs."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from os.path import relpath
from pathlib import Path

import numpy as np

from cosim.study.steps import Job
from cosim.study.study import Study
from hesr_model.fitting.estimator import registry, select_laws
from hesr_model.fitting.fit import fit_joint
from hesr_model.health.evidence import LEAST_TRAVEL
from hesr_model.health.examine import bears_load, checked
from hesr_model.health.proposal import Proposal, robot_file
from hesr_model.inference.comparison import LEAST_SECONDS
from hesr_model.logs.robot_log import Log, parts_of
from hesr_model.logs.signals import reversals
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot
from hesr_model.support.files import scratch_folder
from hesr_model.support.progress import silent

_TRAINED = 0.6
_MOST_TRAINED = 0.8
"""Share of a single log for training, and its maximum if a joint reverses late."""
_LEAST_TRAINED = 0.5  # share of all logs, if the test would otherwise be too short
_BEYOND = 0.02  # share trained beyond a joint's first reversal


@dataclass(frozen=True, kw_only=True)
class Split:
    """The last `tested` logs, or the rows of each log from its cut [s], are the test."""

    tested: int
    cuts: tuple[float, ...] = ()
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
    moved = np.array([np.ptp(log.q, axis=0) > LEAST_TRAVEL for log in logs])
    sums = {k: sum(durations[-k:]) for k in range(1, len(logs))}
    tested = next((k for k, tested in sums.items() if tested >= LEAST_SECONDS), 1)
    tested = tested if whole - sums.get(tested, 0.0) >= _LEAST_TRAINED * whole else 1
    if len(logs) > 1 and np.array_equal(moved[:-tested].any(axis=0), moved.any(axis=0)):
        return Split(tested=tested, seconds=sums[tested])
    # The training would lack a joint that moves, or there is a single log: cut each log.
    shares = [_share(log, whole) for log in logs]
    cuts = tuple(float(f"{s * d:.4g}") for s, d in zip(shares, durations, strict=True))
    return Split(tested=len(logs), cuts=cuts, seconds=whole - sum(cuts))


def study_file(proposal: Proposal, robot: Path, path: Path) -> str:
    """Return a study file at `path`, with the logs used as in `split`."""
    folder = path.resolve().parent
    paths = [log.path.resolve() for log in proposal.logs if log.path]
    files = [Path(relpath(path, folder)).as_posix() for path in paths]
    one = ['# refinement = "output_error"  # also refine the laws for simulation; it takes longer']
    one *= len(proposal.robot.joints) == 1 and not proposal.robot.log.cylinder
    lines = [
        "# Proposed by 'hesr inspect'; 'hesr run' runs it. Paths are relative to this file.",
        "",
        f"name = {json.dumps(_name(path))}  # results go to results/{_name(path)}",
        f"robot = {json.dumps(Path(relpath(robot.resolve(), folder)).as_posix())}",
        "seed = 0",
        f"laws = {json.dumps(laws_of(proposal))}  # 'hesr fit --list' lists all",
        "# physical = true  # physically possible masses, if the logs determine too little",
        *one,
        "",
        "[logs]",
    ]
    plan = split(proposal.logs)
    at = len(files) - plan.tested
    trained = files[:at]
    tested = files[at:]
    if plan.cuts:
        numbers = [str(k) for k in range(1, len(files) + 1)] if len(files) > 1 else [""]
        trained, tested = ([f"{part}{k}" for k in numbers] for part in ("first", "rest"))
    lines += [
        f"identification = {json.dumps(trained, ensure_ascii=False)}",
        "",
        *([f"# {plan.limit}"] if plan.limit else []),
        "[logs.test]",
        f"test = {json.dumps(tested, ensure_ascii=False)}",
    ]
    if plan.cuts:
        lines += ["", "# Times in s, from the log's first row.", "[logs.parts]"]
    for file, cut, first, rest in zip(files, plan.cuts, trained, tested, strict=False):
        of_log = f"log = {json.dumps(file)}"
        lines += [
            f"{first} = {{ {of_log}, stop = {cut:g} }}",
            f"{rest} = {{ {of_log}, start = {cut:g} }}",
        ]
    return "\n".join(lines) + "\n"


def laws_of(proposal: Proposal) -> list[str]:
    """Return the proposed laws whose inputs the logs show: load needs a change of load."""
    loaded = bool(proposal.robot.log.cylinder) or any(
        map(bears_load, proposal.examination.explained)
    )
    found = {name: registry()[name] for name in select_laws("proposed")}
    return [
        name
        for name, law in found.items()
        if all(getattr(proposal.robot, need) is not None for need in law.needs)
        and (loaded or all(s.name != "tau_load" for s in law.form(law.typical).inputs))
    ]


def dry_run(proposal: Proposal) -> None:
    """Read, split and check the logs of the proposed study, fit a small law; raises HesrError."""
    with scratch_folder() as folder:
        robot_path = folder / "robot.toml"
        path = folder / "study.toml"
        robot_path.write_text(robot_file(proposal, robot_path), encoding="utf-8")
        path.write_text(study_file(proposal, robot_path, path), encoding="utf-8")
        job = Job(study=Study.read(path), path=path, progress=silent)
        logs = {name: job.read(name, file) for name, file in job.log_files(folder).items()}
    robot = Robot(job.robot)
    checked(list(logs.values()), robot)
    trained = [logs[name] for name in job.trained_on]
    body = identify(trained, robot)
    records = [friction_records(part, robot, body) for part in parts_of(trained)]
    for of_joint in zip(*records, strict=True):
        fit_joint(select_laws("quick")[0], of_joint, seed=0)


def _share(log: Log, seconds: float) -> float:
    """Return the share of a log for training, of logs that last `seconds` together."""
    dq = np.gradient(log.q, log.t, axis=0) if log.dq is None else log.dq
    found = [reversals(np.asarray(v)) for v in dq.T]
    whole = log.t[-1] - log.t[0]
    first = [rows[0] for rows in found if len(rows)]
    late = float(np.max(log.t[first] - log.t[0], initial=0.0) / whole)
    left = 1.0 - LEAST_SECONDS / seconds
    trained = left if _LEAST_TRAINED <= left < _TRAINED else _TRAINED
    return min(max(trained, late + _BEYOND), _MOST_TRAINED)


def _name(path: Path) -> str:
    stem = path.resolve().parent.name if path.stem == "study" else path.stem
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "_" for c in stem)
    return kept.lstrip("_-") or "study"
