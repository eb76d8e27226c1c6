"""Proposed study of inspected logs."""

import json
import re
from collections.abc import Sequence
from os.path import relpath
from pathlib import Path

from cosim.servo.inspection import require_motion_by_commands
from cosim.study.steps import Job
from cosim.study.study import Study
from hesr_model.fitting.estimator import registry, select_laws
from hesr_model.fitting.fit import fit_joint
from hesr_model.friction.inputs import TAU_LOAD
from hesr_model.health.examine import bears_load, check_logs
from hesr_model.health.proposal import Proposal, robot_file
from hesr_model.logs.robot_log import collect_parts
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot
from hesr_model.support.files import scratch_folder
from hesr_model.support.progress import silent


def study_file(proposal: Proposal, robot: Path, path: Path) -> str:
    """Return a study file at `path`, which trains and judges the laws on all logs."""
    folder = path.resolve().parent
    log_paths = [log.path.resolve() for log in proposal.logs if log.path]
    files = [Path(relpath(log_path, folder)).as_posix() for log_path in log_paths]
    proposed_laws = list(select_laws("from_commands"))
    refinement_hint = []
    if all(log.has_torque for log in proposal.logs):
        proposed_laws = propose_laws(proposal)
        if len(proposal.description.joints) == 1 and not proposal.description.log.cylinder:
            refinement_hint.append(
                '# refinement = "output_error"  # also refine the laws for simulation; it takes '
                "longer"
            )
    lines = [
        "# Proposed by 'hesr inspect'; 'hesr run' runs it. Paths are relative to this file.",
        "",
        f"name = {json.dumps(_name(path))}  # results go to results/{_name(path)}",
        f"robot = {json.dumps(Path(relpath(robot.resolve(), folder)).as_posix())}",
        "seed = 0",
        f"laws = {json.dumps(proposed_laws)}  # 'hesr fit --list' lists all",
        *refinement_hint,
        *_write_relaxed_laws(proposed_laws),
        "",
        "[logs]",
        f"identification = {json.dumps(files, ensure_ascii=False)}",
        "",
        "# Laws are judged on rows of these logs that neither they nor the body were fitted to.",
        "# To judge them on logs of other days as well, name these:",
        "# [logs.test]",
        '# test = ["other.csv"]',
    ]
    return "\n".join(lines) + "\n"


def _write_relaxed_laws(laws: Sequence[str]) -> list[str]:
    """Return the lines of LuGre's laws without F_s >= F_c, which are references as well."""
    lines = []
    for law_name in ("lugre", "lugre_load"):
        if law_name in laws:
            lines += [
                "",
                f"[variants.{law_name}_relaxed]  # F_s < F_c allowed, as in lubricated gears",
                f'law = "{law_name}"',
                "options = { relaxed = true }",
            ]
    return lines


def propose_laws(proposal: Proposal) -> list[str]:
    """Return the proposed laws whose inputs the logs show: load needs a change of load."""
    description = proposal.description
    has_load = bool(description.log.cylinder) or any(map(bears_load, proposal.examination.fits))
    laws = []
    for name in select_laws("proposed"):
        law = registry()[name]
        is_possible = all(getattr(description, need) is not None for need in law.needs)
        if is_possible and (has_load or TAU_LOAD not in law.form(law.typical).inputs):
            laws.append(name)
    return laws


def dry_run(proposal: Proposal) -> None:
    """Read and check the logs of the proposed study, fit a small law; raises HesrError.

    Logs without torque are tried by the start of their fit.
    """
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
    if not all(log.has_torque for log in trained_logs):
        require_motion_by_commands(trained_logs, robot)
        return
    body = identify(trained_logs, robot)
    records = [friction_records(part, robot, body) for part in collect_parts(trained_logs)]
    # A baseline would also accept a log that never reverses.
    law_name = next(name for name in select_laws("quick") if not registry()[name].baseline)
    for joint_records in zip(*records, strict=True):
        fit_joint(law_name, joint_records, seed=0)


def _name(path: Path) -> str:
    stem = path.stem
    if stem == "study":
        stem = path.resolve().parent.name
    safe_name = re.sub(r"[^A-Za-z0-9_-]", "_", stem)
    return safe_name.lstrip("_-") or "study"
