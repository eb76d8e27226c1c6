"""The log format of a robot file."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from hesr_model.errors import RobotError, RuleError
from hesr_model.support.arrays import Array
from hesr_model.support.typed_files import Config
from hesr_model.units import LOG_UNITS, find_si_factor, is_allowed_unit

_PLACES = ("{}", "{1}", "{0}", "{name}")


def _require_one_place(columns: str | tuple[str, ...]) -> str | tuple[str, ...]:
    if isinstance(columns, str) and sum(map(columns.count, _PLACES)) != 1:
        raise RuleError(
            "the pattern needs '{}' (joint number from 1), '{0}' (number from 0) or '{name}' once",
            code="log.pattern",
        )
    return columns


def _require_place_unless_empty(columns: str | tuple[str, ...]) -> str | tuple[str, ...]:
    return _require_one_place(columns) if columns else columns


UnitName = str | float
_UnitNames = UnitName | tuple[UnitName, ...]


def _require_known_unit(units: _UnitNames, info: ValidationInfo) -> _UnitNames:
    known_units = LOG_UNITS[str(info.field_name)]
    listed_units = units if isinstance(units, tuple) else (units,)
    for unit in listed_units:
        if isinstance(unit, str) and unit.removeprefix("-") not in known_units:
            raise RuleError(f"known units are {', '.join(map(repr, known_units))}", code="log.unit")
        if unit == 0.0:
            raise RuleError("a unit must not be 0", code="log.unit_zero")
    return units


Columns = Annotated[str | tuple[str, ...], AfterValidator(_require_one_place)]
"""Pattern such as ``q{}`` or ``actual_q_{0}``, or one name per joint."""
KnownUnit = Annotated[UnitName, AfterValidator(_require_known_unit)]
# Unit of all joints or one per joint: a name, or its size in SI
Units = Annotated[_UnitNames, AfterValidator(_require_known_unit)]


def column_names(columns: str | tuple[str, ...], joints: Sequence[str]) -> list[str]:
    """Fill a pattern with joint numbers (``{}`` from 1, ``{0}`` from 0) or names (``{name}``)."""
    if not isinstance(columns, str):
        return list(columns)
    pattern = columns.replace("{}", "{1}")  # it has one place
    return [
        pattern.replace("{1}", f"{k}").replace("{0}", f"{k - 1}").replace("{name}", name)
        for k, name in enumerate(joints, start=1)
    ]


OPTIONAL = {"q_cmd": "q_cmd{}", "dq_cmd": "dq_cmd{}", "temperature": "temperature{}"}


class LogColumns(Config):
    """Column names; `dq = ""` derives velocity, default commands and temperatures are optional.

    `t` may be two columns, of whole seconds and of the nanoseconds since, or of the unit that the
    second name ends with, as in 'tv_usec'. `q = ""` integrates velocity.
    `q_link` names encoders behind elastic gears, whose motors then have `q`, divided by the gear.
    `current_size` names currents without a sign, of logs with commands and no torque.
    A list instead of the table, or `names`, names all columns of files without a header, in order.
    """

    names: tuple[str, ...] = ()
    t: str | tuple[str, str] = "t"
    q: Annotated[str | tuple[str, ...], AfterValidator(_require_place_unless_empty)] = "q{}"
    dq: Annotated[str | tuple[str, ...], AfterValidator(_require_place_unless_empty)] = "dq{}"
    tau: Columns = "tau{}"
    current: Columns = "i{}"
    q_link: Annotated[str | tuple[str, ...], AfterValidator(_require_place_unless_empty)] = ""
    temperature: Columns = OPTIONAL["temperature"]
    q_cmd: Columns = OPTIONAL["q_cmd"]
    dq_cmd: Columns = OPTIONAL["dq_cmd"]
    current_size: Annotated[str | tuple[str, ...], AfterValidator(_require_place_unless_empty)] = ""

    @model_validator(mode="before")
    @classmethod
    def _wrap_list_of_names(cls, value: Any) -> Any:
        return {"names": value} if isinstance(value, list | tuple) else value

    @property
    def time_name(self) -> str:
        """Name of the column of time, of two that of the seconds."""
        return self.t if isinstance(self.t, str) else self.t[0]

    @model_validator(mode="after")
    def _require_motion(self) -> Self:
        if not self.q and not self.dq:
            raise RuleError(
                "'q' and 'dq' are both empty; name the columns of one of them",
                code="log.no_motion",
                key="q",
            )
        return self

    @field_validator("names")
    @classmethod
    def _require_different_names(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(names)) < len(names):
            raise RuleError("the names of columns must differ", code="log.names_differ")
        return names


class LogUnits(Config):
    """Units by name, ``-name`` (reversed), or size; sliding joints default to m, m/s, N."""

    t: KnownUnit = "s"
    q: Units = "rad"
    dq: Units = "rad/s"
    q_link: Units = "rad"
    tau: Units = "N.m"
    current: Units = "A"
    temperature: Literal["degC", "K"] = "degC"

    def factors(self, quantity: str, joints: int) -> Array:
        """Return the size in SI of each joint's unit."""
        return np.array(
            [find_si_factor(quantity, unit) for unit in self.expand_per_joint(quantity, joints)]
        )

    def replace_units(
        self, quantity: str, is_replaced: Sequence[bool], unit: str | float
    ) -> tuple[str | float, ...]:
        """Return the unit of each joint, with another one for the joints `is_replaced` (n,)."""
        joint_units = self.expand_per_joint(quantity, len(is_replaced))
        return tuple(
            unit if replaced else joint_unit
            for joint_unit, replaced in zip(joint_units, is_replaced, strict=True)
        )

    @property
    def zero_of_temperature(self) -> float:
        """Logged value at 0 degC."""
        return 273.15 if self.temperature == "K" else 0.0

    def require_fitting(self, joints: Sequence[str], slides: Sequence[bool]) -> None:
        """Raise RobotError if a unit is not for sliding or turning joints."""
        for quantity in LOG_UNITS:
            joint_units = self.expand_per_joint(quantity, len(joints))
            for joint, unit, is_prismatic in zip(joints, joint_units, slides, strict=True):
                if not is_allowed_unit(quantity, unit, is_prismatic=is_prismatic):
                    motion = "slides" if is_prismatic else "turns"
                    raise RobotError(
                        f"key 'log.units.{quantity}' is '{unit}' for joint '{joint}', which "
                        f"{motion}; give a list of one unit per joint.",
                        code="log.unit_of_joint",
                        key=f"log.units.{quantity}",
                    )


class LogBag(Config):
    """Joint states in ROS bags: topics, joint names and meaning of `effort`."""

    topic: str | tuple[str, ...] = "/joint_states"
    joints: tuple[str, ...] | None = None
    effort: Literal["tau", "current"] = "tau"

    @property
    def topics(self) -> tuple[str, ...]:
        """Names of all topics."""
        return (self.topic,) if isinstance(self.topic, str) else self.topic


class LogCylinder(Config):
    """Hydraulic or pneumatic cylinders: `areas` [m2] and `pressures`, two columns per joint.

    The force is A1 p1 - A2 p2. The load of the friction is the force of p1 - p2 on the mean area.
    """

    pressures: tuple[tuple[str, str], ...]
    areas: tuple[tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]], ...]
    unit: Literal["Pa", "kPa", "bar", "MPa"] = "Pa"

    @field_validator("pressures", "areas", mode="before")
    @classmethod
    def _wrap_single_pair(cls, value: Any) -> Any:
        is_nested = isinstance(value, list | tuple) and value and isinstance(value[0], list | tuple)
        return value if is_nested else (value,)

    def forces(self, pressures: Array) -> tuple[Array, Array]:
        """Return forces and loads (N, n) [N] for p1 and p2 of each joint in turn, (N, 2 n)."""
        scale = {"Pa": 1.0, "kPa": 1e3, "bar": 1e5, "MPa": 1e6}[self.unit]
        first_pressure = scale * pressures[:, ::2]
        second_pressure = scale * pressures[:, 1::2]
        first_area, second_area = np.array(self.areas).T
        return first_area * first_pressure - second_area * second_pressure, 0.5 * (
            first_area + second_area
        ) * (first_pressure - second_pressure)


class LogFormat(Config):
    """Format of a robot's logs.

    `sample_rate` [Hz] is checked; `rate` [Hz] replaces a missing time column. Rows are `missing`
    with an empty cell, NaN or a repeated stamp; columns with numbers in different rows are
    interpolated at the rows of the slowest. Of `duplicates`, rows that repeat a stamp, the first is
    kept, or all are spread evenly, as rows that arrive in bursts; `sort` orders rows by time.
    Stamps begin again after `wrap` of their unit, as of a counter; where they `restart`, time goes
    on after a gap.
    `filter_cutoff` [Hz] applies to q and dq; `zero` [rad; m] is the joint position at a logged 0;
    `torque_per_ampere` [N.m/A] turns currents into torques.
    """

    sample_rate: float | None = Field(default=None, gt=0)
    rate: float | None = Field(default=None, gt=0)
    missing: Literal["refuse", "drop", "interpolate"] = "refuse"
    duplicates: Literal["refuse", "first", "spread"] = "refuse"
    sort: bool = False
    wrap: float | None = Field(default=None, gt=0)
    restart: Literal["refuse", "gap"] = "refuse"
    filter_cutoff: float = Field(default=15.0, gt=0)
    columns: LogColumns = LogColumns()
    units: LogUnits = LogUnits()
    bag: LogBag = LogBag()
    zero: tuple[float, ...] | None = None
    torque_per_ampere: tuple[float, ...] | None = None
    cylinder: LogCylinder | None = None

    @property
    def allows_missing(self) -> bool:
        """Whether rows may lack numbers."""
        return self.missing != "refuse"

    @property
    def needs_all_rows(self) -> bool:
        """Whether rows depend on those before: their order, how often a counter has wrapped."""
        return (
            self.sort
            or self.wrap is not None
            or self.restart != "refuse"
            or self.duplicates == "spread"
            or self.missing == "interpolate"
        )
