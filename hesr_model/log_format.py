"""The format of a robot's logs, as its TOML file declares it."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from hesr_model.config import Config


def _one_place_for_the_joint(columns: str | tuple[str, ...]) -> str | tuple[str, ...]:
    if isinstance(columns, str) and columns.count("{}") != 1:
        raise ValueError("the pattern needs '{}' once, where the joint number (1, 2, ...) stands")
    return columns


def _or_empty(columns: str | tuple[str, ...]) -> str | tuple[str, ...]:
    return _one_place_for_the_joint(columns) if columns else columns


Columns = Annotated[str | tuple[str, ...], AfterValidator(_one_place_for_the_joint)]
"""A pattern such as ``q{}``, filled with the joint number from 1, or one name per joint."""


class LogColumns(Config):
    """Names of a log's columns.

    `dq = ""` says that the log holds no velocity: it is derived from the position.
    """

    t: str = "t"
    q: Columns = "q{}"
    dq: Annotated[str | tuple[str, ...], AfterValidator(_or_empty)] = "dq{}"
    tau: Columns = "tau{}"
    current: Columns = "i{}"


class LogUnits(Config):
    """Units of a log's columns: SI only, declared so that a log in other units is noticed.

    Prismatic joints are in m, m/s and N; what is declared here is for the revolute ones.
    """

    t: Literal["s"] = "s"
    q: Literal["rad"] = "rad"
    dq: Literal["rad/s"] = "rad/s"
    tau: Literal["N.m"] = "N.m"
    current: Literal["A"] = "A"


class LogFormat(Config):
    """How this robot's logs are to be read.

    Attributes
    ----------
    sample_rate
        Nominal rate [Hz]; a log at less than half or more than twice of it is refused.
    filter_cutoff
        Cut-off [Hz] of the zero-phase low pass on q and dq.
    torque_per_ampere
        One factor per joint [N.m/A]; with it, torque is taken from the current columns.
    """

    sample_rate: float | None = Field(default=None, gt=0)
    filter_cutoff: float = Field(default=15.0, gt=0)
    columns: LogColumns = LogColumns()
    units: LogUnits = LogUnits()
    torque_per_ampere: tuple[float, ...] | None = None
