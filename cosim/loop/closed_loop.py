"""Closed loop of an arm as a system of FMUs."""

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, PlainSerializer, TypeAdapter

from cosim.systems.system import ComponentSpec, SystemSpec, Value
from hesr_model.errors import RuleError
from hesr_model.support.typed_files import Config


class StandIn(StrEnum):
    """Substitutes for a law: no torque, the rigid body only, or the true torque."""

    VELOCITY_ONLY = "(velocity command only)"
    BODY_ONLY = "(rigid body only)"
    ORACLE = "(oracle)"

    @property
    def words(self) -> str:
        """Name in texts."""
        if self is StandIn.ORACLE:
            return "true friction and rigid body"
        return self.value[1:-1]  # without brackets


Law = Annotated[StandIn | str, Field(union_mode="left_to_right")]

ARM = "Arm.fmu"

PerJoint = Annotated[tuple[float, ...], Field(min_length=1)]
_REST_TIME = 0.05  # [s] before the motion, longer than any preview
Compensation = Literal["none", "torque_error", "servo_inversion"]
_TITLES: Mapping[Compensation, str] = {
    "none": "velocity command only",
    "torque_error": "torque error (the paper’s scheme)",
    "servo_inversion": "servo inversion",
}
VelocitySource = Literal["desired", "measured", "filtered"]  # velocity input of the law


class Gains(Config):
    """Gains of the controller, one entry per joint."""

    Kp: PerJoint  # torque-error gain [rad/(s N.m)]
    Kd: PerJoint  # derivative gain [rad/(N.m)]
    decay: float  # lambda, decay with the desired velocity [s/rad]
    Kv: PerJoint  # assumed servo gain [N.m s/rad]
    Ki: PerJoint  # assumed integral servo gain [N.m/rad]
    latency: float  # assumed servo latency [s]


class Tracking(Config):
    """Settings of the tracking study; see `random_fourier` for the motions."""

    seeds: tuple[int, ...] = Field(min_length=1)  # one motion each
    duration: float = Field(gt=0)  # period of each motion [s]
    harmonics: int = Field(ge=2)
    peak_velocity: PerJoint
    offset: PerJoint
    gains: Gains
    Kx: float = Field(gt=0)  # outer position loop [1/s]
    sources: tuple[str, ...] = ()  # laws also run on measured and filtered velocity
    drift: float = Field(default=60.0, gt=0)  # length of a long run [s]


@dataclass(frozen=True, kw_only=True)
class Scheme:
    """Control scheme."""

    compensation: Compensation
    Kx: float = 0.0  # outer position loop [1/s]
    source: VelocitySource = "desired"
    friction_gain: float = 1.0
    change: str = ""  # difference from the identified loop

    @property
    def name(self) -> str:
        """Name in files."""
        name = ", ".join((self.compensation, *self._qualifiers))
        if self.change:
            name += f": {self.change}"
        return name

    @property
    def title(self) -> str:
        """Name in texts."""
        return ", ".join((_TITLES[self.compensation], *self._qualifiers))

    @property
    def _qualifiers(self) -> Iterator[str]:
        if self.Kx:
            yield f"Kx = {_format_number(self.Kx)}"
        if self.source != "desired":
            yield f"friction of {self.source} velocity"
        if self.friction_gain != 1.0:
            yield f"factor {_format_number(self.friction_gain)}"

    @classmethod
    def from_name(cls, name: str) -> Self:
        """Return the scheme of a `name`, or raise ValueError."""
        match = _NAME_PATTERN.fullmatch(name)
        if match is None:
            raise RuleError(f"'{name}' is not a scheme", code="loop.scheme")
        fields = {key: text for key, text in match.groupdict().items() if text}
        return TypeAdapter(cls).validate_python(fields)


_NAME_PATTERN = re.compile(
    r"(?P<compensation>\w+)(, Kx = (?P<Kx>[^,:]+))?(, friction of (?P<source>\w+) velocity)?"
    r"(, factor (?P<friction_gain>[^,:]+))?(: (?P<change>.+))?"
)


def _format_number(value: float) -> str:
    return repr(float(value)).removesuffix(".0")


NamedScheme = Annotated[
    Scheme,
    BeforeValidator(lambda value: Scheme.from_name(value) if isinstance(value, str) else value),
    PlainSerializer(lambda scheme: scheme.name, return_type=str),
]


@dataclass(frozen=True, kw_only=True)
class Fmus:
    """FMUs of a loop."""

    arm: Path
    trajectory: Path
    body: Path
    friction: Path
    controller: Path
    velocity: Path
    gravity: Path | None = None  # body of the gravity torque; `body` by default


@dataclass(frozen=True, kw_only=True)
class Setting:
    """One loop: FMUs, scheme and gains."""

    fmus: Fmus
    scheme: Scheme
    gains: Gains
    step: float  # [s]
    time_constant: float = 0.02  # velocity filter [s]
    arm: Mapping[str, Value] = field(default_factory=dict)  # further parameters
    noise: PerJoint = ()  # standard deviation of tau_meas per joint [N.m]


def preview(scheme: Scheme, gains: Gains, step_size: float) -> float:
    """Return the preview [s] of servo inversion: latency and half a step, as commands are held."""
    if scheme.compensation != "servo_inversion":
        return 0.0
    return gains.latency + 0.5 * step_size


def build_system(
    setting: Setting,
    *,
    duration: float,
    limits: Collection[tuple[float, float]] = (),
    motion: Mapping[str, Value] | None = None,
) -> SystemSpec:
    """Return the loop as a system; the arm steps first, with the commands of the last sample.

    A run of `duration` [s] ends early outside `limits` (n, 2) [rad].
    """
    connections = {
        "arm.dq_cmd": "controller.dq_cmd",
        "body.q": "trajectory.q_ahead",
        "body.dq": "trajectory.dq_ahead",
        "body.ddq": "trajectory.ddq_ahead",
        "friction.dq": "trajectory.dq_ahead",
        "friction.q": "trajectory.q_ahead",
        "friction.tau_load": "body.tau",
        "gravity.q": "arm.q",
        "controller.q_d": "trajectory.q",
        "controller.dq_d": "trajectory.dq_ahead",
        "controller.tau_rb": "body.tau",
        "controller.tau_f": "friction.tau",
        "controller.tau_g": "gravity.tau",
        "controller.tau_meas": "arm.tau_meas",
        "controller.q": "arm.q",
    }
    if setting.scheme.source != "desired":
        connections["friction.dq"] = "velocity.dq"
        connections["velocity.q"] = "arm.q"
    bounds = tuple((float(lower), float(upper)) for lower, upper in limits)
    return SystemSpec(
        name="closed_loop",
        step=setting.step,
        stop=duration,
        components=tuple(_list_components(setting, motion or {})),
        connections=connections,
        observe=("trajectory.q", "arm.q_true"),
        limits={"arm.q_true": bounds} if bounds else {},
    )


def _list_components(setting: Setting, motion: Mapping[str, Value]) -> Iterator[ComponentSpec]:
    """Yield the FMUs of a loop with their start values, in the order of their steps."""
    fmus = setting.fmus
    scheme = setting.scheme
    gains = setting.gains
    yield ComponentSpec(name="arm", fmu=fmus.arm, start=setting.arm)
    preview_time = preview(scheme, gains, setting.step)
    trajectory_start: dict[str, Value] = {
        "preview": preview_time,
        "rest_time": _REST_TIME,
        **motion,
    }
    yield ComponentSpec(name="trajectory", fmu=fmus.trajectory, start=trajectory_start)
    yield ComponentSpec(name="body", fmu=fmus.body, start={})
    if scheme.source != "desired":
        # A filter without a time constant passes the measured velocity on.
        filter_time = setting.time_constant if scheme.source == "filtered" else 0.0
        filter_start: dict[str, Value] = {"time_constant": filter_time}
        yield ComponentSpec(name="velocity", fmu=fmus.velocity, start=filter_start)
    yield ComponentSpec(name="friction", fmu=fmus.friction, start={})
    gravity_start: dict[str, Value] = {"dq": 0.0, "ddq": 0.0}  # the torque at rest
    yield ComponentSpec(name="gravity", fmu=fmus.gravity or fmus.body, start=gravity_start)
    control: dict[str, Value] = {
        "compensation": scheme.compensation,
        "friction_gain": scheme.friction_gain,
        "sample_time": setting.step,
        "lambda": gains.decay,
        "Kp": gains.Kp,
        "Kd": gains.Kd,
        "Kv": gains.Kv,
        "Ki": gains.Ki,
        "Kx": scheme.Kx,
    }
    yield ComponentSpec(name="controller", fmu=fmus.controller, start=control)
