"""Model files as MuJoCo compiles them, and its inverse dynamics to check robots against.

A child process compiles each file first: MuJoCo cannot be interrupted, and small files can ask it
for any amount of time and memory.
"""

import json
import os
import shutil
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from pydantic import BaseModel, ValidationError

from hesr_model.errors import ConfigError, RobotError
from hesr_model.robots import mjcf_forces
from hesr_model.robots.mjcf_forces import measure_forces
from hesr_model.robots.mjcf_source import MjcfSource
from hesr_model.robots.urdf import UNLIMITED, read_urdf
from hesr_model.support.arrays import Array
from hesr_model.support.cache import compute_once
from hesr_model.support.child import run_in_child
from hesr_model.support.files import scratch_folder
from hesr_model.support.process import DiedError
from hesr_model.support.text import on_one_line, sanitise

_SECONDS = 20.0  # to compile a file
_MAX_MEMORY = 2 << 30  # to compile a file [B]
_MAX_MESSAGE_LENGTH = 1000  # characters of a child's
_TRIAL = "2"  # version of what a trial does
_MIN_INERTIA = 1e-9  # mass and inertia of the links of a URDF for MuJoCo [kg, kg.m2]
_STATE_COUNT = 8  # random states of the check
Compiled = dict[str, Any]  # a compiled file as JSON; see `_describe_model`


def import_engine() -> Any:
    """Import MuJoCo without its log, a file in the current folder."""
    import mujoco  # slow to import

    config = mujoco.MjLogConfig.get()
    config.logto_file = config.logto_console = False
    config.set()
    return mujoco


def compile_model(path: Path) -> Any:
    """Return the MuJoCo model of an MJCF or URDF; ConfigError if it is missing or invalid."""
    if not path.is_file():
        raise ConfigError(f"{path}: no such model file.")
    if is_urdf(path):
        return compile_spec(path)
    with _copy_compilable(path) as copy_path, _report_refusal(path):
        return import_engine().MjModel.from_xml_path(str(copy_path))


def compile_spec(path: Path, change: Callable[[Any], None] = lambda _: None) -> Any:
    """Return the changed MuJoCo model of a file; a URDF has no appearance and no contacts."""
    with ExitStack() as stack:
        # Attributes may be deprecated.
        stack.enter_context(warnings.catch_warnings(action="ignore"))
        if is_urdf(path):
            text = read_urdf(path, path.read_bytes()).text
            with scratch_folder() as folder:
                _require_success(path, _try_once("a URDF", [text], "text", text, folder))
            stack.enter_context(_report_refusal(path))
            spec = import_engine().MjSpec.from_string(text)
            _soften_urdf(spec)
        else:
            copy_path = stack.enter_context(_copy_compilable(path))
            stack.enter_context(_report_refusal(path))
            spec = import_engine().MjSpec.from_file(str(copy_path))
        change(spec)
        return spec.compile()


def is_urdf(path: Path) -> bool:
    """Return whether a name is that of a URDF."""
    return path.suffix.lower() == ".urdf"


@contextmanager
def _report_refusal(path: Path) -> Iterator[None]:
    try:
        yield
    except (ValueError, RuntimeError) as error:  # RuntimeError: out of memory
        kind = "a URDF" if is_urdf(path) else "an MJCF"
        message = f"{path}: cannot be compiled as {kind} ({on_one_line(error)})."
        raise ConfigError(message) from error


def compile_robot(path: Path) -> Compiled:
    """Return an MJCF without its appearance; RobotError if MuJoCo cannot compile it."""
    try:
        source = MjcfSource.read(path)
        compiled_tree = _describe_once(_list_content(source), "file", str(path), source.readable)
    except ConfigError as error:
        raise RobotError(str(error)) from error
    if "refusal" in compiled_tree:
        raise RobotError(f"{path}: cannot be compiled as an MJCF ({compiled_tree['refusal']}).")
    return compiled_tree


def compute_urdf_torques(text: str) -> Compiled | None:
    """Return MuJoCo's torques of a URDF without meshes, None if MuJoCo cannot compile it."""
    return _describe_once([text], "text", text, ()).get("check")


def _describe_once(
    content: Iterable[str | bytes], kind: str, source: str, readable: Sequence[Path]
) -> Compiled:
    """Return what `describe_model` returns in a child, computed once for each content."""
    subject = source if kind == "file" else "a URDF"

    def make() -> bytes:
        compiled_tree = _run_in_child(subject, "describe_model", kind, source, readable)
        if "unusable" in compiled_tree:
            raise RobotError(sanitise(str(compiled_tree["unusable"]), _MAX_MESSAGE_LENGTH))
        return json.dumps(compiled_tree).encode()

    sources = [Path(__file__).read_bytes(), Path(mjcf_forces.__file__).read_bytes()]
    key: list[str | bytes] = [*sources, version("mujoco"), *content]
    compiled_tree: Compiled = json.loads(compute_once("robots", key, make))
    if "refusal" in compiled_tree:
        return {"refusal": str(compiled_tree["refusal"])}
    return _require_form(compiled_tree)


def _require_form(compiled_tree: Compiled) -> Compiled:
    """Return the description of a model if it is numbers and texts of the known form."""
    try:
        return _Description.model_validate(compiled_tree).model_dump()
    except ValidationError as error:
        raise RobotError("MuJoCo gave an invalid answer about a model.") from error


class _Torques(BaseModel):
    joints: list[str]
    q: list[list[float]]
    dq: list[list[float]]
    ddq: list[list[float]]
    held: dict[str, float]
    torques: list[list[float]]


class _Description(BaseModel):
    """What `_describe_model` returns."""

    urdf: str
    gravity: tuple[float, float, float]
    rest: dict[str, float]
    armature: dict[str, float]
    springs: dict[str, tuple[float, float]]
    loops: list[tuple[str, str]]
    couplings: dict[str, list[str]]
    check: _Torques
    forces: dict[str, dict[str, float]] = {}
    unknown_forces: str = ""


@contextmanager
def _copy_compilable(path: Path) -> Iterator[Path]:
    """Yield a copy of an MJCF that a child has compiled within its limits; raises ConfigError.

    What is compiled here are the same bytes, whatever happens to the files meanwhile.
    """
    source = MjcfSource.read(path)
    with scratch_folder() as folder:
        copy = source.copy_to(folder / "model")
        refusal = _try_once(str(path), copy.content, "file", str(copy.path), copy.folder)
        _require_success(path, refusal)
        yield copy.path


def _list_content(source: MjcfSource) -> Iterator[str | bytes]:
    yield source.data
    for file in source.files:
        yield f"{file} {file.stat().st_size} {file.stat().st_mtime_ns}"


def _try_once(subject: str, content: Sequence[str], kind: str, source: str, folder: Path) -> str:
    """Return why a child cannot compile what lies in a folder, once for each content."""

    def make() -> bytes:
        refusal = str(_run_in_child(subject, "try_model", kind, source, [folder]))
        return refusal.replace(str(folder), "").encode()

    key: list[str | bytes] = [_TRIAL, version("mujoco"), kind, *content]
    return compute_once("trials", key, make).decode()


def _require_success(path: Path, refusal: str) -> None:
    if refusal:
        kind = "a URDF" if is_urdf(path) else "an MJCF"
        raise ConfigError(f"{path}: cannot be compiled as {kind} ({sanitise(refusal, 400)}).")


def _run_in_child(
    subject: str, function: str, kind: str, source: str, readable: Sequence[Path]
) -> Any:
    """Return the answer of a function of this module; ConfigError about a subject if it ends."""
    with scratch_folder() as folder:
        try:
            return run_in_child(
                f"{__name__}:{function}",
                kind,
                source,
                str(Path.cwd()),
                folder=folder,
                seconds=_SECONDS,
                memory=_MAX_MEMORY,
                readable=readable,
                modules=("mujoco", "pinocchio"),
            )
        except DiedError as error:
            raise ConfigError(f"{subject}: cannot be compiled (MuJoCo {error}).") from error


def describe_model(kind: str, source: str, folder: str) -> dict[str, Any]:
    """Return a compiled model, of a file relative to a folder or of the text of a URDF.

    Called in a child. A model that MuJoCo refuses gives its reason.
    """
    os.chdir(folder)
    try:
        with warnings.catch_warnings(action="ignore"):  # deprecated attributes
            spec = _strip_mjcf(Path(source)) if kind == "file" else _read_rigid_urdf(source)
            spec.compiler.fusestatic = False
            description = _describe_model(spec.compile())
            if kind == "file":
                description |= _describe_forces(Path(source), description)
            return description
    except RobotError as error:
        return {"unusable": str(error)}
    except (ValueError, RuntimeError) as error:
        return {"refusal": on_one_line(error)}


def try_model(kind: str, source: str, folder: str) -> str:
    """Compile a model as `compile_model` does, and return why it is refused. Called in a child."""
    os.chdir(folder)
    mujoco = import_engine()
    try:
        with warnings.catch_warnings(action="ignore"):  # deprecated attributes
            specs = mujoco.MjSpec
            spec = specs.from_file(source) if kind == "file" else specs.from_string(source)
            if kind == "text":
                _soften_urdf(spec)
            mujoco.MjData(spec.compile())
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        return on_one_line(error)
    return ""


def _soften_urdf(spec: Any) -> None:
    spec.compiler.balanceinertia = True  # MuJoCo refuses what rounding makes impossible
    spec.compiler.boundmass = spec.compiler.boundinertia = _MIN_INERTIA


def _read_rigid_urdf(text: str) -> Any:
    spec = import_engine().MjSpec.from_string(text)
    # MuJoCo splits a planar joint into three, which the file does not name: they stay at rest.
    for body in spec.bodies:
        if len(body.joints) > 1:
            for joint in list(body.joints):
                spec.delete(joint)
    return spec


def list_shape_meshes(kind: str, source: str, folder: str) -> list[str]:
    """Return the names of the meshes that masses come from. Called in a child."""
    assert kind == "file"
    os.chdir(folder)
    return [mesh.name for mesh in _strip_mjcf(Path(source)).meshes]


def copy_model(path: Path, folder: Path) -> None:
    """Copy an MJCF into a folder, with its includes and the meshes that its masses come from.

    Other meshes, textures and height fields have no effect on torques and are left out.
    """
    source = MjcfSource.read(path)
    data = source.data
    mesh_names = set(
        map(str, _run_in_child(str(path), "list_shape_meshes", "file", str(path), source.readable))
    )
    if mesh_names:
        _copy_meshes(source, mesh_names, folder)
        data = ElementTree.tostring(source.root)
    (folder / path.name).write_bytes(data)


def _copy_meshes(source: MjcfSource, mesh_names: set[str], folder: Path) -> None:
    """Copy meshes next to the copy of their model, whose elements then name them."""
    copies: dict[Element, Path] = {}
    for element, _, file in source.find_files():
        name = element.get("name", Path(element.get("file", "")).stem)
        if element.tag == "mesh" and name in mesh_names and file.is_file():
            element.set("name", name)
            copies.setdefault(element, file)
    for number, (element, file) in enumerate(copies.items(), start=1):
        # Meshes of several folders may have one name; MuJoCo may strip folders from names.
        copy_name = f"mesh{number}_{file.name}"
        shutil.copyfile(file, folder / copy_name)
        element.set("file", copy_name)
    for compiler in source.root.iter("compiler"):
        for kind in ("assetdir", "meshdir"):
            compiler.attrib.pop(kind, None)


def _describe_forces(path: Path, description: Compiled) -> dict[str, Any]:
    """Return what the forces of a file are worth by joint, or why they are not known.

    The joints that equalities of tendons couple are added to those of other equalities.
    """
    check = description["check"]
    try:
        spec = _strip_mjcf(path, keep_forces=True)
        spec.compiler.fusestatic = False
        mj_model = spec.compile()
        own_torques = np.array(check["torques"]).reshape(len(check["q"]), -1)
        joint_kinds = [int(kind) for kind in _get_joint_transmissions()]
        couplings = description["couplings"] | _couple_by_tendons(mj_model)
        at_tendons = ~np.isin(mj_model.actuator_trntype, joint_kinds)
        compute = partial(_compute_inverse, check=check)
        forces = measure_forces(mj_model, compute, own_torques, at_tendons)
    except (ValueError, RuntimeError, KeyError, RobotError) as error:
        return {"unknown_forces": on_one_line(error)}
    return {
        "couplings": couplings,
        "forces": {
            force: dict(zip(check["joints"], worths, strict=True))
            for force, worths in forces.items()
        },
    }


def _couple_by_tendons(mj_model: Any) -> dict[str, list[str]]:
    """Return the joints that each equality of tendons couples, by the names of the tendons."""
    kinds = import_engine().mjtEq
    joint_names = _name_joints(mj_model)
    couplings = {}
    for k in _list_equalities(mj_model):
        if kinds(mj_model.eq_type[k]) != kinds.mjEQ_TENDON:
            continue
        tendons = [mj_model.eq_obj1id[k], mj_model.eq_obj2id[k]]
        tendons = [int(tendon) for tendon in tendons if tendon >= 0]
        joints = set[int]().union(*(_find_joints_of_tendon(mj_model, t) for t in tendons))
        names = [mj_model.tendon(t).name or f"number {t}" for t in tendons]
        cause = f"an equality of tendon {' and '.join(names)}"
        couplings[cause] = [joint_names[j] for j in sorted(joints)]
    return couplings


def _find_joints_of_tendon(mj_model: Any, tendon: int) -> set[int]:
    """Return the joints that change the length of a tendon.

    Those of a tendon along sites and geoms are the joints above some of them, but not above all.
    """
    kinds = import_engine().mjtWrap
    joints = set[int]()
    chains: list[set[int]] = []
    first = mj_model.tendon_adr[tendon]
    for wrap in range(first, first + mj_model.tendon_num[tendon]):
        kind = kinds(mj_model.wrap_type[wrap])
        target = int(mj_model.wrap_objid[wrap])
        if kind == kinds.mjWRAP_JOINT:
            joints.add(target)
        elif kind == kinds.mjWRAP_SITE:
            chains.append(_find_joints_above(mj_model, mj_model.site_bodyid[target]))
        elif kind in (kinds.mjWRAP_SPHERE, kinds.mjWRAP_CYLINDER):
            chains.append(_find_joints_above(mj_model, mj_model.geom_bodyid[target]))
    if chains:
        joints |= set[int]().union(*chains) - chains[0].intersection(*chains)
    return joints


def _find_joints_above(mj_model: Any, body: int) -> set[int]:
    joints = set[int]()
    while body > 0:
        joints.update(np.flatnonzero(mj_model.jnt_bodyid == body).tolist())
        body = mj_model.body_parentid[body]
    return joints


def _compute_inverse(mj_model: Any, *, check: dict[str, Any]) -> Array:
    """Return torques (8, n) of the joints of a check at its states, with passive forces."""
    mujoco = import_engine()
    mj_model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    mj_model.opt.enableflags = 0
    names = {name: j for j, name in enumerate(_name_joints(mj_model))}
    joints = [names[name] for name in check["joints"]]
    q_addresses = mj_model.jnt_qposadr[joints]
    dofs = mj_model.jnt_dofadr[joints]
    data = mujoco.MjData(mj_model)
    for name, position in check["held"].items():
        data.qpos[mj_model.jnt_qposadr[names[name]]] = position
    torques = []
    for state in zip(check["q"], check["dq"], check["ddq"], strict=True):
        data.qpos[q_addresses], data.qvel[dofs], data.qacc[dofs] = state
        mujoco.mj_inverse(mj_model, data)
        torques.append(data.qfrc_inverse[dofs].copy())
    return np.array(torques)


def _strip_mjcf(path: Path, *, keep_forces: bool = False) -> Any:
    """Read what has effects on rigid-body torques, with meshes if inertias need them.

    Passive forces, tendons, and shapes without meshes stay with `keep_forces`.
    """
    mujoco = import_engine()
    spec = mujoco.MjSpec.from_file(str(path))
    # Only constraints need more memory than MuJoCo's default, and some files ask for gigabytes.
    spec.memory = spec.nstack = spec.njmax = spec.nconmax = -1
    for part in _list_ineffective_parts(spec, keep_forces=keep_forces):
        spec.delete(part)
    meshes = set()
    bodies = _find_shaped_bodies(spec)
    for site in spec.sites:
        site.material = ""
        if site.meshname and keep_forces:
            meshes.add(site.meshname)
        elif site.meshname:
            site.meshname = ""
            site.type = mujoco.mjtGeom.mjGEOM_SPHERE
    for geom in spec.geoms:
        geom.material = ""
        if geom.parent.name not in bodies and not (keep_forces and _may_have_force(spec, geom)):
            spec.delete(geom)
        elif geom.meshname:
            meshes.add(geom.meshname)
            _require_mesh(spec, geom, path)
    unused = [mesh for mesh in spec.meshes if mesh.name not in meshes]
    for asset in (*unused, *spec.materials, *spec.textures, *spec.hfields):
        spec.delete(asset)
    return spec


def _list_ineffective_parts(spec: Any, *, keep_forces: bool) -> list[Any]:
    """Return the parts without an effect on torques, tendons with what they move among them."""
    kinds = import_engine().mjtEq
    parts = [
        *spec.sensors,
        *spec.keys,
        *spec.pairs,
        *spec.excludes,
        *spec.tuples,
        *spec.skins,
    ]
    equalities = [kinds.mjEQ_JOINT, kinds.mjEQ_CONNECT, kinds.mjEQ_WELD]
    if keep_forces:
        equalities.append(kinds.mjEQ_TENDON)
    parts += [equality for equality in spec.equalities if equality.type not in equalities]
    if not keep_forces:
        transmissions = _get_joint_transmissions()
        parts += [actuator for actuator in spec.actuators if actuator.trntype not in transmissions]
        parts += spec.tendons
    return parts


def _get_joint_transmissions() -> tuple[Any, Any]:
    kinds = import_engine().mjtTrn
    return (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT)


def _may_have_force(spec: Any, geom: Any) -> bool:
    """Return whether a tendon may wrap around a geom, or a fluid flow around its ellipsoid."""
    kinds = import_engine().mjtGeom
    if geom.fluid_ellipsoid and (spec.option.density or spec.option.viscosity):
        return True
    return geom.type not in (kinds.mjGEOM_MESH, kinds.mjGEOM_HFIELD, kinds.mjGEOM_SDF)


def _name_joints(mj_model: Any) -> list[str]:
    return _number_unnamed([mj_model.joint(j).name for j in range(mj_model.njnt)], "joint")


def _number_unnamed(names: Sequence[str], kind: str) -> list[str]:
    """Return unique names; replace each empty name by the kind and a number."""
    numbered_names = []
    for number, name in enumerate(names):
        new_name = name or f"{kind}{number}"
        while not name and new_name in names:
            new_name += "_"
        numbered_names.append(new_name)
    return numbered_names


def _find_shaped_bodies(spec: Any) -> set[str]:
    inertia_source = spec.compiler.inertiafromgeom
    has_total_mass = spec.compiler.settotalmass > 0.0
    kinds = import_engine().mjtInertiaFromGeom
    moving_bodies: set[str] = set()
    names = _number_unnamed([body.name for body in spec.bodies], "body")
    for body, name in zip(spec.bodies[1:], names[1:], strict=True):
        body.name = name
        if body.parent.name in moving_bodies or list(body.joints) or has_total_mass:
            moving_bodies.add(body.name)
    if inertia_source == kinds.mjINERTIAFROMGEOM_FALSE:
        return set()
    is_always_shaped = inertia_source == kinds.mjINERTIAFROMGEOM_TRUE
    return {
        b.name
        for b in spec.bodies
        if b.name in moving_bodies and (is_always_shaped or not b.explicitinertial)
    }


def _require_mesh(spec: Any, geom: Any, path: Path) -> None:
    mesh = spec.mesh(geom.meshname)
    folder = Path(spec.modelfiledir or path.parent, spec.meshdir or "")
    if mesh is not None and mesh.file and not (folder / mesh.file).is_file():
        raise RobotError(
            f"{path}: the inertia of body '{geom.parent.name}' comes from the mesh '{mesh.file}', "
            f"which is not in {folder}; put it there, or give the body an <inertial>."
        )


def _describe_model(mj_model: Any) -> Compiled:
    """Return the tree as a URDF, what a URDF cannot state, and torques to compare."""
    names = _name_joints(mj_model)
    if mj_model.opt.disableflags & int(import_engine().mjtDisableBit.mjDSBL_GRAVITY):
        mj_model.opt.gravity[:] = 0.0
    equalities = _read_equalities(mj_model, names)
    held_positions = equalities.held_positions
    armature = mj_model.dof_armature[mj_model.jnt_dofadr]
    # A joint may have several motors.
    for motor in range(len(mj_model.actuator_armature)):
        joint = mj_model.actuator_trnid[motor, 0]
        armature[joint] += mj_model.actuator_gear[motor, 0] ** 2 * mj_model.actuator_armature[motor]
    has_springs = not mj_model.opt.disableflags & int(import_engine().mjtDisableBit.mjDSBL_SPRING)
    stiffness = mj_model.jnt_stiffness * has_springs
    single_joints = {
        name: j for j, name in enumerate(names) if mj_model.jnt_type[j] >= 2
    }  # slide, hinge
    return {
        "urdf": _write_urdf(mj_model, names, equalities.followers, held_positions),
        "gravity": mj_model.opt.gravity.tolist(),
        "rest": {
            n: float(mj_model.qpos0[mj_model.jnt_qposadr[j]]) for n, j in single_joints.items()
        }
        | held_positions,
        "armature": {name: float(armature[j]) for name, j in single_joints.items()},
        "springs": {
            name: (float(k), -float(k * mj_model.qpos_spring[mj_model.jnt_qposadr[j]]))
            for name, j in single_joints.items()
            if (k := stiffness[j]) and name not in held_positions
        },
        "loops": equalities.loops,
        "couplings": equalities.couplings,
        "check": _compute_torques(mj_model, single_joints, held_positions),
    }


def _write_urdf(
    mj_model: Any, names: list[str], followers: dict[str, Any], held_positions: dict[str, float]
) -> str:
    """Write a compiled model as a URDF with the same positions; every joint carries a link."""
    import pinocchio as pin  # slow to import

    robot = Element("robot", name="mjcf")
    links = [mj_model.body(b).name or f"body{b}" for b in range(mj_model.nbody)]
    SubElement(robot, "link", name=links[0])

    def add_joint(
        name: str, kind: str, ends: tuple[str, str], place: Any
    ) -> tuple[Element, Element]:
        joint_element = SubElement(robot, "joint", name=name, type=kind)
        SubElement(joint_element, "parent", link=ends[0])
        SubElement(joint_element, "child", link=ends[1])
        rpy = pin.rpy.matrixToRpy(place.rotation)
        SubElement(
            joint_element,
            "origin",
            xyz=_format_numbers(place.translation),
            rpy=_format_numbers(rpy),
        )
        return joint_element, SubElement(robot, "link", name=ends[1])

    for b in range(1, mj_model.nbody):
        parent = links[mj_model.body_parentid[b]]
        place = _build_pose(mj_model.body_pos[b], mj_model.body_quat[b])
        for j in np.flatnonzero(mj_model.jnt_bodyid == b):
            name = names[j]
            anchor = _build_pose(mj_model.jnt_pos[j])
            axis = mj_model.jnt_axis[j]
            kind = ("floating", "floating", "prismatic", "revolute")[mj_model.jnt_type[j]]
            displacement = held_positions.get(name, 0.0) - float(
                mj_model.qpos0[mj_model.jnt_qposadr[j]]
            )
            if kind == "prismatic":
                anchor = anchor * pin.SE3(np.eye(3), displacement * axis)
            elif kind == "revolute":
                anchor = anchor * pin.SE3(pin.exp3(displacement * axis), np.zeros(3))
            kind, child = "fixed" if name in held_positions else kind, f"{links[b]} of {name}"
            joint_element, _ = add_joint(name, kind, (parent, child), place * anchor)
            if kind in ("prismatic", "revolute"):
                SubElement(joint_element, "axis", xyz=_format_numbers(_scale_unit_vector(axis)))
                SubElement(joint_element, "limit", _format_limit(mj_model, int(j)))
            if name in followers:
                leader, slope, offset = followers[name]
                factor = _format_numbers([slope])
                shift = _format_numbers([offset])
                SubElement(joint_element, "mimic", joint=leader, multiplier=factor, offset=shift)
            parent = child
            place = _build_pose(-mj_model.jnt_pos[j])
        _, link = add_joint(f"{links[b]} (fixed)", "fixed", (parent, links[b]), place)
        inertial = SubElement(link, "inertial")
        SubElement(inertial, "origin", xyz=_format_numbers(mj_model.body_ipos[b]))
        SubElement(inertial, "mass", value=_format_numbers([mj_model.body_mass[b]]))
        axes = _build_pose(mj_model.body_ipos[b], mj_model.body_iquat[b]).rotation
        inertia = (axes @ np.diag(mj_model.body_inertia[b]) @ axes.T)[np.triu_indices(3)]
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        SubElement(
            inertial,
            "inertia",
            {k: _format_numbers([x]) for k, x in zip(keys, inertia, strict=True)},
        )
    return ElementTree.tostring(robot, encoding="unicode")


def _scale_unit_vector(axis: Array) -> Array:
    """Return a multiple of a unit vector that Pinocchio normalises to the same bits, if any."""
    multiples = [scale * axis for scale in np.linspace(1.0, 2.0, 20)]
    return next(
        (
            multiple
            for multiple in multiples
            if np.array_equal(multiple / np.sqrt(multiple @ multiple), axis)
        ),
        axis,
    )


def _format_limit(mj_model: Any, j: int) -> dict[str, str]:
    lower, upper = (
        mj_model.jnt_range[j].tolist() if mj_model.jnt_limited[j] else (-UNLIMITED, UNLIMITED)
    )
    effort = np.abs(mj_model.jnt_actfrcrange[j]).max() if mj_model.jnt_actfrclimited[j] else 0.0
    numbers = {"lower": lower, "upper": upper, "effort": effort, "velocity": 0.0}
    return {key: _format_numbers([value]) for key, value in numbers.items()}


def _format_numbers(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


def _build_pose(position: Any, quaternion: Any = (1.0, 0.0, 0.0, 0.0)) -> Any:
    import pinocchio as pin  # slow to import

    return pin.SE3(pin.Quaternion(*quaternion).matrix(), np.array(position))


class _Equalities(NamedTuple):
    """Active equalities between joints and between bodies.

    Attributes
    ----------
    followers : q1 = slope q2 + offset as {q1: (q2, slope, offset)} [rad or m].
    held_positions : positions of joints that an equality holds [rad or m].
    loops : names of bodies that are tied to each other.
    couplings : joints that another equality couples, by what it is.
    """

    followers: dict[str, tuple[str, float, float]]
    held_positions: dict[str, float]
    loops: list[list[str]]
    couplings: dict[str, list[str]]


def _list_equalities(mj_model: Any) -> list[int]:
    """Return the numbers of the equalities that hold; a flag may disable all."""
    flags = import_engine().mjtDisableBit
    if mj_model.opt.disableflags & int(flags.mjDSBL_CONSTRAINT | flags.mjDSBL_EQUALITY):
        return []
    numbers: list[int] = np.flatnonzero(mj_model.eq_active0).tolist()
    return numbers


def _read_equalities(mj_model: Any, names: list[str]) -> _Equalities:
    kinds = import_engine().mjtEq
    equalities = _Equalities({}, {}, [], {})
    for k in _list_equalities(mj_model):
        kind = kinds(mj_model.eq_type[k])
        if kind in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD):
            bodies = _find_tied_bodies(mj_model, k)
            if np.all(mj_model.body_mocapid[bodies] < 0):
                equalities.loops.append([mj_model.body(body).name for body in bodies])
        elif kind == kinds.mjEQ_JOINT:
            _add_joint_equality(equalities, mj_model, k, names)
    _hold_followers(equalities)
    return equalities


def _hold_followers(equalities: _Equalities) -> None:
    """Hold the joints that follow one which is held."""
    followers = equalities.followers
    held_positions = equalities.held_positions
    while resting_names := [name for name in followers if followers[name][0] in held_positions]:
        for name in resting_names:
            leader, slope, offset = followers.pop(name)
            held_positions[name] = slope * held_positions[leader] + offset


def _find_tied_bodies(mj_model: Any, equality: int) -> list[int]:
    ends = [int(mj_model.eq_obj1id[equality]), int(mj_model.eq_obj2id[equality])]
    if mj_model.eq_objtype[equality] == import_engine().mjtObj.mjOBJ_SITE:
        return [int(mj_model.site_bodyid[site]) for site in ends]
    return ends


def _add_joint_equality(
    equalities: _Equalities, mj_model: Any, equality: int, names: list[str]
) -> None:
    """Add an equality of one joint, or of a joint and another: a line or another polynomial."""
    follower = int(mj_model.eq_obj1id[equality])
    leader = int(mj_model.eq_obj2id[equality])
    constant, slope, *higher = mj_model.eq_data[equality][:5].tolist()
    constant += float(mj_model.qpos0[mj_model.jnt_qposadr[follower]])
    name = names[follower]
    several = f"several equalities of '{name}'"
    if {name, several} & {*equalities.followers, *equalities.held_positions, *equalities.couplings}:
        previous_leader, *_ = equalities.followers.pop(name, (name,))
        equalities.held_positions.pop(name, None)
        leader_name = names[leader] if leader >= 0 else name
        coupled_names = equalities.couplings.setdefault(several, [])
        coupled_names += [name, previous_leader, leader_name]
    elif leader < 0:
        equalities.held_positions[name] = constant
    elif any(higher):
        cause = f"the polynomial of an equality of '{name}'"
        equalities.couplings[cause] = [names[leader], name]
    else:
        offset = constant - slope * float(mj_model.qpos0[mj_model.jnt_qposadr[leader]])
        equalities.followers[name] = names[leader], slope, offset


def _compute_torques(
    mj_model: Any, single_joints: dict[str, int], held_positions: dict[str, float]
) -> dict[str, Any]:
    """Return torques (8, n) of free single joints at random states, without passive forces."""
    mujoco = import_engine()
    q_addresses = mj_model.jnt_qposadr
    joints = [j for name, j in single_joints.items() if name not in held_positions]
    mj_model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    mj_model.opt.enableflags = 0
    mj_model.dof_damping[:] = 0.0  # sums with large ones lose digits
    data = mujoco.MjData(mj_model)
    torques = []
    for name, position in held_positions.items():
        data.qpos[q_addresses[single_joints[name]]] = position
    q, dq, ddq = np.random.default_rng(0).uniform(-1.0, 1.0, (3, _STATE_COUNT, len(joints)))
    q += mj_model.qpos0[q_addresses[joints]]
    dofs = mj_model.jnt_dofadr[joints]
    for state in zip(q, dq, ddq, strict=True):
        data.qpos[q_addresses[joints]], data.qvel[dofs], data.qacc[dofs] = state
        mujoco.mj_inverse(mj_model, data)
        torques.append((data.qfrc_inverse + data.qfrc_passive)[dofs].tolist())
    states = {"q": q.tolist(), "dq": dq.tolist(), "ddq": ddq.tolist()}
    return {
        "joints": [name for name in single_joints if name not in held_positions],
        **states,
        "held": held_positions,
        "torques": torques,
    }
