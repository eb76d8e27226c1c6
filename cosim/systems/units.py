"""Numbers of an SSP in units of their own, in the units in which FMUs take them."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import isfinite
from xml.etree import ElementTree as ET

from cosim.systems.contents import Unit
from fmu_src.run.variables import SI, Variables
from hesr_model.errors import ConfigError

_EXPONENTS = len(SI) - 2  # factor and offset stand behind them


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A number with its unit.

    Attributes
    ----------
    value : in the unit.
    unit : its name.
    base : what the unit is in terms of `fmu_src.run.variables.SI`, None where that is not said.
    """

    value: float
    unit: str
    base: Unit | None


def read_units(nodes: Iterable[ET.Element], where: str) -> dict[str, Unit]:
    """Return the units that an SSP defines, by name.

    Parameters
    ----------
    nodes : the `ssc:Unit` elements.
    where : for messages: the file and what of it.

    Raises
    ------
    ConfigError
        If an exponent, a factor or an offset is no number.
    """
    found: dict[str, Unit] = {}
    for node in nodes:
        name, base = node.get("name", ""), node.find("{*}BaseUnit")
        said = {} if base is None else base.attrib
        numbers = [1.0 if key == "factor" else 0.0 for key in SI]
        for k, key in enumerate(SI):
            text = said.get(key)
            try:
                numbers[k] = numbers[k] if text is None else float(text)
            except ValueError as error:
                raise ConfigError(
                    f"{where}: {key} of unit '{name}' is '{text}', no number."
                ) from error
        if base is not None:
            found[name] = tuple(numbers)
    return found


def in_unit_of(variables: Variables, name: str, given: Quantity, where: str) -> float:
    """Return a number in the unit of an FMU's variable; as it is where that has none.

    Parameters
    ----------
    variables : of the FMU.
    name : of the variable.
    given : the number in its own unit.
    where : for messages: the file and the parameter.

    Raises
    ------
    ConfigError
        If the units differ and cannot be converted into each other.
    SimulationError
        If the FMU has no such variable.
    """
    unit, base = variables.unit(name)
    if unit is None or given.base == base is not None:
        return given.value
    if given.base is None or base is None:
        if given.unit == unit:
            return given.value
        where_not = "the SSP" if given.base is None else "the FMU"
        unknown = given.unit if given.base is None else unit
        raise ConfigError(
            f"{where} is in {given.unit}, its variable in {unit}, and {where_not} does not define "
            f"what {unknown} is in SI base units."
        )
    factor, into = given.base[_EXPONENTS], base[_EXPONENTS]
    if given.base[:_EXPONENTS] != base[:_EXPONENTS] or not (factor and into and isfinite(factor)):
        raise ConfigError(
            f"{where} is in {given.unit}, which cannot be converted into {unit}, the unit of its "
            "variable."
        )
    about = variables[name]
    kind = about.declaredType
    # FMI: of differences, as of two temperatures, the offset of the unit is no part.
    relative = kind.relativeQuantity if about.relativeQuantity is None and kind else None
    apart = 0.0 if about.relativeQuantity or relative else given.base[-1] - base[-1]
    return (given.value * factor + apart) / into


def differ(one: str, other: str, defined: dict[str, Unit]) -> bool:
    """Whether two units of one file are known not to be the same."""
    return one in defined and other in defined and defined[one] != defined[other]
