"""Saves what a report needs of a run: what was run on which logs, and torques over time."""

from collections import Counter
from importlib.metadata import version
from pathlib import Path, PurePath

import numpy as np

from cosim.study.results import TRACES, SavedLog, SavedRun, write_run, write_torques
from cosim.study.sample_logs import is_sample
from cosim.study.scored import Scored
from cosim.study.scores import inputs_of
from cosim.study.study import Study
from hesr_model.equations.over_log import Array
from hesr_model.support.files import sha256


def save_run(folder: Path, run: Scored, *, command: str, quick: bool) -> None:
    """Write `run.json` and the torques of one log of each role.

    Parameters
    ----------
    folder : of the results.
    run : what was made.
    command, quick : how it was run.
    """
    study, robot, files = run.job.study, run.job.robot, run.files
    traces = _save_torques(folder / TRACES, run)
    stems = Counter(log.name for log in run.logs.values())
    write_run(
        folder,
        SavedRun(
            study=study.name,
            command=command,
            robot=robot.name,
            model=robot.model.name,
            joints=robot.joints,
            gear_ratio=robot.gear_ratio or (),
            twin=study.twin is not None,
            truth=(study.twin and study.twin.truth) or "",
            quick=quick,
            seed=study.seed,
            logs=tuple(
                SavedLog(
                    name=log.name if stems[log.name] == 1 else name,
                    file=_file(name, files[name]),
                    sha256=sha256(files[name]),
                    roles=_roles(study, name),
                    rows=len(log.t),
                    duration=float(log.t[-1] - log.t[0]),
                    rate=float(1.0 / np.median(np.diff(log.t))),
                    trace=traces.get(name, ""),
                    sample=is_sample(files[name]),
                )
                for name, log in run.logs.items()
            ),
            bands=study.bands,
            inputs={law: inputs_of(model) for law, model in run.models.items()},
            variants={name: variant.law for name, variant in study.variants.items()},
            left_out=run.left_out,
            controller=study.tracking.model_dump(mode="json") if study.tracking else {},
            versions={
                **run.source["versions"],
                **({"mujoco": version("mujoco")} if study.twin else {}),
                "fmpy": version("fmpy"),
            },
        ),
    )


def _file(name: str, file: Path) -> str:
    """Return a log's file as the study names it, without folders of the machine."""
    inside = PurePath(name)
    known = file.match(name) and not inside.is_absolute() and ".." not in inside.parts
    return inside.as_posix() if known else file.name


def _roles(study: Study, name: str) -> tuple[str, ...]:
    logs = study.logs
    roles = {
        "identification": name in (*logs.identification, *logs.reversed),
        "training": name in logs.training,
        **{test: name in of_test for test, of_test in logs.test.items()},
    }
    return tuple(role for role, served in roles.items() if served)


def _save_torques(folder: Path, run: Scored) -> dict[str, str]:
    """Write the torques of the first log of each role, up to a gap; return their files by log."""
    study = run.job.study
    first: dict[str, dict[str, list[Array]]] = {study.logs.identification[0]: {}}
    for test, names in study.logs.test.items():
        first[names[0]] = {
            law: [of_joint[0] for of_joint in predicted]
            for law, predicted in run.predictions[test].items()
        }
    traces = {}
    for k, (name, predicted) in enumerate(first.items(), start=1):
        traces[name] = f"torques_{k}.parquet"
        write_torques(folder / traces[name], run.records[name][0], predicted)
    return traces
