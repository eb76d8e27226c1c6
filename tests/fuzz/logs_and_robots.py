"""Logs and model files of robots."""

import gzip
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
from reader import UF850, Reader, copy_of, text

from damage import damaged_archive, damaged_gzip  # isort: skip

from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription

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


def _log(path: Path) -> object:
    return Log.read(path, TWO)


def _table(path: Path, *, separator: str = ",") -> None:
    rng = np.random.default_rng(5)
    t = 0.01 * np.arange(60)
    kinds = ("q", "dq", "tau", "temperature")
    log = Log(name="run", t=t, **{k: rng.normal(size=(60, 2)) for k in kinds})
    log.write(path)
    if separator != ",":
        text = path.read_text(encoding="utf-8").replace(",", separator).replace(".", ",")
        path.write_text(text, encoding="utf-8")


def _columns() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(7)
    values = rng.normal(size=(60, 6))
    names = ("q1", "q2", "dq1", "dq2", "tau1", "tau2")
    return {"t": 0.01 * np.arange(60), **dict(zip(names, values.T, strict=True))}


def _npy(path: Path) -> None:
    columns = _columns()
    table = np.zeros(60, dtype=[(name, float) for name in columns])
    for name, values in columns.items():
        table[name] = values
    np.save(path, table)


def _feather(path: Path) -> None:
    import pyarrow
    from pyarrow import feather

    feather.write_feather(pyarrow.table(_columns()), path)


def _excel(path: Path) -> None:
    import openpyxl

    book = openpyxl.Workbook(write_only=True)
    sheet, columns = book.create_sheet("log"), _columns()
    sheet.append(list(columns))
    for row in np.column_stack(list(columns.values())).tolist():
        sheet.append(row)
    book.save(path)


def _hdf5(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for name, values in _columns().items():
            file.create_dataset(name, data=values)


def _encoded(encoding: str) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        _table(path)
        path.write_bytes(path.read_text(encoding="utf-8").encode(encoding))

    return write


def _packed(path: Path) -> None:
    _table(path.with_suffix(""))
    path.write_bytes(gzip.compress(path.with_suffix("").read_bytes()))


def _recording(path: Path) -> None:
    """Format of Universal Robots: blanks between cells, joints from 0."""
    rng = np.random.default_rng(6)
    values = np.column_stack([0.008 * np.arange(80) + 1.6e9, rng.normal(size=(80, 10))])
    kinds = ("actual_q", "actual_qd", "actual_current", "target_moment", "joint_temperatures")
    header = ["timestamp", *(f"{kind}_{k}" for kind in kinds for k in range(2))]
    rows = [" ".join(map(str, row)) for row in values]
    path.write_text("\r\n".join([" ".join(header), *rows, ""]), encoding="utf-8")


def _inspected(path: Path) -> object:
    from hesr_model.health.proposal import inspect_logs, robot_file, summary_rows

    found = inspect_logs([path])
    return robot_file(found, path.with_suffix(".toml")), list(summary_rows(found))


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


def _robot(path: Path) -> object:
    from hesr_model.robots.model_file import find_driven_joints

    joints = tuple(joint.name for joint in find_driven_joints(path))
    return Robot(RobotDescription(name="robot", model=path, joints=joints))


LOGS_AND_ROBOTS = {
    "csv": Reader(suffix=".csv", write=_table, read=_log),
    "csv with decimal commas": Reader(
        suffix=".csv", write=lambda path: _table(path, separator=";"), read=_log
    ),
    "rtde": Reader(suffix=".csv", write=_recording, read=_inspected),
    "csv of a stranger": Reader(suffix=".csv", write=_table, read=_inspected),
    "parquet": Reader(suffix=".parquet", write=_table, read=_log),
    "csv, packed": Reader(suffix=".csv.gz", write=_packed, read=_log, damage=damaged_gzip),
    "csv in UTF-16": Reader(suffix=".csv", write=_encoded("utf-16"), read=_log),
    "csv in UTF-16 of a stranger": Reader(
        suffix=".csv", write=_encoded("utf-16-be"), read=_inspected
    ),
    "npy": Reader(suffix=".npy", write=_npy, read=_log),
    "npz": Reader(
        suffix=".npz",
        write=lambda path: np.savez_compressed(path, **_columns()),
        read=_log,
        damage=damaged_archive,
    ),
    "excel": Reader(suffix=".xlsx", write=_excel, read=_log, damage=damaged_archive),
    "feather": Reader(suffix=".feather", write=_feather, read=_log),
    "hdf5": Reader(suffix=".h5", write=_hdf5, read=_log),
    "hdf5 of a stranger": Reader(suffix=".h5", write=_hdf5, read=_inspected),
    "matlab": Reader(suffix=".mat", write=_matlab("save_classic"), read=_log),
    "matlab 4": Reader(suffix=".mat", write=_matlab_4, read=_log),
    "matlab, packed": Reader(suffix=".mat", write=_matlab("save_compressed"), read=_log),
    "matlab 7.3": Reader(suffix=".mat", write=_matlab("save_hdf5"), read=_log),
    "ros 1 bag": Reader(suffix=".bag", write=_bag_of_ros_1, read=_log),
    "ros 2 bag": Reader(suffix=".db3", write=_bag("SQLITE3"), read=_log),
    "mcap": Reader(suffix=".mcap", write=_bag("MCAP"), read=_log),
    "urdf": Reader(suffix=".urdf", write=text(URDF), read=_robot),
    "mjcf": Reader(suffix=".xml", write=copy_of(UF850 / "uf850.xml"), read=_robot),
}
