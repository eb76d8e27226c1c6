"""The TOML file that names the signals of an MJCF."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from hesr_model.support.config import Config

Names = tuple[str, ...]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Element = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$")]


class InputTable(Config):
    """A vector of inputs.

    Attributes
    ----------
    unit : unit of every element.
    actuators : actuators that each element controls.
    """

    unit: str
    actuators: tuple[Names, ...] = Field(min_length=1)


class OutputTable(Config):
    """A vector of outputs.

    Attributes
    ----------
    unit : unit of every element.
    sensors : summed sensors of each element, with their factors.
    losses : joint of each element whose losses are added, as torque against the motion.
    scaled : sensors whose factor follows the friction scale.
    noise : standard deviation of each element's noise; no noise by default.
    streams : noise stream of each element; by default its place among all outputs.
    """

    unit: str
    sensors: tuple[dict[str, float], ...] = Field(min_length=1)
    losses: Names = ()
    scaled: Names = ()
    noise: tuple[NotNegative, ...] = ()
    streams: tuple[Annotated[int, Field(ge=0)], ...] = ()

    @model_validator(mode="after")
    def _one_entry_per_element(self) -> "OutputTable":
        for key in ("losses", "noise", "streams"):
            entries = getattr(self, key)
            if entries and len(entries) != len(self.sensors):
                raise ValueError(
                    f"{key} has {len(entries)} entries for {len(self.sensors)} elements"
                )
        return self


class StartTable(Config):
    """A vector of start values.

    Attributes
    ----------
    unit : unit of every element.
    joints : joint whose position each element sets.
    others : further joint of each element with the same position.
    integrals : actuator of each element whose activation it also sets.
    hold : whether the integrals balance all other torques on the joints at rest.
    """

    unit: str
    joints: Names = Field(min_length=1)
    others: Names = ()
    integrals: Names = ()
    hold: bool = False

    @model_validator(mode="after")
    def _one_entry_per_joint(self) -> "StartTable":
        for key in ("others", "integrals"):
            entries = getattr(self, key)
            if entries and len(entries) != len(self.joints):
                raise ValueError(f"{key} has {len(entries)} entries for {len(self.joints)} joints")
        return self


class Losses(Config):
    """Dry friction of variable level, instead of a constant `frictionloss` of joints.

        level = constant + load |torque| + direct ln(1 + |v| / speed) + evolution ln(1 + s / age)
        s' = 1 - (|v| / slip + 1 / longest) s

    The last two terms are rate-and-state friction with the ageing law of Dieterich and Ruina:
    contacts strengthen with the logarithm of time at rest and are renewed over a slip distance.
    Lists have one entry per joint; omitted terms are zero.

    Attributes
    ----------
    constant : [N.m].
    load : share of the transmitted torque.
    direct, speed : rise with speed [N.m] and its reference speed [rad/s].
    evolution, age, slip : rise with age [N.m], its reference age [s], and the slip distance that
        renews a contact [rad].
    longest : upper bound of the age [s].
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
        given = {key: value for key, value in self if isinstance(value, tuple) and value}
        for key, entries in given.items():
            if len(entries) != len(self.constant):
                raise ValueError(f"{key} has {len(entries)} entries, constant {len(self.constant)}")
        for key, needs in (("direct", ("speed",)), ("evolution", ("age", "slip"))):
            for need in needs:
                if key in given and need not in given:
                    raise ValueError(f"{key} needs {need}")
        return self


class LossTable(Losses):
    """Losses of joints of an MJCF, each with a `frictionloss` there.

    Attributes
    ----------
    joints : joints with losses.
    carriers : joint of each whose springs and gravity compensation are the transmitted torque;
        needed with `load`.
    """

    joints: Names = Field(min_length=1)
    carriers: Names = ()

    @model_validator(mode="after")
    def _load_has_carriers(self) -> Self:
        if any(self.load) and not self.carriers:
            raise ValueError("load needs carriers")
        return self


class SignalTable(Config):
    """The signals of an MJCF.

    Attributes
    ----------
    inputs, outputs, start : by the name of the vector.
    friction : dcmotor actuators that follow the friction scale.
    losses : losses of joints, which also follow the friction scale.
    payload : body that receives the payload, as a point mass at its centre of mass.
    step : preferred communication step [s]; that of the simulation by default.
    seed : seed of the noise.
    """

    inputs: dict[Element, InputTable] = Field(default_factory=dict)
    outputs: dict[Element, OutputTable] = Field(min_length=1)
    start: dict[Element, StartTable] = Field(default_factory=dict)
    friction: Names = ()
    losses: LossTable | None = None
    payload: str | None = None
    step: float | None = Field(default=None, gt=0)
    seed: int = Field(default=0, ge=0, lt=2**64)
