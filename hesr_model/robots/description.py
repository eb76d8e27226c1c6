"""Descriptions of robots: a TOML with joints, owner, sourced constants, and the format of logs."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from hesr_model.errors import RobotError, RuleError
from hesr_model.logs.log_format import LogFormat
from hesr_model.robots.servo_description import ScaleDescription, ServoDescription
from hesr_model.robots.transmission import BALANCER, LINEAR, Coupling, SpringTerm, Transmission
from hesr_model.support.files import PathArg, to_path
from hesr_model.support.owner import Owner
from hesr_model.support.typed_files import Config, PrintableName, RelativePath, from_json, to_json

SourceKind = Literal["measured", "datasheet", "identified", "guessed", "not stated"]
"""Only the first three are evidence against a log."""
_CONSTANTS_KEY = "constants"  # of provenance
_SOURCE_PHRASES: Mapping[SourceKind, str] = {
    "measured": "measured",
    "datasheet": "taken from a data sheet",
    "identified": "identified from known masses",
    "guessed": "guessed: tau is proportional to it",
    "not stated": "of unknown source: state it in the robot file, under 'sources'",
}


class Sources(Config):
    """Sources of constants by key of the robot file, one or one per joint."""

    torque_per_ampere: SourceKind | tuple[SourceKind, ...] = "not stated"


@dataclass(frozen=True, kw_only=True)
class SourcedConstant:
    """A constant of a joint that a result rests on."""

    name: str
    joint: str
    value: float
    unit: str
    source: SourceKind


def statements(provenance: Mapping[str, Any], *only: SourceKind) -> list[str]:
    """Return a sentence per constant and source in a provenance, maybe of some sources only."""
    entries = provenance.get(_CONSTANTS_KEY) or ()
    constants = [
        from_json(SourcedConstant, constant, Path("provenance"), "a constant")
        for constant in entries
    ]
    groups: dict[tuple[SourceKind, str], list[str]] = {}
    for constant in constants:
        groups.setdefault((constant.source, constant.name), []).append(constant.joint)
    return [
        f"{name[0].upper()}{name[1:]} of {', '.join(joints)} {_SOURCE_PHRASES[source]}."
        for (source, name), joints in groups.items()
        if not only or source in only
    ]


class RobotDescription(Config):
    """A robot: its model file, its joints, and the format of its logs.

    Joints run from base to tip, below the body `root` if it is given. `locked`
    gives positions [rad or m] of fixed joints; other unlisted joints rest as in
    the model file, or follow others. `gravity` [m/s2] is in the base frame, by
    default that of the model file; `mount` (roll, pitch, yaw) [rad] turns the
    base. `known` lists exact parameters, such as ``j1.Izz``, and makes others
    placeholders; by default all are approximate. `rotor_inertia` adds a rotor
    inertia per joint, reflected through its gear. `springs` (linear) and
    `balancers` (constant and two harmonics of the angle) list joints with
    further torques. `gear_ratio` (turns of the motor per turn of the joint) is
    needed by laws with motor ripple; `transmission` if motors turn several
    joints or were logged, it then sets the gear ratios. `servo` and `scale` state
    what is known of servos and masses for logs without torque. `sources` states how
    constants are known.
    """

    name: PrintableName
    model: RelativePath
    joints: tuple[PrintableName, ...] = Field(min_length=1)
    locked: dict[str, float] = Field(default_factory=dict)
    root: PrintableName | None = None
    gravity: tuple[float, float, float] | None = None
    mount: tuple[float, float, float] | None = None
    known: tuple[str, ...] | None = None
    rotor_inertia: bool = True
    springs: tuple[PrintableName, ...] = ()
    balancers: tuple[PrintableName, ...] = ()
    gear_ratio: tuple[Annotated[float, Field(gt=0)], ...] | None = None
    transmission: Transmission | None = None
    log: LogFormat = LogFormat()
    servo: ServoDescription = ServoDescription()
    scale: ScaleDescription = ScaleDescription()
    sources: Sources = Sources()
    owner: Owner = Owner()

    @model_validator(mode="before")
    @classmethod
    def _repeat_torque_constant(cls, data: Any) -> Any:
        """Repeat a single torque constant for every joint."""
        log = data.get("log") if isinstance(data, Mapping) else None
        if not isinstance(log, Mapping):
            return data
        gain = log.get("torque_per_ampere")
        if isinstance(gain, bool) or not isinstance(gain, int | float):
            return data
        joints = data.get("joints")
        count = len(joints) if isinstance(joints, list | tuple) else 1
        return {**data, "log": {**log, "torque_per_ampere": (gain,) * count}}

    @model_validator(mode="after")
    def _require_joints_of_inertia(self) -> Self:
        for log, inertias in self.scale.inertia_added.items():
            unknown = [joint for joint in inertias if joint not in self.joints]
            if unknown:
                raise RuleError(
                    f"'scale.inertia_added.{log}' names '{unknown[0]}'; the joints are "
                    f"{', '.join(self.joints)}",
                    code="robot.inertia_added",
                    key=f"scale.inertia_added.{log}",
                )
        return self

    @model_validator(mode="after")
    def _set_gear_ratios(self) -> Self:
        if self.log.columns.q_link and (self.transmission or not self.rotor_inertia):
            raise RuleError(
                "'log.columns.q_link' needs 'rotor_inertia' and excludes 'transmission'; change "
                "one of them",
                code="robot.q_link",
                key="log.columns.q_link",
            )
        if self.transmission is None:
            return self
        ratios = tuple(float(ratio) for ratio in np.abs(self.transmission.ratios))
        if self.gear_ratio not in (None, ratios):
            raise RuleError(
                "'gear_ratio' contradicts the diagonal of 'transmission.matrix'; leave it out",
                code="robot.gear_ratio",
                key="gear_ratio",
            )
        object.__setattr__(self, "gear_ratio", ratios)
        return self

    def spring_terms(self, slides: Sequence[bool]) -> Iterator[SpringTerm]:
        """Yield the terms of springs and balancers; raises RobotError."""
        for key in ("springs", "balancers"):
            for name in getattr(self, key):
                if name not in self.joints:
                    raise RobotError(
                        f"key '{key}' of robot '{self.name}' contains '{name}'; its joints are "
                        f"{', '.join(self.joints)}.",
                        code="robot.springs",
                        key=f"{key}.{name}",
                    )
                if key == "balancers" and slides[self.joints.index(name)]:
                    raise RobotError(
                        f"key 'balancers' of robot '{self.name}' contains '{name}', which slides; "
                        "list it in 'springs'.",
                        code="robot.balancers",
                        key=f"balancers.{name}",
                    )
        for j, joint in enumerate(self.joints):
            names = [*LINEAR] * (joint in self.springs) + [*BALANCER] * (joint in self.balancers)
            for name in dict.fromkeys(names):
                yield SpringTerm(joint=j, name=name)

    @property
    def coupling(self) -> Coupling | None:
        """Friction coordinates over joints, if coupled."""
        return Coupling.from_matrix(self.transmission.coordinates) if self.transmission else None

    @property
    def motors(self) -> Coupling | None:
        """Motors over joints, divided by their gear ratios; None if nothing is coupled."""
        return Coupling.from_matrix(self.transmission.motors) if self.transmission else None

    @property
    def logged(self) -> Coupling | None:
        """Logged coordinates over joints, if motors were logged."""
        return self.motors if self.transmission and self.transmission.logs == "motor" else None

    @property
    def constants(self) -> dict[str, Any]:
        """Entry of a provenance for the constants that turn logs into torques."""
        gains = self.log.torque_per_ampere
        sources = self.sources
        if gains is None:
            return {}
        source_kinds = sources.expand_per_joint("torque_per_ampere", len(gains))
        constant = partial(SourcedConstant, name="torque constant", unit="N.m/A")
        rows = zip(self.joints, gains, source_kinds, strict=True)
        return {
            _CONSTANTS_KEY: [
                to_json(constant(joint=joint, value=gain, source=kind))
                for joint, gain, kind in rows
            ]
        }

    @classmethod
    def read(cls, path: PathArg) -> Self:
        """Read a robot file; raises ConfigError, or RobotError for a list of wrong length."""
        path = to_path(path, "a robot")
        description = super().read(path)
        try:
            description.require_one_per_joint()
        except RobotError as error:
            raise error.add_place(path) from error
        return description

    def require_one_per_joint(self) -> None:
        """Raise RobotError if a list has not one entry per joint."""
        for key, entries in self.lists.items():
            if isinstance(entries, tuple) and len(entries) != len(self.joints):
                raise RobotError(
                    f"key '{key}' of robot '{self.name}' has {len(entries)} entries; "
                    f"its {len(self.joints)} joints need one each.",
                    code="robot.entries",
                    key=key,
                )

    @property
    def lists(self) -> dict[str, Any]:
        """Return values by key, which may be lists with an entry per joint."""
        return {
            "transmission.matrix": self.transmission and self.transmission.matrix,
            "gear_ratio": self.gear_ratio,
            "log.torque_per_ampere": self.log.torque_per_ampere,
            "servo.kp": self.servo.kp,
            "servo.torque_limit": self.servo.torque_limit,
            "log.zero": self.log.zero,
            **{f"log.cylinder.{k}": v for k, v in self.log.cylinder or () if k != "unit"},
            "sources.torque_per_ampere": self.sources.torque_per_ampere,
            "log.bag.joints": self.log.bag.joints,
            **{f"log.columns.{k}": v for k, v in self.log.columns if k not in ("names", "t")},
            **{f"log.units.{key}": entries for key, entries in self.log.units},
        }
