"""TOML file that names the signals of an MJCF."""

from collections.abc import Collection
from typing import Annotated, Self

from pydantic import Field, model_validator

from hesr_model.support.config import Config

Names = tuple[str, ...]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Element = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$")]


def require_entries(
    table: Config, count: int, what: str = "joint", *, besides: Collection[str] = ()
) -> None:
    """Raise ValueError unless the lists of a table have `count` entries or are omitted."""
    for key, entries in table:
        if not isinstance(entries, tuple) or key in besides:
            continue
        omitted = not entries and not type(table).model_fields[key].is_required()
        if len(entries) != count and not omitted:
            raise ValueError(
                f"{key} has {len(entries)} entries; {count} are needed, one per {what}"
            )


class InputTable(Config):
    """Vector of inputs: the actuators that each element controls."""

    unit: str
    actuators: tuple[Names, ...] = Field(min_length=1)


class OutputTable(Config):
    """Vector of outputs: the summed sensors of each element, with their factors.

    Losses of joints are added as torque against the motion; `scaled` sensors follow the friction
    scale; `noise` is a standard deviation.
    """

    unit: str
    sensors: tuple[dict[str, float], ...] = Field(min_length=1)
    losses: Names = ()
    scaled: Names = ()
    noise: tuple[NotNegative, ...] = ()
    streams: tuple[Annotated[int, Field(ge=0)], ...] = ()

    @model_validator(mode="after")
    def _one_entry_per_element(self) -> Self:
        require_entries(self, len(self.sensors), "element", besides=("scaled",))
        return self


class StartTable(Config):
    """Vector of start values: the joint whose position each element sets.

    Joints in `others` get the same position, actuators in `integrals` the same activation; with
    `hold`, these balance the joints at rest.
    """

    unit: str
    joints: Names = Field(min_length=1)
    others: Names = ()
    integrals: Names = ()
    hold: bool = False

    @model_validator(mode="after")
    def _one_entry_per_joint(self) -> Self:
        require_entries(self, len(self.joints))
        return self


class Losses(Config):
    """Dry friction of variable level, instead of a constant `frictionloss` of joints.

        level = constant + load |torque| + direct ln(1 + |v| / speed) + evolution ln(1 + s / age)
        s' = 1 - (|v| / slip + 1 / longest) s

    The last two terms are rate-and-state friction (ageing law of Dieterich and Ruina). Units are
    N.m, rad, rad/s and s; `load` is a share of the transmitted torque. Lists have one entry per
    joint; omitted terms are zero.
    """

    constant: tuple[NotNegative, ...] = Field(min_length=1)
    load: tuple[NotNegative, ...] = ()
    direct: tuple[NotNegative, ...] = ()
    speed: tuple[Positive, ...] = ()
    evolution: tuple[NotNegative, ...] = ()
    age: tuple[Positive, ...] = ()
    slip: tuple[Positive, ...] = ()
    longest: Positive = 1e4

    def of_joint(self, i: int) -> dict[str, float]:
        """Return the numbers of a joint by key; omitted ones have no effect."""
        scales = ("speed", "age", "slip")
        lists = ("constant", "load", "direct", "evolution", *scales)
        found = {key: (getattr(self, key) or (float(key in scales),) * (i + 1))[i] for key in lists}
        return found | {"longest": self.longest}

    @model_validator(mode="after")
    def _complete(self) -> Self:
        require_entries(self, len(self.constant))
        for key, need in (("direct", "speed"), ("evolution", "age"), ("evolution", "slip")):
            if getattr(self, key) and not getattr(self, need):
                raise ValueError(f"{key} needs {need}")
        return self


class LossTable(Losses):
    """Losses of joints with a `frictionloss`; `carriers` transmit the torque for `load`."""

    joints: Names = Field(min_length=1)
    carriers: Names = ()

    @model_validator(mode="after")
    def _load_has_carriers(self) -> Self:
        if any(self.load) and not self.carriers:
            raise ValueError("load needs carriers")
        return self


class SignalTable(Config):
    """Signals of an MJCF; inputs, outputs and start values by the name of the vector.

    The dcmotors in `friction` and the losses follow the friction scale. The payload is a point
    mass. `step` [s] is by default that of the simulation; `seed` is the noise's.
    """

    inputs: dict[Element, InputTable] = Field(default_factory=dict)
    outputs: dict[Element, OutputTable] = Field(min_length=1)
    start: dict[Element, StartTable] = Field(default_factory=dict)
    friction: Names = ()
    losses: LossTable | None = None
    payload: str | None = None
    step: float | None = Field(default=None, gt=0)
    seed: int = Field(default=0, ge=0, lt=2**64)
