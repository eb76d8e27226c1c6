"""Model files as MuJoCo compiles them, and its inverse dynamics to check robots against."""

import json
import re
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from hesr_model.errors import ConfigError, RobotError
from hesr_model.robots.urdf import UNLIMITED, read_urdf
from hesr_model.support.arrays import Array
from hesr_model.support.cache import kept
from hesr_model.support.text import on_one_line

_MOST_PARTS = 15_000  # per MJCF; compile time grows with the square, to 7 s here
_LEAST = 1e-9  # mass and inertia of the links of a URDF for MuJoCo [kg, kg.m2]
_STATES = 8  # random states of the check
Compiled = dict[str, Any]  # a compiled file as JSON; see `_described`


def engine() -> Any:
    """Import MuJoCo without its log, a file in the current folder."""
    import mujoco  # slow to import

    config = mujoco.MjLogConfig.get()
    config.logto_file = config.logto_console = False
    config.set()
    return mujoco


def compiled(path: Path) -> Any:
    """Return the MuJoCo model of an MJCF or URDF; ConfigError if it is missing or invalid."""
    if not path.is_file():
        raise ConfigError(f"{path}: no such model file.")
    if is_urdf(path):
        return compiled_spec(path)
    _require_an_end(path)
    with _refused(path):
        return engine().MjModel.from_xml_path(str(path))


def compiled_spec(path: Path, change: Callable[[Any], None] = lambda _: None) -> Any:
    """Return the changed MuJoCo model of a file; a URDF has no appearance and no contacts."""
    with _refused(path), warnings.catch_warnings(action="ignore"):  # deprecated attributes
        if is_urdf(path):
            spec = engine().MjSpec.from_string(read_urdf(path, path.read_bytes()).text)
            spec.compiler.balanceinertia = True  # MuJoCo refuses what rounding makes impossible
            spec.compiler.boundmass = spec.compiler.boundinertia = _LEAST
        else:
            spec = engine().MjSpec.from_file(str(path))
        change(spec)
        return spec.compile()


def is_urdf(path: Path) -> bool:
    """Return whether a name is that of a URDF."""
    return path.suffix.lower() == ".urdf"


@contextmanager
def _refused(path: Path) -> Iterator[None]:
    try:
        yield
    except (ValueError, RuntimeError) as error:  # RuntimeError: out of memory
        kind = "a URDF" if is_urdf(path) else "an MJCF"
        said = f"{path}: cannot be compiled as {kind} ({on_one_line(error)})."
        raise ConfigError(said) from error


def compiled_robot(path: Path) -> Compiled:
    """Return an MJCF without its appearance; RobotError if MuJoCo cannot compile it."""
    try:
        _require_an_end(path)
        found = _kept(_content(path), lambda: _strip_mjcf(path))
    except ConfigError as error:
        raise RobotError(str(error)) from error
    if "refusal" in found:
        raise RobotError(f"{path}: cannot be compiled as an MJCF ({found['refusal']}).")
    return found


def torques_of_urdf(text: str) -> Compiled | None:
    """Return MuJoCo's torques of a URDF without meshes, None if MuJoCo cannot compile it."""

    def read() -> Any:
        spec = engine().MjSpec.from_string(text)
        # MuJoCo splits a planar joint into three, which the file does not name: they stay at rest.
        for body in spec.bodies:
            if len(body.joints) > 1:
                for joint in list(body.joints):
                    spec.delete(joint)
        return spec

    return _kept([text], read).get("check")


def _kept(content: Iterable[str | bytes], read: Callable[[], Any]) -> Compiled:
    def make() -> bytes:
        try:
            with warnings.catch_warnings(action="ignore"):  # deprecated attributes
                spec = read()
                spec.compiler.fusestatic = False
                found = _described(spec.compile())
        except (ValueError, RuntimeError) as error:
            found = {"refusal": on_one_line(error)}
        return json.dumps(found).encode()

    key: list[str | bytes] = [Path(__file__).read_bytes(), version("mujoco"), *content]
    found: Compiled = json.loads(kept("robots", key, make))
    return found


def _content(path: Path) -> Iterator[str | bytes]:
    yield (data := with_includes(path))
    root = _root(path, data)
    for _, file in _files(root, path.parent) if root is not None else ():
        yield f"{file} {file.stat().st_size} {file.stat().st_mtime_ns}"


def _root(path: Path, data: bytes) -> Element | None:
    try:
        return ElementTree.fromstring(data)
    except ElementTree.ParseError:
        return None
    except (LookupError, ValueError) as error:  # an encoding, which MuJoCo ignores
        raise ConfigError(f"{path}: cannot be parsed as an MJCF ({on_one_line(error)}).") from error


def with_includes(path: Path) -> bytes:
    """Return an MJCF with the content of the files that it includes."""
    root = _root(path, data := path.read_bytes())
    if root is None or root.find(".//include") is None:
        return data
    _include(root, path.parent, {path})
    return ElementTree.tostring(root)


def _include(element: Element, base: Path, seen: set[Path]) -> None:
    for k, child in reversed(list(enumerate(element))):
        file = base / child.get("file", "")
        inner = child
        if child.tag == "include" and file.is_file() and file not in seen:
            seen.add(file)  # MuJoCo refuses a second time
            found = _root(file, file.read_bytes())
            inner = child if found is None else found
        _include(inner, base, seen)
        if inner is not child:
            element[k : k + 1] = list(inner)


def _files(root: Element, base: Path) -> Iterator[tuple[Element, Path]]:
    places = ("assetdir", "meshdir", "texturedir")
    folders = {e.get(kind, "") for e in root.iter("compiler") for kind in places}
    for element in root.iter():
        for folder in sorted({"", *folders}) if (name := element.get("file")) else ():
            file = base / folder / str(name)
            if file.exists():
                yield element, file


def _require_an_end(path: Path) -> None:
    """Reject endless copies and special files: MuJoCo cannot be interrupted."""
    root = _root(path, path.read_bytes())
    if root is None:
        return
    parts = _parts(root)
    if parts > _MOST_PARTS:
        raise ConfigError(f"{path}: has {parts} elements; at most {_MOST_PARTS} can be compiled.")
    for element, file in _files(root, path.parent):
        if not file.is_file():
            name = element.get("file")
            raise ConfigError(f"{path}: names the file '{name}', which is not a regular file.")


def _parts(element: Element) -> int:
    count = element.get("count", "") if element.tag == "replicate" else ""
    copies = int(count) if re.fullmatch(r"\d{1,18}", count) else 1
    return 1 + copies * sum(map(_parts, element))


def _strip_mjcf(path: Path) -> Any:
    """Read what has effects on rigid-body torques, with meshes if inertias need them."""
    mujoco = engine()
    spec = mujoco.MjSpec.from_file(str(path))
    at_joint = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    parts = [*spec.sensors, *spec.keys, *spec.pairs, *spec.excludes, *spec.tuples, *spec.skins]
    parts += [a for a in spec.actuators if a.trntype not in at_joint]
    of_joints = (mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)
    parts += [e for e in spec.equalities if e.type not in of_joints]
    for part in [*parts, *spec.tendons]:
        spec.delete(part)
    meshes = set()
    bodies = _find_shaped_bodies(spec)
    for site in spec.sites:
        site.material = ""
    for geom in spec.geoms:
        geom.material = ""
        if geom.parent.name not in bodies:
            spec.delete(geom)
        elif geom.meshname:
            meshes.add(geom.meshname)
            _require_mesh(spec, geom, path)
    unused = [mesh for mesh in spec.meshes if mesh.name not in meshes]
    for asset in (*unused, *spec.materials, *spec.textures, *spec.hfields):
        spec.delete(asset)
    return spec


def _find_shaped_bodies(spec: Any) -> set[str]:
    by_geoms = spec.compiler.inertiafromgeom
    total = spec.compiler.settotalmass > 0.0
    kinds = engine().mjtInertiaFromGeom
    moving: set[str] = set()
    for number, body in enumerate(spec.bodies[1:], start=1):
        body.name = body.name or f"body{number}"
        if body.parent.name in moving or list(body.joints) or total:
            moving.add(body.name)
    if by_geoms == kinds.mjINERTIAFROMGEOM_FALSE:
        return set()
    always = by_geoms == kinds.mjINERTIAFROMGEOM_TRUE
    return {b.name for b in spec.bodies if b.name in moving and (always or not b.explicitinertial)}


def _require_mesh(spec: Any, geom: Any, path: Path) -> None:
    mesh = spec.mesh(geom.meshname)
    folder = Path(spec.modelfiledir or path.parent, spec.meshdir or "")
    if mesh is not None and mesh.file and not (folder / mesh.file).is_file():
        raise RobotError(
            f"{path}: the inertia of body '{geom.parent.name}' comes from the mesh '{mesh.file}', "
            f"which is not in {folder}; put it there, or give the body an <inertial>."
        )


def _described(model: Any) -> Compiled:
    """Return the tree as a URDF, what a URDF cannot state, and torques to compare."""
    names = [model.joint(j).name or f"joint{j}" for j in range(model.njnt)]
    if model.opt.disableflags & int(engine().mjtDisableBit.mjDSBL_GRAVITY):
        model.opt.gravity[:] = 0.0
    followers, held, loops = _equalities(model, names)
    armature = model.dof_armature[model.jnt_dofadr]
    for j in np.flatnonzero(model.jnt_actuatorid >= 0):
        motor = model.jnt_actuatorid[j]
        armature[j] += model.actuator_gear[motor, 0] ** 2 * model.actuator_armature[motor]
    single = {name: j for j, name in enumerate(names) if model.jnt_type[j] >= 2}  # slide, hinge
    return {
        "urdf": _urdf(model, names, followers, held),
        "gravity": model.opt.gravity.tolist(),
        "rest": {n: float(model.qpos0[model.jnt_qposadr[j]]) for n, j in single.items()} | held,
        "armature": {name: float(armature[j]) for name, j in single.items()},
        "springs": {
            name: (float(k), -float(k * model.qpos_spring[model.jnt_qposadr[j]]))
            for name, j in single.items()
            if (k := model.jnt_stiffness[j]) > 0.0 and name not in held
        },
        "loops": loops,
        "check": _torques(model, single, held),
    }


def _urdf(model: Any, names: list[str], followers: dict[str, Any], held: dict[str, float]) -> str:
    """Write a compiled model as a URDF with the same positions; every joint carries a link."""
    import pinocchio as pin  # slow to import

    robot = Element("robot", name="mjcf")
    links = [model.body(b).name or f"body{b}" for b in range(model.nbody)]
    SubElement(robot, "link", name=links[0])

    def joint(name: str, kind: str, ends: tuple[str, str], place: Any) -> tuple[Element, Element]:
        own = SubElement(robot, "joint", name=name, type=kind)
        SubElement(own, "parent", link=ends[0])
        SubElement(own, "child", link=ends[1])
        rpy = pin.rpy.matrixToRpy(place.rotation)
        SubElement(own, "origin", xyz=_words(place.translation), rpy=_words(rpy))
        return own, SubElement(robot, "link", name=ends[1])

    for b in range(1, model.nbody):
        parent = links[model.body_parentid[b]]
        place = _pose(model.body_pos[b], model.body_quat[b])
        for j in np.flatnonzero(model.jnt_bodyid == b):
            name = names[j]
            anchor = _pose(model.jnt_pos[j])
            axis = model.jnt_axis[j]
            kind = ("floating", "floating", "prismatic", "revolute")[model.jnt_type[j]]
            back = held.get(name, 0.0) - float(model.qpos0[model.jnt_qposadr[j]])
            if kind == "prismatic":
                anchor = anchor * pin.SE3(np.eye(3), back * axis)
            elif kind == "revolute":
                anchor = anchor * pin.SE3(pin.exp3(back * axis), np.zeros(3))
            kind, child = "fixed" if name in held else kind, f"{links[b]} of {name}"
            own, _ = joint(name, kind, (parent, child), place * anchor)
            if kind in ("prismatic", "revolute"):
                SubElement(own, "axis", xyz=_words(_scale_unit_vector(axis)))
                SubElement(own, "limit", _limit(model, int(j)))
            if name in followers:
                leader, slope, offset = followers[name]
                factor = _words([slope])
                shift = _words([offset])
                SubElement(own, "mimic", joint=leader, multiplier=factor, offset=shift)
            parent = child
            place = _pose(-model.jnt_pos[j])
        _, link = joint(f"{links[b]} (fixed)", "fixed", (parent, links[b]), place)
        inertial = SubElement(link, "inertial")
        SubElement(inertial, "origin", xyz=_words(model.body_ipos[b]))
        SubElement(inertial, "mass", value=_words([model.body_mass[b]]))
        axes = _pose(model.body_ipos[b], model.body_iquat[b]).rotation
        about = (axes @ np.diag(model.body_inertia[b]) @ axes.T)[np.triu_indices(3)]
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        SubElement(inertial, "inertia", {k: _words([x]) for k, x in zip(keys, about, strict=True)})
    return ElementTree.tostring(robot, encoding="unicode")


def _scale_unit_vector(axis: Array) -> Array:
    """Return a multiple of a unit vector that Pinocchio normalises to the same bits, if any."""
    scaled = [scale * axis for scale in np.linspace(1.0, 2.0, 20)]
    return next((one for one in scaled if np.array_equal(one / np.sqrt(one @ one), axis)), axis)


def _limit(model: Any, j: int) -> dict[str, str]:
    low, high = model.jnt_range[j].tolist() if model.jnt_limited[j] else (-UNLIMITED, UNLIMITED)
    effort = np.abs(model.jnt_actfrcrange[j]).max() if model.jnt_actfrclimited[j] else 0.0
    numbers = {"lower": low, "upper": high, "effort": effort, "velocity": 0.0}
    return {key: _words([value]) for key, value in numbers.items()}


def _words(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


def _pose(position: Any, quaternion: Any = (1.0, 0.0, 0.0, 0.0)) -> Any:
    import pinocchio as pin  # slow to import

    return pin.SE3(pin.Quaternion(*quaternion).matrix(), np.array(position))


def _equalities(
    model: Any, names: list[str]
) -> tuple[dict[str, tuple[str, float, float]], dict[str, float], list[list[str]]]:
    """Return q1 = slope q2 + offset as {q1: (q2, slope, offset)}, constant joints, and loops."""
    kinds = engine().mjtEq
    followers = {}
    fixed = {}
    loops = []
    for k in np.flatnonzero(model.eq_active0):
        own = int(model.eq_obj1id[k])
        leader = int(model.eq_obj2id[k])
        if kinds(model.eq_type[k]) in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD):
            if model.eq_objtype[k] == engine().mjtObj.mjOBJ_SITE:
                own, leader = int(model.site_bodyid[own]), int(model.site_bodyid[leader])
            if np.all(model.body_mocapid[[own, leader]] < 0):
                loops.append([model.body(own).name, model.body(leader).name])
        elif model.eq_type[k] == kinds.mjEQ_JOINT:
            constant, slope, *higher = model.eq_data[k][:5].tolist()
            constant += float(model.qpos0[model.jnt_qposadr[own]])
            if leader < 0:
                fixed[names[own]] = constant
                continue
            if any(higher):
                raise ValueError(
                    f"joint '{names[own]}' follows '{names[leader]}' by a polynomial; only linear "
                    "equalities can be used"
                )
            constant -= slope * float(model.qpos0[model.jnt_qposadr[leader]])
            followers[names[own]] = names[leader], slope, constant
    return followers, fixed, loops


def _torques(model: Any, single: dict[str, int], held: dict[str, float]) -> dict[str, Any]:
    """Return torques (8, n) of free single joints at random states, without passive forces."""
    mujoco = engine()
    place = model.jnt_qposadr
    joints = [j for name, j in single.items() if name not in held]
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    model.opt.enableflags = 0
    model.dof_damping[:] = 0.0  # sums with large ones lose digits
    data = mujoco.MjData(model)
    torques = []
    for name, position in held.items():
        data.qpos[place[single[name]]] = position
    q, dq, ddq = np.random.default_rng(0).uniform(-1.0, 1.0, (3, _STATES, len(joints)))
    q += model.qpos0[place[joints]]
    dofs = model.jnt_dofadr[joints]
    for state in zip(q, dq, ddq, strict=True):
        data.qpos[place[joints]], data.qvel[dofs], data.qacc[dofs] = state
        mujoco.mj_inverse(model, data)
        torques.append((data.qfrc_inverse + data.qfrc_passive)[dofs].tolist())
    states = {"q": q.tolist(), "dq": dq.tolist(), "ddq": ddq.tolist()}
    return {"joints": [name for name in single if name not in held], **states, "torques": torques}
