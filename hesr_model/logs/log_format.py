"""The format of a robot's logs, as its TOML file declares it."""

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo

from hesr_model.errors import RobotError
from hesr_model.support.arrays import Array
from hesr_model.support.config import Config
from hesr_model.units import KNOWN, fits, in_si

_PLACES = ("{}", "{1}", "{0}", "{name}")


def _one_place_for_the_joint(columns: str | tuple[str, ...]) -> str | tuple[str, ...]:
    if isinstance(columns, str) and sum(map(columns.count, _PLACES)) != 1:
        raise ValueError(
            "the pattern needs '{}' once, where the joint number (1, 2, ...) stands; '{0}' stands "
            "for the number counted from 0, '{name}' for the joint's name"
        )
    return columns


def _or_empty(columns: str | tuple[str, ...]) -> str | tuple[str, ...]:
    return _one_place_for_the_joint(columns) if columns else columns


UnitName = str | float
_UnitNames = UnitName | tuple[UnitName, ...]


def _known_unit(units: _UnitNames, info: ValidationInfo) -> _UnitNames:
    known = KNOWN[str(info.field_name)]
    for unit in units if isinstance(units, tuple) else (units,):
        if isinstance(unit, str) and unit.removeprefix("-") not in known:
            raise ValueError(f"known units are {', '.join(map(repr, known))}")
        if unit == 0.0:
            raise ValueError("a unit must not be 0")
    return units


Columns = Annotated[str | tuple[str, ...], AfterValidator(_one_place_for_the_joint)]
"""A pattern such as ``q{}`` or ``actual_q_{0}``, or one name per joint; see `column_names`."""

Unit = Annotated[UnitName, AfterValidator(_known_unit)]
Units = Annotated[_UnitNames, AfterValidator(_known_unit)]
"""One unit for all joints, or one per joint: a name, or what one logged unit is in SI."""


def column_names(columns: str | tuple[str, ...], joints: Sequence[str]) -> list[str]:
    """Return one column per joint.

    A pattern holds ``{}`` or ``{1}`` where the joint number counted from 1 stands, ``{0}`` where
    it is counted from 0, or ``{name}`` for the joint's name.
    """
    if isinstance(columns, str):
        return [_filled(columns, k, name) for k, name in enumerate(joints)]
    return list(columns)


def _filled(pattern: str, index: int, name: str) -> str:
    for place, text in zip(_PLACES, (index + 1, index + 1, index, name), strict=True):
        if place in pattern:
            return pattern.replace(place, str(text))
    return pattern


TEMPERATURES = "temperature{}"
"""Columns of temperatures, where a log has any."""


class LogColumns(Config):
    """Names of a log's columns.

    `dq = ""` says that the log holds no velocity: it is derived from the position. Temperatures are
    those of the joints; a log need not hold them where their columns have no name of their own.
    """

    t: str = "t"
    q: Columns = "q{}"
    dq: Annotated[str | tuple[str, ...], AfterValidator(_or_empty)] = "dq{}"
    tau: Columns = "tau{}"
    current: Columns = "i{}"
    temperature: Columns = TEMPERATURES


class LogUnits(Config):
    """Units of a log, for all joints or one per joint; SI where left out.

    A unit is a name; a name behind a minus, as ``-deg``, where the log counts against the model's
    joint; or a number of SI units, as of encoder counts. Joints that slide are in m, m/s and N
    where nothing else is said.
    """

    t: Unit = "s"
    q: Units = "rad"
    dq: Units = "rad/s"
    tau: Units = "N.m"
    current: Units = "A"
    temperature: Literal["degC", "K"] = "degC"

    def factors(self, quantity: str, joints: int) -> Array:
        """Return what one logged unit of a quantity is in SI, an array of shape (joints,)."""
        return np.array([in_si(quantity, unit) for unit in self.each(quantity, joints)])

    def each(self, quantity: str, joints: int) -> tuple[UnitName, ...]:
        """Return the unit of a quantity at each joint."""
        units = getattr(self, quantity)
        return units if isinstance(units, tuple) else (units,) * joints

    @property
    def zero_of_temperature(self) -> float:
        """What the log says at 0 degC."""
        return 273.15 if self.temperature == "K" else 0.0

    def require_fitting(self, joints: Sequence[str], slides: Sequence[bool]) -> None:
        """Check that no joint that slides is in units of one that turns, and the other way.

        Raises
        ------
        RobotError
            Naming the key, the unit and the joint.
        """
        for quantity in KNOWN:
            each = self.each(quantity, len(joints))
            for joint, unit, sliding in zip(joints, each, slides, strict=True):
                if not fits(quantity, unit, slides=sliding):
                    raise RobotError(
                        f"key 'log.units.{quantity}' is '{unit}' for joint '{joint}', which "
                        f"{'slides' if sliding else 'turns'}; give a list of one unit per joint."
                    )


class LogBag(Config):
    """Where a ROS bag holds the joints' states.

    Attributes
    ----------
    topic : of messages ``sensor_msgs/msg/JointState``.
    joints : names of the robot's joints in these messages, in the order of `joints` of the robot;
        the same names where left out.
    effort : what the messages' effort is: torque ``"tau"``, or ``"current"``, as drivers of some
        robots publish it.
    """

    topic: str = "/joint_states"
    joints: tuple[str, ...] | None = None
    effort: Literal["tau", "current"] = "tau"


class LogFormat(Config):
    """How this robot's logs are to be read.

    Attributes
    ----------
    sample_rate : nominal rate [Hz], where it is known; it is measured in each log, and a log at
        another one is refused.
    missing : what becomes of rows with an empty cell or NaN, or with the stamp of the row before:
        ``"refuse"`` the log, or ``"drop"`` the rows.
    filter_cutoff : cut-off [Hz] of the zero-phase low pass on q and dq.
    columns : of CSV, Parquet and MATLAB files.
    units : of these columns, and of a bag's messages.
    bag : of ROS bags.
    zero : one position per joint [rad; m] at which the log says 0, where that is not the model's 0.
    torque_per_ampere : one factor per joint [N.m/A]; with it, torque is taken from the current
        columns.
    """

    sample_rate: float | None = Field(default=None, gt=0)
    missing: Literal["refuse", "drop"] = "refuse"
    filter_cutoff: float = Field(default=15.0, gt=0)
    columns: LogColumns = LogColumns()
    units: LogUnits = LogUnits()
    bag: LogBag = LogBag()
    zero: tuple[float, ...] | None = None
    torque_per_ampere: tuple[float, ...] | None = None
