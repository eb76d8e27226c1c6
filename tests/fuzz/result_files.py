"""Files that HESR writes and reads: models, results, FMUs."""

import json
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from reader import TESTS, UF850, Reader, copy_of

from damage import damaged_archive  # isort: skip

from hesr_model.errors import ArtifactError
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription


def _model(path: Path) -> object:
    from hesr_model.friction.model import FrictionModel

    return FrictionModel.read(path)


def _body(path: Path) -> object:
    from hesr_model.rigid_body.identification import RigidBody

    return RigidBody.read(path)


def _write_body(path: Path) -> None:
    from hesr_model.rigid_body.identification import identify

    robot = Robot(RobotDescription.read(UF850 / "robot.toml"))
    rng = np.random.default_rng(1)
    t = np.arange(2000) * 0.005
    phase = 2.0 * np.pi * np.outer(t, [0.31, 0.43, 0.71]) + rng.uniform(0.0, 6.0, 3)
    q, dq = 0.4 * np.sin(phase), 0.4 * 2.0 * np.pi * np.array([0.31, 0.43, 0.71]) * np.cos(phase)
    tau = robot.torque(robot.nominal_parameters, q, dq, np.gradient(dq, t, axis=0))
    log = Log(name="run", t=t, q=q, dq=dq, tau=tau + np.sign(dq))
    identify([log], robot).write(path)


def _results(file: str) -> Callable[[Path], None]:
    """A file of results of version 1."""
    return lambda path: shutil.copy(TESTS / "version_1" / file, path) and None


def _result(module: str, name: str) -> Callable[[Path], object]:
    def read(path: Path) -> object:
        from importlib import import_module

        from hesr_model.support.typed_files import from_json, read_json

        schema: Any = getattr(import_module(module), name)
        data = read_json(path)
        return from_json(schema, data, path, "a result")

    return read


def _run(path: Path) -> object:
    from cosim.study.results import SavedRun

    return SavedRun.read(path)


def _scores(path: Path) -> object:
    from cosim.report.results import _read_by_test
    from cosim.study.scores import Comparison

    return _read_by_test(Comparison, path, "the scores of a run")


def _battery(path: Path) -> object:
    from hesr_model.audit.properties import read_properties

    return read_properties(path)


def _write_findings(path: Path) -> None:
    from cosim.study.results import HEALTH, write_findings
    from hesr_model.findings import Finding

    write_findings(
        path.parent,
        [
            Finding(
                check="limits",
                severity="warning",
                joints=("a", "b"),
                logs=("x",),
                found="its position comes to 7",
                remedy="its zero is wrong",
            )
        ],
    )
    (path.parent / HEALTH).rename(path)


def _findings(folder: Path) -> object:
    from cosim.study.results import read_findings

    return read_findings(folder)


def _write_paths(path: Path) -> None:
    from cosim.loop.closed_loop import Scheme
    from cosim.loop.traces import Trace, write_traces

    rng, t = np.random.default_rng(2), 0.01 * np.arange(50)
    trace = Trace(t=t, q_d=rng.normal(size=(50, 2)), q=rng.normal(size=(50, 2)))
    write_traces(path, [(Scheme(compensation="none"), "stribeck", trace)])


def _paths(path: Path) -> object:
    from cosim.loop.traces import read_traces

    return read_traces(path)


def _in_place(name: str, read: Callable[[Path], object]) -> Callable[[Path], object]:
    """Read a file from a folder of results under its fixed name."""

    def of(path: Path) -> object:
        folder = path.parent / "results"
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, folder / name)
        return read(folder)

    return of


def _simulations(path: Path) -> object:
    from cosim.report.results import _read_by_test
    from cosim.study.position_errors import PositionErrors

    return _read_by_test(PositionErrors, path, "the simulations of a run")


def _write_simulations(path: Path) -> None:
    from cosim.study.position_errors import PositionErrors
    from hesr_model.support.typed_files import to_json, write_json

    found = PositionErrors(
        joints=("a", "b"),
        lengths=(0.5, 1.0),
        windows={"lugre": ((0.1, None), (0.2, 0.3))},
        open_loop={"lugre": (None, 0.4)},
    )
    write_json(path, {"test": to_json(found)})


def _replicates(folder: Path) -> object:
    from cosim.study.replicates import read_replicates

    return read_replicates(folder)


def _write_replicates(path: Path) -> None:
    from cosim.study.replicates import Replicates
    from hesr_model.inference.replicates import ErrorSplit
    from hesr_model.support.typed_files import to_json, write_json

    split = ErrorSplit(rmse=0.1, repeats=0.8, low=0.7, high=0.9, smooth=0.6)
    found = Replicates(
        joints=("a",),
        count=5,
        rows=900,
        all_rows=1000,
        period=None,
        laws={"lugre": (split,)},
        fast={},
    )
    write_json(path, {"test": to_json(found), "training logs": None})


def _write_verdict(path: Path) -> None:
    from cosim.study.verdict import VERDICT, Verdict, write_verdict

    found = Verdict(
        law="lugre",
        fmu="fmus/lugre.fmu",
        test="trial",
        why="it is the best.",
        unexplained={"a": 7.0, "b": 11.5},
        weak=("At rest.",),
        improve=("A log with rests.",),
    )
    write_verdict(path.parent, found)
    (path.parent / VERDICT).rename(path)


def _verdict(folder: Path) -> object:
    from cosim.study.verdict import read_verdict

    found = read_verdict(folder)
    return found and found.sentences


def _write_robot_of_fleet(path: Path) -> None:
    from hesr.extras.fleet.deviation import Trend
    from hesr.extras.fleet.result import JointResult, RobotResult
    from hesr.extras.fleet.robot import RESULT_FORMAT
    from hesr_model.support.typed_files import to_json, write_json

    joint = JointResult(
        law="lugre",
        joint="a",
        structure="{}",
        values={"F_c": 12.0},
        errors={"F_c": 0.1},
        rmse=0.8,
        tau_std=9.0,
        trends={"level": Trend(slope=0.01, change=0.1, p=0.03)},
    )
    robot = RobotResult(key="7f", robot="R1", type="welder", logs=3, rows=900, joints=(joint,))
    write_json(path, {"format": RESULT_FORMAT, **to_json(robot)})


def _robot_of_fleet(folder: Path) -> object:
    from hesr.extras.fleet.robot import read_result

    return read_result(folder)


def _write_tracked(path: Path) -> None:
    from cosim.loop.closed_loop import Scheme
    from cosim.loop.loops import _FinishedRow
    from cosim.loop.traces import Trace, Tracked
    from hesr_model.support.typed_files import to_json, write_json

    rows = np.array([[0.1, np.nan], [0.3, 0.4]])
    row = Tracked(scheme=Scheme(compensation="none"), law="lugre", rmse=rows, last=rows)
    trace = Trace(t=np.arange(2.0), q_d=np.ones((2, 2)), q=np.zeros((2, 2)))
    write_json(path, to_json(_FinishedRow(tracked=row, trace=trace)))


INPUTS, OUTPUTS = ("arm.payload", "controller.Kp"), ("tracking",)
RUNS = np.random.default_rng(4).normal(size=(20, 2))


def _write_runs(path: Path) -> None:
    from hesr.extras.sweep.work import RunOutputs, Store

    store = Store(path.parent, INPUTS, OUTPUTS)
    store.find_file(0).parent.mkdir()
    failures = ("", *("arm: it broke",) * 19)
    store.write(0, RUNS, RunOutputs(outputs=RUNS[:, :1], failures=failures))
    store.find_file(0).rename(path)


def _runs(folder: Path) -> object:
    """Damaged runs are repeated, others are read."""
    from hesr.extras.sweep.work import Store

    store = Store(folder, INPUTS, OUTPUTS)
    if not store.has(0, RUNS):
        raise ArtifactError("the runs are made anew.")
    return store.read([0])


def _folder_of_sweep(folder: Path) -> object:
    from hesr.extras.sweep.work import ABOUT, lock_folder

    with lock_folder(folder, "runs", ABOUT, {"key": "7f", "runs": 20}):
        return None


def _write_fmu(path: Path) -> None:
    """All readable parts of an FMU of FMI 3.0 with reference results but no binaries."""
    from fmu_src.blocks.controller import velocity
    from fmu_src.export.description3 import to_xml3
    from fmu_src.friction.embedded_model import EMBEDDED_MODEL
    from fmu_src.friction.reference import reference_files
    from hesr_model.friction.model import FrictionModel

    source, block = UF850 / "table1.json", velocity(3)
    members = {
        "modelDescription.xml": to_xml3(block.table, block.about, "{7f}"),
        EMBEDDED_MODEL: source.read_bytes(),
        **reference_files(FrictionModel.read(source), "friction"),
    }
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)


def _fmu(path: Path) -> object:
    from fmu_src.friction.embedded_model import read_embedded_model
    from fmu_src.run.archive import Archive
    from fmu_src.run.reference_results import Verified, experiments
    from fmu_src.run.variables import model_description

    found = Verified()
    model_description(path)
    read_embedded_model(path)
    with Archive(path) as archive:
        told = experiments(archive, found)
    if found.problems:
        raise ArtifactError(max(found.problems, key=len))
    return told


def _write_ssp(path: Path) -> None:
    from small_fmus import LAGS, lag

    from cosim.systems.system import SystemSpec
    from hesr.extras.ssp.contents import read_contents
    from hesr.extras.ssp.ssp import write_ssp

    file = path.with_name("lags.toml")
    file.write_text(LAGS.replace("FMU", str(lag(path.parent))), encoding="utf-8")
    write_ssp(read_contents(SystemSpec.read(file), file), path)


def _ssp(path: Path) -> object:
    from cosim.systems.system import open_system
    from hesr.extras.ssp.contents import read_contents

    with open_system(path) as spec:
        return read_contents(spec, path)


RESULTS = {
    "ssp": Reader(suffix=".ssp", write=_write_ssp, read=_ssp, damage=damaged_archive),
    "friction model": Reader(suffix=".json", write=copy_of(UF850 / "table1.json"), read=_model),
    "rigid body": Reader(suffix=".json", write=_write_body, read=_body),
    "run": Reader(suffix=".json", write=_results("run.json"), read=_run),
    "scores": Reader(suffix=".json", write=_results("evaluation.json"), read=_scores),
    "properties": Reader(suffix=".json", write=_results("properties.json"), read=_battery),
    "closed loop": Reader(
        suffix=".json",
        write=_results("closed_loop.json"),
        read=_result("cosim.loop.run", "LoopOutcome"),
    ),
    "findings": Reader(
        suffix=".json", write=_write_findings, read=_in_place("health.json", _findings)
    ),
    "simulations": Reader(suffix=".json", write=_write_simulations, read=_simulations),
    "replicates": Reader(
        suffix=".json", write=_write_replicates, read=_in_place("replicates.json", _replicates)
    ),
    "verdict": Reader(
        suffix=".json", write=_write_verdict, read=_in_place("verdict.json", _verdict)
    ),
    "paths": Reader(suffix=".npz", write=_write_paths, read=_paths),
    "tracked": Reader(
        suffix=".json", write=_write_tracked, read=_result("cosim.loop.loops", "_FinishedRow")
    ),
    "robot of a fleet": Reader(
        suffix=".json",
        write=_write_robot_of_fleet,
        read=_in_place("result.json", _robot_of_fleet),
    ),
    "folder of a sweep": Reader(
        suffix=".json",
        write=lambda path: path.write_text(json.dumps({"key": "7f", "runs": 20})),
        read=_in_place("sweep.json", _folder_of_sweep),
    ),
    "runs of a sweep": Reader(
        suffix=".parquet",
        write=_write_runs,
        read=_in_place("runs/part-00000000.parquet", _runs),
    ),
    "fmu": Reader(suffix=".fmu", write=_write_fmu, read=_fmu, damage=damaged_archive),
}
