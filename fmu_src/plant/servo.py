"""Servos of plants: gains, inputs and memory.

A cascade (`ServoGains`) turns speed errors into torque, and position errors into speed. A position
servo (`PositionServo`) turns position errors into torque, as hobby servos do.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fmu_src.blocks.block import vector
from fmu_src.export.interface import Variable
from hesr_model.errors import ArgumentError, ExportError

UNLIMITED = 1e6  # limit of a torque [N.m] or speed [rad/s] that has none
COMMANDS = 64  # greatest number of commands within the latency of a servo, as in plant_servo.h


def _require_not_negative(**gains: Sequence[float]) -> None:
    """Raise ExportError for a value that is negative or not finite."""
    for name, values in gains.items():
        for number, value in enumerate(values, start=1):
            if not (np.isfinite(value) and value >= 0.0):
                raise ExportError(
                    f"plant: '{name}' of joint {number} is {value:g}; it must not be negative."
                )


def _latency(seconds: float) -> Variable:
    text = f"delay of the commands, at most {COMMANDS} steps"
    return Variable("latency", "fixed", text, unit="s", start=seconds)


@dataclass(frozen=True, kw_only=True)
class ServoGains:
    """Gains (n,) of a servo: of speed [N.m.s/rad], its integral [N.m/rad], and position [1/s]."""

    is_direct: ClassVar[bool] = False

    kv: tuple[float, ...]
    ki: tuple[float, ...]
    kp: tuple[float, ...] = ()

    @classmethod
    def from_gains(
        cls,
        kv: Sequence[float] | None,
        ki: Sequence[float] | None,
        kp: Sequence[float] | None,
    ) -> "ServoGains | None":
        """Return the gains of a servo, or None without `kv`, which the others need."""
        if kv is None:
            for name, gains in (("ki", ki), ("kp", kp)):
                if gains is not None:
                    raise ArgumentError(f"'{name}' needs 'kv', the proportional gain of the servo.")
            return None
        if ki is None:
            ki = (0.0,) * len(kv)
        if kp is None:
            kp = ()
        return cls(kv=tuple(kv), ki=tuple(ki), kp=tuple(kp))

    def __post_init__(self) -> None:
        _require_not_negative(kv=self.kv, ki=self.ki, kp=self.kp)

    @property
    def has_position(self) -> bool:
        """Whether it takes position commands."""
        return bool(self.kp)

    def count_memory(self, joint_count: int) -> int:
        """Return the number of doubles in its own memory."""
        signal_count = 1 + self.has_position
        return joint_count + 1 + COMMANDS * (1 + signal_count * joint_count)

    def inputs(self) -> dict[str, tuple[str, str]]:
        """Return unit and text of its commands by name."""
        commands = {"dq_cmd": ("rad/s", "speed command of the servo")}
        if self.kp:
            commands["q_cmd"] = ("rad", "position command of the servo")
        return commands

    def parameters(self) -> Iterator[Variable]:
        """Yield the parameters."""
        ones = np.ones(len(self.kv))
        text = "gain of the servo"
        yield from vector("servo_kv", "tunable", "N.m.s/rad", f"proportional {text}", self.kv)
        yield from vector("servo_ki", "tunable", "N.m/rad", f"integral {text}", self.ki)
        yield from vector("servo_kp", "tunable", "1/s", "gain of the position", self.kp)
        text = "limit of the servo's torque"
        yield from vector("torque_limit", "tunable", "N.m", text, UNLIMITED * ones)
        text = "share of gravity and springs that the servo compensates"
        yield from vector("gravity_share", "tunable", "1", text, ones)
        yield _latency(0.0)


@dataclass(frozen=True, kw_only=True)
class PositionServo:
    """Servos of n joints that turn position errors into torque.

        tau = kp e + ki (integral of e) + kd (dq_cmd - dq),   e = q_cmd - q

    within +-`torque_limit`. Commands act after `latency`, and through a first-order filter and a
    limit of their speed. Without `dq_cmd` the term of kd damps the joint's own speed.

    Attributes
    ----------
    kp : (n,) gains [N.m/rad].
    ki : (n,) integral gains [N.m/(rad.s)].
    kd : (n,) derivative gains [N.m.s/rad].
    torque_limit : (n,) [N.m].
    command_filter : (n,) time constants [s]; 0 is no filter.
    speed_limit : (n,) of the command [rad/s].
    latency : [s].
    """

    is_direct: ClassVar[bool] = True
    has_position: ClassVar[bool] = True

    kp: tuple[float, ...]
    ki: tuple[float, ...]
    kd: tuple[float, ...]
    torque_limit: tuple[float, ...]
    command_filter: tuple[float, ...]
    speed_limit: tuple[float, ...]
    latency: float

    @classmethod
    def from_stiffness(cls, kp: Sequence[float]) -> "PositionServo":
        """Return proportional servos without limits and latency."""
        zeros = (0.0,) * len(kp)
        unlimited = (UNLIMITED,) * len(kp)
        return cls(
            kp=tuple(kp),
            ki=zeros,
            kd=zeros,
            torque_limit=unlimited,
            command_filter=zeros,
            speed_limit=unlimited,
            latency=0.0,
        )

    def __post_init__(self) -> None:
        _require_not_negative(
            kp=self.kp,
            ki=self.ki,
            kd=self.kd,
            torque_limit=self.torque_limit,
            command_filter=self.command_filter,
            speed_limit=self.speed_limit,
            latency=(self.latency,),
        )

    def count_memory(self, joint_count: int) -> int:
        """Return the number of doubles in its own memory."""
        return 2 * joint_count + 1 + COMMANDS * (1 + 2 * joint_count)

    def inputs(self) -> dict[str, tuple[str, str]]:
        """Return unit and text of its commands by name."""
        return {
            "dq_cmd": ("rad/s", "speed command of the servo's derivative gain"),
            "q_cmd": ("rad", "position command of the servo"),
        }

    def parameters(self) -> Iterator[Variable]:
        """Yield the parameters."""
        zeros = np.zeros(len(self.kp))
        yield from vector("servo_kv", "tunable", "N.m.s/rad", "derivative gain", self.kd)
        yield from vector("servo_ki", "tunable", "N.m/(rad.s)", "integral gain", self.ki)
        yield from vector("servo_kp", "tunable", "N.m/rad", "gain of the position", self.kp)
        text = "limit of the servo's torque"
        yield from vector("torque_limit", "tunable", "N.m", text, self.torque_limit)
        text = "share of gravity and springs that the servo compensates"
        yield from vector("gravity_share", "tunable", "1", text, zeros)
        text = "time constant of the filter of commands"
        yield from vector("command_filter", "tunable", "s", text, self.command_filter)
        text = "limit of the speed of followed commands"
        yield from vector("speed_limit", "tunable", "rad/s", text, self.speed_limit)
        yield _latency(self.latency)


PlantServo = ServoGains | PositionServo
_VECTORS = ("dq_cmd", "tau_motor", "torque_limit", "gravity_share")
_PLACES = {"KV": "servo_kv[1]", "KI": "servo_ki[1]", "LATENCY": "latency"}
_PLACES |= {name.upper(): f"{name}[1]" for name in _VECTORS}
_PLACES_OF_POSITION = {"Q_CMD": "q_cmd[1]", "KP": "servo_kp[1]"}
_PLACES_OF_DIRECT = {"COMMAND_FILTER": "command_filter[1]", "SPEED_LIMIT": "speed_limit[1]"}


def find_places(servo: PlantServo | None) -> tuple[dict[str, str], dict[str, int]]:
    """Return the first variable of each kind, and which kinds there are, for servo.h."""
    kinds = {
        "SERVO": int(servo is not None),
        "POSITION": int(servo is not None and servo.has_position),
        "DIRECT": int(servo is not None and servo.is_direct),
    }
    # What a servo lacks is never read, but has a place.
    places = dict.fromkeys(_PLACES | _PLACES_OF_POSITION | _PLACES_OF_DIRECT, "tau[1]")
    if kinds["SERVO"]:
        places |= _PLACES
    if kinds["POSITION"]:
        places |= _PLACES_OF_POSITION
    if kinds["DIRECT"]:
        places |= _PLACES_OF_DIRECT
    return places, kinds
