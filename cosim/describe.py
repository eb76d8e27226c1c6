"""Saves what a report needs of a run: what was run on which logs, and torques over time."""

from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from cosim.sample_logs import is_sample
from cosim.saved import TRACES, SavedLog, SavedRun, write_run, write_torques
from cosim.scoring import inputs_of
from cosim.study import Study
from hesr_model.equations.over_log import Array
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import RobotLog
from hesr_model.rigid_body.residual import FrictionRecord
from hesr_model.robots.robot import RobotDescription
from hesr_model.support.files import sha256

Predictions = Mapping[str, Mapping[str, Sequence[Sequence[Array]]]]
"""Friction torques of each test set, by law, [joint][log], (N,) each [N.m]."""


def save_run(
    folder: Path,
    *,
    study: Study,
    command: str,
    quick: bool,
    robot: RobotDescription,
    files: Mapping[str, Path],
    logs: Mapping[str, RobotLog],
    records: Mapping[str, Sequence[Sequence[FrictionRecord]]],
    predictions: Predictions,
    models: Mapping[str, FrictionModel],
    left_out: Mapping[str, str],
    source: Mapping[str, Any],
) -> None:
    """Write `run.json` and the torques of one log of each role.

    Parameters
    ----------
    folder : of the results.
    study, command, quick : what was run.
    robot : its description.
    files, logs, records : of every log, by name; records by part of the log and joint.
    predictions : on the test sets.
    models : the laws.
    left_out : why others could not be fitted.
    source : provenance of the laws.
    """
    traces = _save_torques(folder / TRACES, study, records, predictions)
    stems = Counter(log.name for log in logs.values())
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
                for name, log in logs.items()
            ),
            bands=study.bands,
            inputs={law: inputs_of(model) for law, model in models.items()},
            variants={name: variant.law for name, variant in study.variants.items()},
            left_out=left_out,
            controller=study.tracking.model_dump(mode="json") if study.tracking else {},
            versions={
                **source["versions"],
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


def _save_torques(
    folder: Path,
    study: Study,
    records: Mapping[str, Sequence[Sequence[FrictionRecord]]],
    predictions: Predictions,
) -> dict[str, str]:
    """Write the torques of the first log of each role, up to a gap; return their files by log."""
    first: dict[str, dict[str, list[Array]]] = {study.logs.identification[0]: {}}
    for test, names in study.logs.test.items():
        first[names[0]] = {
            law: [of_joint[0] for of_joint in predicted]
            for law, predicted in predictions[test].items()
        }
    traces = {}
    for k, (name, predicted) in enumerate(first.items(), start=1):
        traces[name] = f"torques_{k}.parquet"
        write_torques(folder / traces[name], records[name][0], predicted)
    return traces
