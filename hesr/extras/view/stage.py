"""The scene: shapes of arms side by side, each with its commanded pose as a ghost."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cosim.loop.closed_loop import ARM, StandIn
from cosim.loop.traces import TRACES, Trace, read_traces
from cosim.report.tables.table import title
from fmu_src.run.archive import Archive
from hesr_model.errors import ArgumentError, ArtifactError, ConfigError, RobotError
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.support.arrays import Array

_SCHEME = "servo_inversion"  # scheme with the largest effect of models
_MODEL = "resources/model.xml"
_MAX_ARMS = 4  # arms side by side


@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """Options of `show_arm`."""

    laws: Sequence[str] = ()
    scheme: str | None = None
    magnify: float = 1.0
    speed: float = 1.0

    def __post_init__(self) -> None:
        for name, value in (("magnify", self.magnify), ("speed", self.speed)):
            if not (np.isfinite(value) and value > 0):
                raise ConfigError(f"--{name} is {value:g}; it must be positive.")


@dataclass(frozen=True, kw_only=True)
class Selection:
    """Runs to show, by title of the law."""

    mjcf: str
    joints: Sequence[str]
    scheme: str
    runs: Mapping[str, Trace]


def choose(folder: Path, options: ViewOptions) -> Selection:
    """Read the runs to show."""
    if not folder.is_dir():
        raise ArtifactError(f"{folder}: no such folder; give a result of 'hesr run'.")
    traces_by_scheme: dict[str, dict[str, Trace]] = {}
    for (trace_scheme, law_name), trace in read_traces(folder / TRACES).items():
        traces_by_scheme.setdefault(trace_scheme.name, {})[law_name] = trace
    scheme = options.scheme or _choose_scheme(list(traces_by_scheme))
    if scheme not in traces_by_scheme:
        raise ArgumentError(
            f"'scheme' is '{scheme}'; there are {_quote_names(traces_by_scheme)} in {folder}."
        )
    scheme_traces = traces_by_scheme[scheme]
    laws = list(options.laws) or _choose_laws(scheme_traces)
    for law_name in laws:
        if law_name not in scheme_traces:
            raise ArgumentError(
                f"'law' is '{law_name}'; with scheme '{scheme}' there are "
                f"{_quote_names(scheme_traces)} in {folder}."
            )
    if len(laws) > _MAX_ARMS:
        raise ArgumentError(
            f"'law' is given {len(laws)} times; at most {_MAX_ARMS} fit side by side."
        )
    return Selection(
        mjcf=_read_mjcf(folder / "fmus" / ARM),
        joints=RigidBody.read(folder / "rigid_body.json").joints,
        scheme=scheme,
        runs={title(law_name): scheme_traces[law_name] for law_name in laws},
    )


def _choose_scheme(schemes: Sequence[str]) -> str:
    if _SCHEME in schemes:
        return _SCHEME
    return schemes[-1]


def _choose_laws(runs: Mapping[str, Trace]) -> list[str]:
    """Return the body alone and the law that tracks best, or the first run."""
    errors = {
        law_name: float(np.sqrt(np.mean((trace.q - trace.q_d) ** 2)))
        for law_name, trace in runs.items()
        if law_name not in set(StandIn)
    }
    best_law = min(errors, key=lambda law_name: errors[law_name], default=None)
    law_names = [law_name for law_name in (StandIn.BODY_ONLY, best_law) if law_name in runs]
    return [law_name for law_name in law_names if law_name is not None] or list(runs)[:1]


def _read_mjcf(fmu: Path) -> str:
    if not fmu.is_file():
        raise ArtifactError(f"{fmu}: no such file; rerun 'hesr run'.")
    content = b""
    with Archive(fmu) as archive:
        if _MODEL in archive.names:
            content = archive.read(_MODEL)
    with suppress(UnicodeDecodeError):
        text = content.decode("utf-8")
        if text:
            return text
    raise ArtifactError(f"{fmu}: holds no {_MODEL} to show.")


def _quote_names(names: Sequence[str] | Mapping[str, object]) -> str:
    return ", ".join(f"'{name}'" for name in names)


Colour = tuple[float, float, float, float]

_LINK_RADIUS_RATIO = 0.045  # radius of links over the reach of the arm
_JOINT_RADIUS_RATIO = 1.35  # radius of joints over that of links
_END_RADIUS_RATIO = 1.1  # radius of the ball at the end over that of links
_MIN_LINK_SHARE = 1e-3  # over the reach: shorter links are not drawn


@dataclass(frozen=True, kw_only=True)
class Paint:
    """Colours of an arm, and a factor on thickness."""

    links: Colour
    joints: Colour
    end: Colour
    thick: float = 1.0


def build_arm(mjcf: str, joints: Sequence[str], *, paint: Paint) -> Any:
    """Return an arm as an MjSpec of bodies, joints and shapes, or else capsules between joints."""
    try:
        spec = mujoco.MjSpec.from_string(mjcf)
        _strip_spec(spec)
        for name in joints:
            if spec.joint(name) is None:
                raise RobotError(f"the arm's model has no joint '{name}', so it cannot be shown.")
        mj_model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise RobotError(f"the arm's model cannot be shown ({reason}).") from error
    if spec.geoms:
        for geom in spec.geoms:
            geom.rgba = paint.links
            geom.material = ""
    else:
        _draw_capsules(spec, compute_reach(mj_model), paint)
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    return spec


def compute_reach(mj_model: mujoco.MjModel) -> float:
    """Return the sum of the link lengths [m]."""
    return float(np.linalg.norm(mj_model.body_pos, axis=1).sum()) or 1.0


def _strip_spec(spec: Any) -> None:
    file_types = (
        mujoco.mjtGeom.mjGEOM_MESH,
        mujoco.mjtGeom.mjGEOM_HFIELD,
        mujoco.mjtGeom.mjGEOM_SDF,
    )
    elements = (
        *(spec.sensors, spec.actuators, spec.tendons, spec.equalities, spec.pairs, spec.excludes),
        *(spec.keys, spec.cameras, spec.lights, spec.skins, spec.flexes),
        *([geom for geom in spec.geoms if geom.type in file_types], spec.meshes, spec.hfields),
    )
    for group in elements:
        for element in list(group):
            spec.delete(element)
    # Nothing is simulated; all options must be those of the scene.
    default_options = mujoco.MjSpec().option
    for name in (name for name in dir(default_options) if not name.startswith("_")):
        setattr(spec.option, name, getattr(default_options, name))


def _draw_capsules(spec: Any, reach: float, paint: Paint) -> None:
    radius = _LINK_RADIUS_RATIO * reach * paint.thick
    geom_types = mujoco.mjtGeom
    for body in spec.worldbody.find_all("body"):
        add_geom = partial(body.add_geom, mass=0.0)
        link_options = {"size": [radius, 0.0, 0.0], "rgba": paint.links}
        for child in body.bodies:
            if np.linalg.norm(child.pos) > _MIN_LINK_SHARE * reach:
                add_geom(
                    type=geom_types.mjGEOM_CAPSULE,
                    fromto=[0.0, 0.0, 0.0, *child.pos],
                    **link_options,
                )
        for joint in body.joints:
            # A drum around the axis of a hinge, a longer box along that of a slide.
            if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
                shape = geom_types.mjGEOM_CYLINDER
                half_length = 1.2
                width = radius * _JOINT_RADIUS_RATIO
            else:
                shape = geom_types.mjGEOM_BOX
                half_length = 2.0
                width = radius * 0.8
            half_axis = half_length * radius * np.array(joint.axis)
            add_geom(
                type=shape,
                fromto=[*(joint.pos - half_axis), *(joint.pos + half_axis)],
                size=[width, radius * 0.8, 0.0],
                rgba=paint.joints,
            )
        if not body.bodies:
            add_geom(
                type=geom_types.mjGEOM_SPHERE,
                size=[_END_RADIUS_RATIO * radius, 0.0, 0.0],
                rgba=paint.end,
            )


WIDTH = 1280  # [pixels]
HEIGHT = 720  # [pixels]

_BLUE: Colour = (0.0, 0.45, 0.70, 0.3)
_ORANGE: Colour = (0.84, 0.37, 0.0, 1.0)
_RUST: Colour = (0.50, 0.15, 0.0, 1.0)  # lines are lit brighter: this one looks orange
_TEXT: Colour = (0.1, 0.1, 0.12, 1.0)
_ARM = Paint(links=(0.78, 0.80, 0.83, 1.0), joints=(0.25, 0.27, 0.31, 1.0), end=_ORANGE)
# A shell around the arm.
_GHOST = Paint(
    links=(*_BLUE[:3], 0.14), joints=(*_BLUE[:3], 0.14), end=(*_BLUE[:3], 0.14), thick=1.12
)
_TRAIL_DURATION = 2.5  # [s] length of the trail of the arm's end
_SEGMENT_COUNT = 60  # segments of a trail
_LINE_SPACING = 0.09  # [m] of text
_TEXT_OFFSET = 0.3  # [m] of text to the left of the arm
_FOVY = 40.0  # [degrees]
_ROOM = f"""<mujoco>
  <statistic extent="3" center="0 0 0.5"/>
  <visual>
    <global offwidth="{WIDTH}" offheight="{HEIGHT}" fovy="{_FOVY}"/>
    <headlight ambient="0.35 0.35 0.35" diffuse="0.35 0.35 0.35" specular="0.1 0.1 0.1"/>
    <quality shadowsize="2048" offsamples="2"/>
    <map znear="0.01"/>
  </visual>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="0.97 0.98 1" rgb2="0.8 0.85 0.9"
      width="256" height="1536"/>
    <texture name="tiles" type="2d" builtin="checker" mark="edge" rgb1="0.9 0.91 0.92"
      rgb2="0.86 0.87 0.88" markrgb="0.8 0.81 0.82" width="256" height="256"/>
    <material name="floor" texture="tiles" texrepeat="2 2" texuniform="true" reflectance="0.05"/>
  </asset>
  <worldbody>
    <geom type="plane" size="200 200 0.1" material="floor"/>
    <light type="directional" pos="0.5 0.4 3" dir="-0.2 -0.15 -1" diffuse="0.55 0.55 0.55"
      specular="0.15 0.15 0.15" castshadow="true"/>
  </worldbody>
</mujoco>"""


@dataclass(frozen=True, kw_only=True, eq=False)
class _PlacedArm:
    """An arm with its ghost; positions of joints in qpos."""

    label: tuple[str, str]
    t: Array
    q_d: Array
    q: Array
    ghost: NDArray[np.intp]
    solid: NDArray[np.intp]
    ends: tuple[int, int]
    label_position: Array


class Stage:
    """A MuJoCo model of all arms, and their motion."""

    def __init__(self, selection: Selection, options: ViewOptions) -> None:
        self._magnify = options.magnify
        self._scheme = selection.scheme
        self.duration = max(float(run.t[-1]) for run in selection.runs.values())
        lower, upper = _find_space(selection)
        spacing = (upper[1] - lower[1]) + 0.25 * float(np.linalg.norm(upper - lower))
        arm_positions = spacing * (np.arange(len(selection.runs)) - 0.5 * (len(selection.runs) - 1))
        spec = mujoco.MjSpec.from_string(_ROOM)
        for k, position in enumerate(arm_positions):
            frame = spec.worldbody.add_frame(pos=[0.0, float(position), 0.0])
            solid = build_arm(selection.mjcf, selection.joints, paint=_ARM)
            ghost = build_arm(selection.mjcf, selection.joints, paint=_GHOST)
            spec.attach(solid, prefix=f"actual{k}/", frame=frame)
            spec.attach(ghost, prefix=f"commanded{k}/", frame=frame)
        self.mj_model = spec.compile()
        self.mj_data = mujoco.MjData(self.mj_model)
        self._arms = [
            self._place_arm(k, arm_positions[k], label, run, selection.joints, upper[2])
            for k, (label, run) in enumerate(selection.runs.items())
        ]
        self._paths = [self._compute_paths(placed) for placed in self._arms]
        self.camera = _build_camera(lower, upper, arm_positions)

    def _place_arm(
        self, k: int, position: float, label: str, run: Trace, joints: Sequence[str], top: float
    ) -> _PlacedArm:
        def addresses(prefix: str) -> NDArray[np.intp]:
            qpos_addresses = [self.mj_model.joint(f"{prefix}/{name}").qposadr[0] for name in joints]
            return np.array(qpos_addresses, dtype=np.intp)

        deviation = run.q - run.q_d
        errors = ", ".join(f"{1e3 * error:.2g}" for error in np.sqrt(np.mean(deviation**2, axis=0)))
        ends = [
            _find_end(self.mj_model, f"{prefix}{k}/", joints[-1])
            for prefix in ("commanded", "actual")
        ]
        return _PlacedArm(
            label=(label, f"{errors} mrad"),
            t=run.t,
            q_d=run.q_d,
            q=run.q_d + self._magnify * deviation,
            ghost=addresses(f"commanded{k}"),
            solid=addresses(f"actual{k}"),
            ends=(ends[0], ends[1]),
            label_position=np.array([0.0, position - _TEXT_OFFSET, top + 2 * _LINE_SPACING]),
        )

    def _compute_paths(self, arm: _PlacedArm) -> Array:
        """Return the paths of both ends (N, 2, 3) [m]."""
        path = np.empty((len(arm.t), 2, 3))
        for k in range(len(arm.t)):
            self.mj_data.qpos[arm.ghost], self.mj_data.qpos[arm.solid] = arm.q_d[k], arm.q[k]
            mujoco.mj_kinematics(self.mj_model, self.mj_data)
            path[k] = self.mj_data.xpos[list(arm.ends)]
        return path

    def set(self, t: float) -> None:
        """Set all poses at a time [s]."""
        for arm in self._arms:
            k = _find_row(arm.t, t)
            self.mj_data.qpos[arm.ghost], self.mj_data.qpos[arm.solid] = arm.q_d[k], arm.q[k]
        mujoco.mj_kinematics(self.mj_model, self.mj_data)
        mujoco.mj_camlight(self.mj_model, self.mj_data)

    def annotate(self, scene: mujoco.MjvScene, t: float) -> None:
        """Add trails and labels to a scene."""
        for arm, path in zip(self._arms, self._paths, strict=True):
            end_rows = _find_row(arm.t, t - _TRAIL_DURATION), _find_row(arm.t, t)
            rows = np.unique(np.linspace(*end_rows, _SEGMENT_COUNT).astype(int))
            for side, pixels, colour in ((0, 9.0, _BLUE), (1, 3.0, _RUST)):
                for start_row, end_row in pairwise(rows):
                    _add_line(scene, path[start_row, side], path[end_row, side], pixels, colour)
            for line, text in enumerate(arm.label):
                line_position = arm.label_position - np.array([0.0, 0.0, _LINE_SPACING * line])
                geom = _add_to_scene(scene, mujoco.mjtGeom.mjGEOM_LABEL, 0.01, line_position, _TEXT)
                if geom:
                    geom.label = text[:99]  # MuJoCo's limit is 100 characters

    def legend(self, t: float) -> tuple[str, str]:
        """Return the two-column legend at time t [s]."""
        actual_text = "actual"
        if self._magnify != 1.0:
            actual_text += f", deviations x {self._magnify:g}"
        legend = {
            "blue": "commanded",
            "orange": actual_text,
            "mrad": "RMSE by joint",
            f"{t:4.1f} s": self._scheme,
        }
        return "\n".join(legend), "\n".join(legend.values())


def _find_row(t: Array, time: float) -> int:
    return int(np.clip(np.searchsorted(t, time + 1e-9) - 1, 0, len(t) - 1))


def _find_end(mj_model: mujoco.MjModel, prefix: str, joint: str) -> int:
    joint_body = int(mj_model.joint(f"{prefix}{joint}").bodyid[0])
    depths = {joint_body: 0}
    for body in range(joint_body + 1, mj_model.nbody):  # parents come first
        parent = int(mj_model.body_parentid[body])
        if parent in depths:
            depths[body] = depths[parent] + 1
    return max(depths, key=lambda body: depths[body])


def _find_space(selection: Selection) -> tuple[Array, Array]:
    mj_model = build_arm(selection.mjcf, selection.joints, paint=_ARM).compile()
    mj_data = mujoco.MjData(mj_model)
    addresses = [mj_model.joint(name).qposadr[0] for name in selection.joints]
    margin = 0.06 * compute_reach(mj_model)
    points = [np.zeros(3)]
    for run in selection.runs.values():
        for q in run.q_d[:: max(len(run.q_d) // 200, 1)]:
            mj_data.qpos[addresses] = q
            mujoco.mj_kinematics(mj_model, mj_data)
            points += list(mj_data.xpos[1:])
    return np.min(points, axis=0) - margin, np.max(points, axis=0) + margin


def _build_camera(lower: Array, upper: Array, arm_positions: Array) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    text_height = 3 * _LINE_SPACING
    camera.lookat = [
        0.5 * (lower[0] + upper[0]),
        0.5 * (lower[1] + upper[1]),
        0.5 * (upper[2] + text_height),
    ]
    camera.azimuth = 170.0
    camera.elevation = -10.0
    width = float(arm_positions[-1] - arm_positions[0] + upper[1] - lower[1])
    height = upper[2] + text_height
    half_angle = np.tan(np.radians(_FOVY) / 2)
    camera.distance = float(max(height, width * HEIGHT / WIDTH) / (2 * half_angle) + 0.6 * upper[0])
    return camera


def _add_line(
    scene: mujoco.MjvScene, start: Array, end: Array, pixels: float, colour: Colour
) -> None:
    kind = mujoco.mjtGeom.mjGEOM_LINE  # four times as fast as tubes in software rendering
    geom = _add_to_scene(scene, kind, 0.0, np.zeros(3), colour)
    if geom:
        mujoco.mjv_connector(geom, kind, pixels, start, end)


def _add_to_scene(
    scene: mujoco.MjvScene, kind: mujoco.mjtGeom, size: float, position: Array, colour: Colour
) -> Any:
    if scene.ngeom == scene.maxgeom:
        return None
    geom = scene.geoms[scene.ngeom]
    rgba = np.array(colour, dtype=np.float32)
    mujoco.mjv_initGeom(geom, kind, np.full(3, size), position, np.eye(3).ravel(), rgba)
    scene.ngeom += 1
    return geom
