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
from hesr_model.health.evidence import MIN_TRAVEL
from hesr_model.health.examine import bears_load, check_logs
from hesr_model.health.proposal import Proposal, robot_file
from hesr_model.inference.comparison import MIN_SECONDS
from hesr_model.logs.robot_log import Log, collect_parts
from hesr_model.logs.signals import reversals
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot
from hesr_model.support.files import scratch_folder
from hesr_model.support.progress import silent

_TRAINED_SHARE = 0.6
_MAX_TRAINED_SHARE = 0.8
"""Share of a single log for training, and its maximum if a joint reverses late."""
_MIN_TRAINED_SHARE = 0.5  # share of all logs, if the test would otherwise be too short
_SHARE_AFTER_REVERSAL = 0.02  # share trained beyond a joint's first reversal


@dataclass(frozen=True, kw_only=True)
class Split:
    """The last `tested` logs, or the rows of each log from its cut [s], are the test."""

    tested: int
    cuts: tuple[float, ...] = ()
    seconds: float  # [s] of the test

    @property
    def limit(self) -> str:
        """What a short test cannot show; empty for a sufficient one."""
        if round(self.seconds, 1) >= MIN_SECONDS:
            return ""
        return (
            f"The proposed test lasts {self.seconds:.3g} s, too short to compare laws: even twice "
            f"the error would not show. Record a test of at least {MIN_SECONDS:.0f} s."
        )


def split(logs: Sequence[Log]) -> Split:
    """Choose a test of at least `MIN_SECONDS`, if that leaves enough for training."""
    durations = [float(log.t[-1] - log.t[0]) for log in logs]
    total_seconds = sum(durations)
    has_moved = np.array([np.ptp(log.q, axis=0) > MIN_TRAVEL for log in logs])
    sums = {k: sum(durations[-k:]) for k in range(1, len(logs))}
    tested = next((k for k, seconds in sums.items() if seconds >= MIN_SECONDS), 1)
    if total_seconds - sums.get(tested, 0.0) < _MIN_TRAINED_SHARE * total_seconds:
        tested = 1
    if len(logs) > 1 and np.array_equal(has_moved[:-tested].any(axis=0), has_moved.any(axis=0)):
        return Split(tested=tested, seconds=sums[tested])
    # The training would lack a joint that moves, or there is a single log: cut each log.
    shares = [_share(log, total_seconds) for log in logs]
    cuts = tuple(float(f"{s * d:.4g}") for s, d in zip(shares, durations, strict=True))
    return Split(tested=len(logs), cuts=cuts, seconds=total_seconds - sum(cuts))


def study_file(proposal: Proposal, robot: Path, path: Path) -> str:
    """Return a study file at `path`, with the logs used as in `split`."""
    folder = path.resolve().parent
    log_paths = [log.path.resolve() for log in proposal.logs if log.path]
    files = [Path(relpath(log_path, folder)).as_posix() for log_path in log_paths]
    refinement_hint = [
        '# refinement = "output_error"  # also refine the laws for simulation; it takes longer'
    ]
    refinement_hint *= (
        len(proposal.description.joints) == 1 and not proposal.description.log.cylinder
    )
    lines = [
        "# Proposed by 'hesr inspect'; 'hesr run' runs it. Paths are relative to this file.",
        "",
        f"name = {json.dumps(_name(path))}  # results go to results/{_name(path)}",
        f"robot = {json.dumps(Path(relpath(robot.resolve(), folder)).as_posix())}",
        "seed = 0",
        f"laws = {json.dumps(propose_laws(proposal))}  # 'hesr fit --list' lists all",
        "# physical = true  # physically possible masses, if the logs determine too little",
        *refinement_hint,
        "",
        "[logs]",
    ]
    test_split = split(proposal.logs)
    split_index = len(files) - test_split.tested
    trained_names = files[:split_index]
    tested_names = files[split_index:]
    if test_split.cuts:
        numbers = [str(k) for k in range(1, len(files) + 1)] if len(files) > 1 else [""]
        trained_names, tested_names = (
            [f"{part}{k}" for k in numbers] for part in ("first", "rest")
        )
    lines += [
        f"identification = {json.dumps(trained_names, ensure_ascii=False)}",
        "",
        *([f"# {test_split.limit}"] if test_split.limit else []),
        "[logs.test]",
        f"test = {json.dumps(tested_names, ensure_ascii=False)}",
    ]
    if test_split.cuts:
        lines += ["", "# Times in s, from the log's first row.", "[logs.parts]"]
    for file, cut, trained_part, test_part in zip(
        files, test_split.cuts, trained_names, tested_names, strict=False
    ):
        log_entry = f"log = {json.dumps(file)}"
        lines += [
            f"{trained_part} = {{ {log_entry}, stop = {cut:g} }}",
            f"{test_part} = {{ {log_entry}, start = {cut:g} }}",
        ]
    return "\n".join(lines) + "\n"


def propose_laws(proposal: Proposal) -> list[str]:
    """Return the proposed laws whose inputs the logs show: load needs a change of load."""
    has_load = bool(proposal.description.log.cylinder) or any(
        map(bears_load, proposal.examination.fits)
    )
    candidates = {name: registry()[name] for name in select_laws("proposed")}
    return [
        name
        for name, law in candidates.items()
        if all(getattr(proposal.description, need) is not None for need in law.needs)
        and (has_load or all(s.name != "tau_load" for s in law.form(law.typical).inputs))
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
    check_logs(list(logs.values()), robot)
    trained_logs = [logs[name] for name in job.trained_on]
    body = identify(trained_logs, robot)
    records = [friction_records(part, robot, body) for part in collect_parts(trained_logs)]
    # A baseline would also accept a log that never reverses.
    law_name = next(name for name in select_laws("quick") if not registry()[name].baseline)
    for joint_records in zip(*records, strict=True):
        fit_joint(law_name, joint_records, seed=0)


def _share(log: Log, seconds: float) -> float:
    """Return the share of a log for training, of logs that last `seconds` together."""
    dq = np.gradient(log.q, log.t, axis=0) if log.dq is None else log.dq
    joint_reversals = [reversals(np.asarray(v)) for v in dq.T]
    duration = log.t[-1] - log.t[0]
    first_reversals = [rows[0] for rows in joint_reversals if len(rows)]
    latest_reversal = float(np.max(log.t[first_reversals] - log.t[0], initial=0.0) / duration)
    remaining_share = 1.0 - MIN_SECONDS / seconds
    share = (
        remaining_share
        if _MIN_TRAINED_SHARE <= remaining_share < _TRAINED_SHARE
        else _TRAINED_SHARE
    )
    return min(max(share, latest_reversal + _SHARE_AFTER_REVERSAL), _MAX_TRAINED_SHARE)


def _name(path: Path) -> str:
    stem = path.resolve().parent.name if path.stem == "study" else path.stem
    safe_name = "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "_" for c in stem)
    return safe_name.lstrip("_-") or "study"
