"""Project folders: robot model and file, study, and sample logs; benches have no model file."""

import json
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import jinja2
import numpy as np

from cosim.study.sample_logs import RATE, mark_samples, sample_logs
from cosim.study.study import Study
from fmu_src.pages.html import code_templates
from hesr_model.errors import ArgumentError, ConfigError, RobotError
from hesr_model.findings import Finding
from hesr_model.health.proposal import robot_text
from hesr_model.robots.mjcf import copy_model
from hesr_model.robots.model_file import (
    ModelJoint,
    find_arm,
    find_driven_joints,
    find_rest_positions,
    load,
    read_joints,
)
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import (
    find_real_path,
    is_empty,
    models_folder,
    refuse_broken_link,
)
from hesr_model.support.result_folder import folder_written_whole
from hesr_model.support.text import join_few, to_toml

_FILES = ("robot.toml", "study.toml", "README.txt")


@dataclass(frozen=True, kw_only=True)
class NewProject:
    """A created project folder.

    Attributes
    ----------
    folder : the new folder.
    joints : joints in the robot file, from base to tip.
    followers : joints that follow one of these.
    locked : positions of the other joints [rad or m].
    doubts : findings about the model file.
    bench : kind of a bench, or "twin", whose folder has no logs and no study; "" for a robot.
    source : public repository of its logs.
    is_sample : whether the robot is the sample.
    """

    folder: Path
    joints: tuple[str, ...]
    followers: tuple[str, ...] = ()
    locked: Mapping[str, float] = field(default_factory=dict)
    doubts: tuple[Finding, ...] = ()
    bench: str = ""
    source: str = ""
    is_sample: bool = False


def sample_model() -> Path:
    """Return the model file of the sample robot."""
    return models_folder() / "uf850" / "uf850.xml"


def start(folder: Path, model: Path, joints: Sequence[str] = ()) -> NewProject:
    """Create a project folder for `hesr run`; see `hesr.new`.

    The model (URDF, or MJCF as ``.xml``) is copied with its includes and with the meshes that its
    masses come from.
    """
    require_new(folder)
    if model.suffix.lower() == ".xacro":
        raise RobotError(
            f"{model}: is a xacro file; expand it first: "
            f"xacro {model.name} > {model.with_suffix('').with_suffix('.urdf').name}."
        )
    used_joints = find_driven_joints(model, joints) if joints else find_arm(model)
    other_joints = [joint for joint in read_joints(model) if joint not in used_joints]
    resting_positions = find_rest_positions(other_joints)
    values = _fill_in_joints(used_joints, load(model).springs)
    name = project_name(folder)
    with folder_written_whole(folder, is_listed=False) as temporary:
        if model.suffix.lower() == ".xml":
            copy_model(model, temporary)
        else:
            (temporary / model.name).write_bytes(model.read_bytes())
        for file in _FILES:
            text = _template(file).render(
                toml=to_toml,
                name=name,
                study=name,
                folder=folder.as_posix(),
                model=model.name,
                joints=used_joints,
                resting=resting_positions,
                unused=join_few([joint.name for joint in other_joints]),
                rate=RATE,
                **values,
            )
            (temporary / file).write_text(text, encoding="utf-8")
        description = RobotDescription.read(temporary / "robot.toml")
        Study.read(temporary / "study.toml")
        robot = Robot(description)
        _write_samples(robot, temporary / "logs")
    return NewProject(
        folder=folder,
        joints=tuple(joint.name for joint in used_joints),
        followers=tuple(joint.name for joint in other_joints if not joint.freedom),
        locked=resting_positions,
        doubts=tuple(replace(finding, where=str(folder / model.name)) for finding in robot.doubts),
    )


def _fill_in_joints(joints: Sequence[ModelJoint], springs: Collection[str]) -> dict[str, Any]:
    """Return the values of the templates that list joints, as TOML; `springs` are names."""
    count = len(joints)
    columns = ["t", "q1", "dq1", "tau1"]
    if count > 1:
        columns = ["t", f"q1..q{count}", f"dq1..dq{count}", f"tau1..tau{count}"]
    rows = []
    for k in range(count):
        row = ["0.0"] * count
        row[k] = "100.0"
        rows.append(", ".join(row))
    return {
        "names": ", ".join(to_toml(joint.name) for joint in joints),
        "springs": ", ".join(json.dumps(joint.name) for joint in joints if joint.name in springs),
        "ratios": ", ".join(["100.0"] * count),
        "matrix": rows,
        "columns": ", ".join(columns),
    }


def _write_samples(robot: Robot, folder: Path) -> None:
    """Write the sample logs of a robot and mark them as such."""
    log_paths = []
    for log in sample_logs(robot):
        log_path = folder / f"{log.name}.csv"
        log.write(log_path)
        log_paths.append(log_path)
    mark_samples(log_paths)


def start_twin(folder: Path) -> NewProject:
    """Create the folder of a digital twin, whose motions `hesr simulate` logs."""
    require_new(folder)
    arm = models_folder() / "uf850"
    with folder_written_whole(folder, is_listed=False) as temporary:
        shipped = [arm / name for name in ("uf850.xml", "robot.toml", "plant.toml", "arm.toml")]
        for file in (*shipped, *(models_folder() / "new" / "twin").iterdir()):
            (temporary / file.name).write_bytes(file.read_bytes())
        joints = RobotDescription.read(temporary / "robot.toml").joints
    return NewProject(folder=folder, joints=joints, bench="twin")


def require_new(folder: Path) -> None:
    """Raise ConfigError unless a folder is new or empty."""
    refuse_broken_link(folder)
    if folder.is_file():
        raise ConfigError(f"{folder}: is a file; give a new or an empty folder.")
    if folder.is_dir() and not is_empty(folder):
        raise ConfigError(f"{folder}: is not empty; give a new or an empty folder.")


def project_name(folder: Path) -> str:
    """Return the name of a project, from that of its folder."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", find_real_path(folder).name).lstrip("_-") or "study"


def _template(file: str) -> jinja2.Template:
    return code_templates(models_folder() / "new").get_template(f"{file}.j2")


_GRAVITY = 9.81  # [m/s2]
_AXES = {"rotary": ("0 0 1", "0 1 0"), "sliding": ("1 0 0", "0 0 1")}  # without and with gravity


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Independent bodies, one per joint; a number that is None is identified."""

    kind: Literal["rotary", "sliding"]
    joints: tuple[str, ...]
    gravity: bool = False  # sliding axes are vertical, rotary ones horizontal
    inertia: tuple[float, ...] | None = None  # [kg.m2], of a sliding joint mass [kg]
    moment: tuple[float, ...] | None = None  # amplitude of the gravity moment [N.m]
    phase: tuple[float, ...] | None = None  # where the body hangs and the moment is 0 [rad]
    gear_ratio: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.kind not in _AXES:
            raise ArgumentError(f"'bench' is '{self.kind}'; it must be rotary or sliding.")
        repeated = [name for name in self.joints if self.joints.count(name) > 1]
        if repeated:
            raise ArgumentError(
                f"'joints' has '{repeated[0]}' twice; every joint needs its own name."
            )
        if self.kind == "sliding" and (self.moment or self.phase):
            raise ArgumentError("'moment' and 'phase' are for a rotary bench; use 'gravity'.")
        if (self.moment is None) != (self.phase is None):
            raise ArgumentError("'moment' and 'phase' belong together; give both or neither.")
        self._require_positive()
        for value in self.phase or ():
            if not np.isfinite(value):
                raise ArgumentError(f"'phase' is {value:g}; it must be finite.")

    def _require_positive(self) -> None:
        for name in ("inertia", "moment"):
            for value in getattr(self, name) or ():
                if not (np.isfinite(value) and value > 0.0):
                    raise ArgumentError(f"'{name}' is {value:g}; it must be positive.")

    @property
    def hangs(self) -> bool:
        """Whether gravity acts along or about the axes."""
        return self.gravity or self.moment is not None

    @property
    def known(self) -> tuple[str, ...]:
        """Names of the known parameters."""
        names = []
        if self.inertia:
            names.append(self._inertia_name)
        if self.moment:
            names += ["mx", "mz"]
        known = []
        for joint in self.joints:
            known += [f"{joint}.{name}" for name in names]
        return tuple(known)

    @property
    def _inertia_name(self) -> str:
        """Name of the parameter of a body that its joint accelerates."""
        if self.kind == "sliding":
            return "m"
        return "Iyy" if self.hangs else "Izz"

    def urdf(self) -> str:
        """Return a model with one link per joint."""
        return _template("bench.urdf").render(
            joints=[self._body(k) for k in range(len(self.joints))],
            type="continuous" if self.kind == "rotary" else "prismatic",
            axis=_AXES[self.kind][self.hangs],
        )

    def _body(self, k: int) -> Mapping[str, Any]:
        """Return mass, inertia and centre of a body; half of its inertia is that of the mass."""
        # In the model file one SI unit stands for a number that is to be identified.
        inertia = self.inertia[k] if self.inertia else 1.0
        phase = self.phase[k] if self.phase else 0.0
        first_moment = 0.0
        mass = inertia
        if self.kind == "rotary" and self.hangs:
            gravity_moment = self.moment[k] if self.moment else 1.0
            first_moment = gravity_moment / _GRAVITY
            mass = 2.0 * first_moment**2 / inertia
        return {
            "name": self.joints[k],
            "mass": mass,
            "inertia": inertia - first_moment**2 / mass,
            "x": first_moment / mass * float(np.sin(phase)),
            "z": -first_moment / mass * float(np.cos(phase)),
        }


def start_bench(
    folder: Path, bench: Bench, log: Mapping[str, Any], source: str | None = None
) -> NewProject:
    """Create a folder with the model of a bench and its robot file, which has `log` as [log].

    `source` is that of the torque constants in `log`.
    """
    require_new(folder)
    with folder_written_whole(folder, is_listed=False) as temporary:
        model_path = temporary.resolve() / "bench.urdf"
        file = temporary.resolve() / "robot.toml"
        model_path.write_text(bench.urdf(), encoding="utf-8")
        description = RobotDescription.from_data(
            folder / "robot.toml",
            {
                "name": project_name(folder),
                "model": str(model_path),
                "joints": bench.joints,
                "known": bench.known,
                "rotor_inertia": False,
                "gear_ratio": bench.gear_ratio,
                "log": log,
                "sources": {"torque_per_ampere": source} if source else {},
            },
        )
        Robot(description)
        head = "Written by 'hesr new'; 'hesr inspect --write' adds the columns of a log."
        file.write_text(robot_text(description, file, head), encoding="utf-8")
    return NewProject(folder=folder, joints=bench.joints, bench=bench.kind)
