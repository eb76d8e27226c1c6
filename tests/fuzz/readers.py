"""Every kind of file that HESR reads: a real one, and who reads it."""

import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

TESTS = Path(__file__).parents[1]
sys.path += [str(TESTS), str(TESTS / "unit"), str(TESTS / "cosim")]

from hesr_model.logs.robot_log import RobotLog  # noqa: E402
from hesr_model.robots.robot import RobotDescription, RobotModel  # noqa: E402
from hesr_model.support.files import models_folder  # noqa: E402

UF850 = models_folder() / "uf850"
TWO = RobotDescription(name="two", model=Path("two.urdf"), joints=("a", "b"))

URDF = """<?xml version="1.0" encoding="utf-8"?>
<robot name="lift">
  <link name="base"/>
  <joint name="rise" type="prismatic">
    <parent link="base"/><child link="plate"/><axis xyz="0 0 1"/>
    <limit lower="-0.1" upper="1.5" effort="900" velocity="0.5"/>
  </joint>
  <link name="plate"><inertial><origin xyz="0.1 0 0.2" rpy="0 0 0"/><mass value="12.5"/>
    <inertia ixx="0.3" iyy="0.4" izz="0.5" ixy="0.01" ixz="0" iyz="0"/></inertial></link>
  <joint name="turn" type="revolute">
    <parent link="plate"/><child link="tool"/><origin xyz="0.3 0 0" rpy="0 1.57 0"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="50" velocity="2"/>
  </joint>
  <link name="tool"><inertial><mass value="2"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>
"""

SYSTEM = """
name = "loop"
step = 0.005
stop = 20.0
observe = ["arm.q", "controller.tau[1]"]
[[components]]
name = "arm"
fmu = "arm.fmu"
start = { q0 = [0.0, 0.3, -1.9], noise = 1e-5, seed = 3 }
[[components]]
name = "controller"
fmu = "controller.fmu"
step = 0.01
[connections]
"arm.u" = "controller.tau"
[limits]
"arm.q" = [-3.0, 3.0]
"""


@dataclass(frozen=True, kw_only=True)
class Reader:
    """A kind of file.

    Attributes
    ----------
    suffix : of the file.
    write : writes a real one.
    read : reads it, or raises a `HesrError`.
    """

    suffix: str
    write: Callable[[Path], object]
    read: Callable[[Path], object]


def _log(path: Path) -> object:
    return RobotLog.read(path, TWO)


def _table(path: Path, *, separator: str = ",") -> None:
    rng = np.random.default_rng(5)
    t = 0.01 * np.arange(60)
    log = RobotLog(name="run", t=t, **{k: rng.normal(size=(60, 2)) for k in ("q", "dq", "tau")})
    log.write(path)
    if separator != ",":
        text = path.read_text(encoding="utf-8").replace(",", separator).replace(".", ",")
        path.write_text(text, encoding="utf-8")


def _recording(path: Path) -> None:
    """As the recorder of Universal Robots writes: blanks between cells, joints from 0."""
    rng = np.random.default_rng(6)
    values = np.column_stack([0.008 * np.arange(80) + 1.6e9, rng.normal(size=(80, 8))])
    kinds = ("actual_q", "actual_qd", "actual_current", "target_moment")
    header = ["timestamp", *(f"{kind}_{k}" for kind in kinds for k in range(2))]
    rows = [" ".join(map(str, row)) for row in values]
    path.write_text("\r\n".join([" ".join(header), *rows, ""]), encoding="utf-8")


def _inspected(path: Path) -> object:
    from hesr_model.health.proposal import inspected, robot_file, summary_rows

    found = inspected([path])
    return robot_file(found, path.with_suffix(".toml")), list(summary_rows(found))


def _results(file: str) -> Callable[[Path], None]:
    """A file of results of version 1."""
    return lambda path: shutil.copy(TESTS / "version_1" / file, path) and None


def _result(module: str, name: str) -> Callable[[Path], object]:
    def read(path: Path) -> object:
        from importlib import import_module

        from hesr_model.artifacts import read_json
        from hesr_model.support.typed_json import from_json

        schema: Any = getattr(import_module(module), name)
        data = read_json(path)
        return from_json(schema, data, path, "a result")

    return read


def _run(path: Path) -> object:
    from cosim.saved import SavedRun

    return SavedRun.read(path)


def _scores(path: Path) -> object:
    from cosim.report.results import _comparisons

    return _comparisons(path)


def _battery(path: Path) -> object:
    from hesr_model.friction.audit.properties import read_properties

    return read_properties(path)


def _write_findings(path: Path) -> None:
    from cosim.health import HEALTH, write_findings
    from hesr_model.health.findings import Finding

    write_findings(
        path.parent,
        [
            Finding(
                check="limits", severity="warning", joints=("a", "b"), logs=("x",),
                found="its position comes to 7", cause="its zero is wrong",
            )
        ],
    )  # fmt: skip
    (path.parent / HEALTH).rename(path)


def _findings(path: Path) -> object:
    from cosim.health import HEALTH, read_findings

    folder = path.parent / "results"
    folder.mkdir(exist_ok=True)
    shutil.copy(path, folder / HEALTH)
    return read_findings(folder)


def _write_paths(path: Path) -> None:
    from cosim.closed_loop import Scheme
    from cosim.studies.traces import Trace, write_traces

    rng, t = np.random.default_rng(2), 0.01 * np.arange(50)
    trace = Trace(t=t, q_d=rng.normal(size=(50, 2)), q=rng.normal(size=(50, 2)))
    write_traces(path, [(Scheme(compensation="none"), "stribeck", trace)])


def _paths(path: Path) -> object:
    from cosim.studies.traces import read_traces

    return read_traces(path)


SWEEP = """
name = "payload"
system = "loop.toml"
design = "sobol"
runs = 64
seed = 1
[[inputs]]
variables = ["arm.payload"]
low = 0.0
high = 5.0
[[inputs]]
variables = ["controller.Kp", "controller.Kd"]
factor = true
mean = 1.0
std = 0.1
[[correlated]]
variables = ["friction.F_c[1]", "friction.F_s[1]"]
mean = [12.1, 14.0]
covariance = [[0.04, 0.01], [0.01, 0.09]]
[[outputs]]
name = "tracking"
signal = "arm.q_true"
reference = "trajectory.q"
measure = "rms"
"""


def _matlab(save: str) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        import test_log_matlab as matlab

        getattr(matlab, save)(path, matlab.content())

    return write


def _matlab_4(path: Path) -> None:
    import test_log_matlab as matlab
    from scipy.io import savemat

    savemat(path, matlab.content(), format="4")


def _bag(storage: str) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        import test_log_bag as bag

        folder = path.with_name("bag")
        bag.write(folder, bag.messages(), storage=storage)
        (file,) = (f for f in folder.iterdir() if f.suffix == path.suffix)
        shutil.copy(file, path)

    return write


def _bag_of_ros_1(path: Path) -> None:
    import test_log_bag as bag
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store, kind = get_typestore(Stores.ROS1_NOETIC), "sensor_msgs/msg/JointState"
    with Writer(path) as writer:
        states = writer.add_connection("/joint_states", kind, typestore=store)
        for k, item in enumerate(bag.messages()):
            raw = store.serialize_ros1(bag.joint_state(store, item, seq=k), kind)
            writer.write(states, item["stamp"], raw)


def _copy(source: Path) -> Callable[[Path], object]:
    return lambda path: shutil.copy(source, path)


def _text(text: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(text, encoding="utf-8")


def _toml(module: str, name: str) -> Callable[[Path], object]:
    def read(path: Path) -> object:
        from importlib import import_module

        schema: Any = getattr(import_module(module), name)
        return schema.read(path)

    return read


def _model(path: Path) -> object:
    from hesr_model.artifacts import read_model

    return read_model(path)


def _body(path: Path) -> object:
    from hesr_model.artifacts import read_rigid_body

    return read_rigid_body(path)


def _write_body(path: Path) -> None:
    from hesr_model.artifacts import write_rigid_body
    from hesr_model.rigid_body.identification import identify

    robot = RobotModel(RobotDescription.read(UF850 / "robot.toml"))
    rng = np.random.default_rng(1)
    t = np.arange(2000) * 0.005
    phase = 2.0 * np.pi * np.outer(t, [0.31, 0.43, 0.71]) + rng.uniform(0.0, 6.0, 3)
    q, dq = 0.4 * np.sin(phase), 0.4 * 2.0 * np.pi * np.array([0.31, 0.43, 0.71]) * np.cos(phase)
    tau = robot.torque(robot.nominal_parameters, q, dq, np.gradient(dq, t, axis=0))
    log = RobotLog(name="run", t=t, q=q, dq=dq, tau=tau + np.sign(dq))
    write_rigid_body(path, identify([log], robot), {})


def _robot(path: Path) -> object:
    from hesr_model.robots.model_file import driven_joints

    joints = tuple(joint.name for joint in driven_joints(path))
    return RobotModel(RobotDescription(name="robot", model=path, joints=joints))


READERS = {
    "csv": Reader(suffix=".csv", write=_table, read=_log),
    "csv with decimal commas": Reader(
        suffix=".csv", write=lambda path: _table(path, separator=";"), read=_log
    ),
    "rtde": Reader(suffix=".csv", write=_recording, read=_inspected),
    "csv of a stranger": Reader(suffix=".csv", write=_table, read=_inspected),
    "parquet": Reader(suffix=".parquet", write=_table, read=_log),
    "matlab": Reader(suffix=".mat", write=_matlab("save_classic"), read=_log),
    "matlab 4": Reader(suffix=".mat", write=_matlab_4, read=_log),
    "matlab, packed": Reader(suffix=".mat", write=_matlab("save_compressed"), read=_log),
    "matlab 7.3": Reader(suffix=".mat", write=_matlab("save_hdf5"), read=_log),
    "ros 1 bag": Reader(suffix=".bag", write=_bag_of_ros_1, read=_log),
    "ros 2 bag": Reader(suffix=".db3", write=_bag("SQLITE3"), read=_log),
    "mcap": Reader(suffix=".mcap", write=_bag("MCAP"), read=_log),
    "friction model": Reader(suffix=".json", write=_copy(UF850 / "table1.json"), read=_model),
    "rigid body": Reader(suffix=".json", write=_write_body, read=_body),
    "robot": Reader(
        suffix=".toml",
        write=_copy(UF850 / "robot.toml"),
        read=_toml("hesr_model.robots.robot", "RobotDescription"),
    ),
    "plant": Reader(
        suffix=".toml",
        write=_copy(UF850 / "plant.toml"),
        read=_toml("fmu_src.arm.plant", "Plant"),
    ),
    "study": Reader(
        suffix=".toml",
        write=_copy(models_folder() / "studies" / "default.toml"),
        read=_toml("cosim.study", "Study"),
    ),
    "motions": Reader(
        suffix=".toml",
        write=_copy(models_folder() / "studies" / "uf850_motions.toml"),
        read=_toml("cosim.studies.motions", "Motions"),
    ),
    "system": Reader(suffix=".toml", write=_text(SYSTEM), read=_toml("cosim.system", "SystemSpec")),
    "sweep": Reader(
        suffix=".toml", write=_text(SWEEP), read=_toml("cosim.sweep.study", "SweepStudy")
    ),
    "signals": Reader(
        suffix=".toml",
        write=_copy(UF850 / "arm.toml"),
        read=_toml("fmu_src.arm.table", "SignalTable"),
    ),
    "run": Reader(suffix=".json", write=_results("run.json"), read=_run),
    "scores": Reader(suffix=".json", write=_results("evaluation.json"), read=_scores),
    "properties": Reader(suffix=".json", write=_results("properties.json"), read=_battery),
    "closed loop": Reader(
        suffix=".json",
        write=_results("closed_loop.json"),
        read=_result("cosim.studies.whole_loop", "LoopOutcome"),
    ),
    "findings": Reader(suffix=".json", write=_write_findings, read=_findings),
    "paths": Reader(suffix=".parquet", write=_write_paths, read=_paths),
    "urdf": Reader(suffix=".urdf", write=_text(URDF), read=_robot),
    "mjcf": Reader(suffix=".xml", write=_copy(UF850 / "uf850.xml"), read=_robot),
}
