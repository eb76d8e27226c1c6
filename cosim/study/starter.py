"""Project folders: robot model and file, study, and sample logs."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jinja2

from cosim.study.sample_logs import RATE, mark_samples, sample_logs
from cosim.study.study import Study
from hesr_model.errors import ConfigError, RobotError
from hesr_model.findings import Finding
from hesr_model.robots.mjcf import with_includes
from hesr_model.robots.model_file import arm, driven_joints, joints_of, load, locked
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import folder_written_whole, is_empty, models_folder
from hesr_model.support.text import few

_FILES = ("robot.toml", "study.toml", "README.txt")


@dataclass(frozen=True, kw_only=True)
class NewProject:
    """A created project folder."""

    folder: Path
    joints: tuple[str, ...]  # joints in the robot file
    followers: tuple[str, ...]
    locked: Mapping[str, float]  # positions of other joints [rad or m]
    doubts: tuple[Finding, ...]
    bench: str = ""  # kind of a bench, or "twin", whose folder has no logs and no study


def start(folder: Path, model: Path, joints: Sequence[str] = ()) -> NewProject:
    """Create a project folder for `hesr run`; see `hesr.new`.

    The model (URDF, or MJCF with suffix ``.xml``) is copied without its meshes, but with the
    files that it includes.
    """
    require_new(folder)
    if model.suffix.lower() == ".xacro":
        raise RobotError(
            f"{model}: is a xacro file; expand it first: "
            f"xacro {model.name} > {model.with_suffix('').with_suffix('.urdf').name}."
        )
    used = driven_joints(model, joints) if joints else arm(model)
    others = [joint for joint in joints_of(model) if joint not in used]
    rest, springs = locked(others), load(model).springs
    name = project_name(folder)
    with folder_written_whole(folder) as temporary:
        mjcf = model.suffix.lower() == ".xml"
        content = with_includes(model) if mjcf else model.read_bytes()
        (temporary / model.name).write_bytes(content)
        texts = environment()
        for file in _FILES:
            text = texts.get_template(f"{file}.j2").render(
                name=name,
                study=name,
                folder=folder.as_posix(),
                model=model.name,
                joints=used,
                resting=rest,
                unused=few([joint.name for joint in others]),
                names=", ".join(json.dumps(joint.name, ensure_ascii=False) for joint in used),
                springs=", ".join(json.dumps(own.name) for own in used if own.name in springs),
                ratios=", ".join(["100.0"] * len(used)),
                matrix=[
                    ", ".join("100.0" if i == k else "0.0" for i in range(len(used)))
                    for k in range(len(used))
                ],
                columns=_columns(len(used)),
                rate=RATE,
            )
            (temporary / file).write_text(text, encoding="utf-8")
        description = RobotDescription.read(temporary / "robot.toml")
        Study.read(temporary / "study.toml")
        written = []
        robot = Robot(description)
        for log in sample_logs(robot):
            written.append(temporary / "logs" / f"{log.name}.csv")
            log.write(written[-1])
        mark_samples(written)
    return NewProject(
        folder=folder,
        joints=tuple(joint.name for joint in used),
        followers=tuple(joint.name for joint in others if not joint.freedom),
        locked=rest,
        doubts=tuple(replace(doubt, where=str(folder / model.name)) for doubt in robot.doubts),
    )


def start_twin(folder: Path) -> NewProject:
    """Create the folder of a digital twin, whose motions `hesr simulate` logs."""
    require_new(folder)
    arm = models_folder() / "uf850"
    with folder_written_whole(folder) as temporary:
        shipped = [arm / name for name in ("uf850.xml", "robot.toml", "plant.toml", "arm.toml")]
        for file in (*shipped, *(models_folder() / "new" / "twin").iterdir()):
            (temporary / file.name).write_bytes(file.read_bytes())
        joints = RobotDescription.read(temporary / "robot.toml").joints
    return NewProject(
        folder=folder, joints=joints, followers=(), locked={}, doubts=(), bench="twin"
    )


def require_new(folder: Path) -> None:
    """Raise ConfigError unless a folder is new or empty."""
    if folder.is_file():
        raise ConfigError(f"{folder}: is a file; give a new or an empty folder.")
    if folder.is_dir() and not is_empty(folder):
        raise ConfigError(f"{folder}: is not empty; give a new or an empty folder.")


def project_name(folder: Path) -> str:
    """Return the name of a project, from that of its folder."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", folder.resolve().name).lstrip("_-") or "study"


def _columns(joints: int) -> str:
    last = f"..{{}}{joints}" if joints > 1 else ""
    return ", ".join(["t", *(f"{c}1{last.format(c)}" for c in ("q", "dq", "tau"))])


def environment() -> jinja2.Environment:
    """Return the templates of new projects."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(models_folder() / "new"),
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
        autoescape=False,
    )
    environment.filters["toml"] = lambda text: json.dumps(text, ensure_ascii=False)
    return environment
