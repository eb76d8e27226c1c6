"""The closed loop of an arm as a system of FMUs: trajectory, models, controller, arm."""

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, PlainSerializer, TypeAdapter

from cosim.systems.system import ComponentSpec, SystemSpec, Value
from hesr_model.support.config import Config


class StandIn(StrEnum):
    """Substitutes for a law: no torque, the rigid body only, or the true torque."""

    VELOCITY_ONLY = "(velocity command only)"
    BODY_ONLY = "(rigid body only)"
    ORACLE = "(oracle)"

    @property
    def words(self) -> str:
        """Name in texts."""
        return "true friction and rigid body" if self is StandIn.ORACLE else self.value[1:-1]


Law = Annotated[StandIn | str, Field(union_mode="left_to_right")]
"""Name of a law, or its substitute."""

ARM = "Arm.fmu"
"""File name of the arm's FMU."""

PerJoint = Annotated[tuple[float, ...], Field(min_length=1)]
_REST = 0.05  # [s] rest before the motion, longer than any preview
Compensation = Literal["none", "torque_error", "servo_inversion"]
_TITLES: Mapping[Compensation, str] = {
    "none": "velocity command only",
    "torque_error": "torque error (the paper’s scheme)",
    "servo_inversion": "servo inversion",
}
VelocitySource = Literal["desired", "measured", "filtered"]
"""Velocity input of the friction law."""


class Gains(Config):
    """Gains of the controller, one entry per joint.

    Attributes
    ----------
    Kp, Kd : gains of the torque error [rad/(s N.m)], [rad/(N.m)].
    decay : decay of both with the desired velocity, lambda [s/rad].
    Kv, Ki : servo gains that the controller assumes [N.m s/rad], [N.m/rad].
    latency : servo latency that the controller assumes [s].
    """

    Kp: PerJoint
    Kd: PerJoint
    decay: float
    Kv: PerJoint
    Ki: PerJoint
    latency: float


class Tracking(Config):
    """The tracking study.

    Attributes
    ----------
    seeds : one random Fourier motion each.
    duration : period of each motion [s].
    harmonics, peak_velocity, offset : see `random_fourier`.
    gains : gains of the controller.
    Kx : gain of the outer position loop, in schemes with one [1/s].
    sources : laws whose friction is also evaluated on measured and filtered velocity.
    drift : length of a long run that shows drift [s].
    """

    seeds: tuple[int, ...] = Field(min_length=1)
    duration: float = Field(gt=0)
    harmonics: int = Field(ge=2)
    peak_velocity: PerJoint
    offset: PerJoint
    gains: Gains
    Kx: float = Field(gt=0)
    sources: tuple[str, ...] = ()
    drift: float = Field(default=60.0, gt=0)


@dataclass(frozen=True, kw_only=True)
class Scheme:
    """Control scheme.

    Attributes
    ----------
    compensation : compensation of the controller.
    Kx : gain of the outer position loop [1/s].
    source : velocity input of the friction law.
    friction_gain : factor on the friction torque.
    change : difference from the identified loop, for tables; empty if none.
    """

    compensation: Compensation
    Kx: float = 0.0
    source: VelocitySource = "desired"
    friction_gain: float = 1.0
    change: str = ""

    @property
    def name(self) -> str:
        """Name in files; `of_name` is the inverse."""
        change = f": {self.change}" if self.change else ""
        return ", ".join((self.compensation, *self._more)) + change

    @property
    def title(self) -> str:
        """Name in texts."""
        return ", ".join((_TITLES[self.compensation], *self._more))

    @property
    def _more(self) -> Iterator[str]:
        if self.Kx:
            yield f"Kx = {_digits(self.Kx)}"
        if self.source != "desired":
            yield f"friction of {self.source} velocity"
        if self.friction_gain != 1.0:
            yield f"factor {_digits(self.friction_gain)}"

    @classmethod
    def of_name(cls, name: str) -> Self:
        """Return the scheme of a name.

        Raises
        ------
        ValueError
            If the name is not valid.
        """
        found = _NAME.fullmatch(name)
        if found is None:
            raise ValueError(f"'{name}' is not a scheme")
        parts = {key: text for key, text in found.groupdict().items() if text}
        return TypeAdapter(cls).validate_python(parts)


_NAME = re.compile(
    r"(?P<compensation>\w+)(, Kx = (?P<Kx>[^,:]+))?(, friction of (?P<source>\w+) velocity)?"
    r"(, factor (?P<friction_gain>[^,:]+))?(: (?P<change>.+))?"
)


def _digits(value: float) -> str:
    """Return a number with all its digits."""
    return repr(float(value)).removesuffix(".0")


def _scheme(value: Any) -> Any:
    return Scheme.of_name(value) if isinstance(value, str) else value


NamedScheme = Annotated[
    Scheme, BeforeValidator(_scheme), PlainSerializer(lambda scheme: scheme.name, return_type=str)
]
"""A scheme that is its name in JSON."""


@dataclass(frozen=True, kw_only=True)
class Fmus:
    """The FMUs of a loop: arm, trajectory, rigid body, friction, controller, velocity filter."""

    arm: Path
    trajectory: Path
    body: Path
    friction: Path
    controller: Path
    velocity: Path
    gravity: Path | None = None
    """Rigid body of the gravity torque; `body` by default."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """One loop: FMUs, scheme and gains.

    Attributes
    ----------
    fmus, scheme, gains : parts of the loop.
    step : communication step [s].
    time_constant : time constant of the filter of measured velocities [s].
    arm : further parameters of the arm.
    noise : standard deviation of the measured torque, one entry per joint [N.m].
    """

    fmus: Fmus
    scheme: Scheme
    gains: Gains
    step: float
    time_constant: float = 0.02
    arm: Mapping[str, Value] = field(default_factory=dict)
    noise: PerJoint = ()


def preview(scheme: Scheme, gains: Gains, step: float) -> float:
    """Return the preview of the desired motion [s].

    Servo inversion looks ahead by the latency and half a step, since a command is held for a step.
    """
    return gains.latency + 0.5 * step if scheme.compensation == "servo_inversion" else 0.0


def system(
    setting: Setting,
    *,
    duration: float,
    limits: Collection[tuple[float, float]] = (),
    motion: Mapping[str, Value] | None = None,
) -> SystemSpec:
    """Return the loop as a system; the arm is stepped first, with the commands of the last sample.

    Parameters
    ----------
    setting : the loop.
    duration : length of the run [s].
    limits : lowest and highest position of each joint, beyond which the run stops [rad].
    motion : start values of the trajectory; they can also be set for each run.
    """
    fmus, scheme, gains = setting.fmus, setting.scheme, setting.gains
    source = "trajectory.dq_ahead" if scheme.source == "desired" else "velocity.dq"
    filtered = setting.time_constant if scheme.source == "filtered" else 0.0
    components = [
        ComponentSpec(name="arm", fmu=fmus.arm, start=setting.arm),
        ComponentSpec(
            name="trajectory",
            fmu=fmus.trajectory,
            start={
                "preview": preview(scheme, gains, setting.step),
                "rest_time": _REST,
                **(motion or {}),
            },
        ),
        ComponentSpec(name="body", fmu=fmus.body),
        *(
            [ComponentSpec(name="velocity", fmu=fmus.velocity, start={"time_constant": filtered})]
            if scheme.source != "desired"
            else []
        ),
        ComponentSpec(name="friction", fmu=fmus.friction),
        ComponentSpec(name="gravity", fmu=fmus.gravity or fmus.body, start={"dq": 0.0, "ddq": 0.0}),
        ComponentSpec(
            name="controller",
            fmu=fmus.controller,
            start={
                "compensation": scheme.compensation,
                "friction_gain": scheme.friction_gain,
                "sample_time": setting.step,
                "lambda": gains.decay,
                "Kp": gains.Kp,
                "Kd": gains.Kd,
                "Kv": gains.Kv,
                "Ki": gains.Ki,
                "Kx": scheme.Kx,
            },
        ),
    ]
    connections = {
        "arm.dq_cmd": "controller.dq_cmd",
        "body.q": "trajectory.q_ahead",
        "body.dq": "trajectory.dq_ahead",
        "body.ddq": "trajectory.ddq_ahead",
        "friction.dq": source,
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
    if scheme.source != "desired":
        connections["velocity.q"] = "arm.q"
    return SystemSpec(
        name="closed_loop",
        step=setting.step,
        stop=duration,
        components=tuple(components),
        connections=connections,
        observe=("trajectory.q", "arm.q_true"),
        limits={"arm.q_true": tuple((float(a), float(b)) for a, b in limits)}
        if len(limits)
        else {},
    )
