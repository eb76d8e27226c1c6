"""The file that names the signals of an MJCF."""

from typing import Annotated

from pydantic import Field, model_validator

from hesr_model.support.config import Config

Names = tuple[str, ...]
Element = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$")]


class InputTable(Config):
    """A vector of inputs.

    Attributes
    ----------
    unit : of every element.
    actuators : for each element those whose control it is.
    """

    unit: str
    actuators: tuple[Names, ...] = Field(min_length=1)


class OutputTable(Config):
    """A vector of outputs.

    Attributes
    ----------
    unit : of every element.
    sensors : for each element the sensors that are summed, with their factors.
    scaled : sensors whose factor follows the friction scale.
    noise : standard deviation of each element's noise; none where left out.
    streams : of the noise, one for each element; their places among all outputs where left out.
    """

    unit: str
    sensors: tuple[dict[str, float], ...] = Field(min_length=1)
    scaled: Names = ()
    noise: tuple[Annotated[float, Field(ge=0)], ...] = ()
    streams: tuple[Annotated[int, Field(ge=0)], ...] = ()

    @model_validator(mode="after")
    def _one_entry_per_element(self) -> "OutputTable":
        for key in ("noise", "streams"):
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
    unit : of every element.
    joints : the joint whose position each element is.
    integrals : the actuator whose activation each element is as well.
    hold : whether the integrals hold what else acts on the joints at rest, so that these stay.
    """

    unit: str
    joints: Names = Field(min_length=1)
    integrals: Names = ()
    hold: bool = False

    @model_validator(mode="after")
    def _one_integral_per_joint(self) -> "StartTable":
        if self.integrals and len(self.integrals) != len(self.joints):
            raise ValueError(
                f"integrals has {len(self.integrals)} entries for {len(self.joints)} joints"
            )
        return self


class SignalTable(Config):
    """The signals of an MJCF.

    Attributes
    ----------
    inputs, outputs, start : by the name of the vector.
    friction : dcmotor actuators that the friction scale applies to.
    payload : body that a payload's mass is added to, as a point at its centre of mass.
    step : preferred communication step [s]; the simulation's own where left out.
    seed : of the noise.
    """

    inputs: dict[Element, InputTable] = Field(default_factory=dict)
    outputs: dict[Element, OutputTable] = Field(min_length=1)
    start: dict[Element, StartTable] = Field(default_factory=dict)
    friction: Names = ()
    payload: str | None = None
    step: float | None = Field(default=None, gt=0)
    seed: int = Field(default=0, ge=0, lt=2**64)
