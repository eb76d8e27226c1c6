"""Units of logs in SI, and units of sliding joints."""

from collections.abc import Mapping, Sequence
from math import pi

REVOLUTE_UNITS: Mapping[str, Mapping[str, float]] = {
    "q": {"rad": 1.0, "deg": pi / 180.0, "rev": 2.0 * pi},
    "dq": {"rad/s": 1.0, "deg/s": pi / 180.0, "rpm": pi / 30.0, "rev/s": 2.0 * pi},
    "q_link": {"rad": 1.0, "deg": pi / 180.0, "rev": 2.0 * pi},
    "tau": {"N.m": 1.0, "mN.m": 1e-3},
}  # in rad, rad/s, N.m

PRISMATIC_UNITS: Mapping[str, Mapping[str, float]] = {
    "q": {"m": 1.0, "mm": 1e-3},
    "dq": {"m/s": 1.0, "mm/s": 1e-3},
    "q_link": {"m": 1.0, "mm": 1e-3},
    "tau": {"N": 1.0},
}  # in m, m/s, N

COMMON_UNITS: Mapping[str, Mapping[str, float]] = {
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "current": {"A": 1.0, "mA": 1e-3},
}

LOG_UNITS: Mapping[str, Mapping[str, float]] = {
    **COMMON_UNITS,
    **{
        quantity: {**REVOLUTE_UNITS[quantity], **PRISMATIC_UNITS[quantity]}
        for quantity in REVOLUTE_UNITS
    },
}  # in SI, by quantity (t, q, dq, q_link, tau, current)


def find_si_factor(quantity: str, unit: str | float) -> float:
    """Return the size of a unit in SI; negative for ``-deg``."""
    if not isinstance(unit, str):
        return float(unit)
    factor = LOG_UNITS[quantity][unit.removeprefix("-")]
    if unit.startswith("-"):
        return -factor
    return factor


def reverse_unit(unit: str | float) -> str | float:
    """Return the unit with the opposite direction."""
    if not isinstance(unit, str):
        return -unit
    if unit.startswith("-"):
        return unit.removeprefix("-")
    return f"-{unit}"


def is_allowed_unit(quantity: str, unit: str | float, *, is_prismatic: bool) -> bool:
    """Return whether a joint can be logged in a unit; sliding ones also in rad, rad/s and N.m."""
    if quantity in COMMON_UNITS or not isinstance(unit, str):
        return True
    unit = unit.removeprefix("-")
    if is_prismatic:
        return unit in PRISMATIC_UNITS[quantity] or REVOLUTE_UNITS[quantity].get(unit) == 1.0
    return unit in REVOLUTE_UNITS[quantity]


def _to_prismatic_unit(product: str) -> str:
    """Return a product of units with m in place of rad, N of N.m, and kg of kg.m2."""
    factors = [""]
    for factor in product.split("."):
        is_lever = factors[-1].endswith("N") and factor == "m"
        is_square_of_lever = factors[-1] == "kg" and factor == "m2"
        if not is_lever and not is_square_of_lever:
            factors.append(factor.replace("rad", "m", 1))
    return ".".join(factors[1:])


def unit_of_joint(unit: str, *, is_prismatic: bool) -> str:
    """Return the unit at a joint, `N.s/m` for `N.m.s/rad` if it slides."""
    if not is_prismatic:
        return unit
    if " " in unit:
        raise ValueError(f"'{unit}' is not a unit")
    numerator, slash, denominator = unit.partition("/")
    prismatic_denominator = _to_prismatic_unit(denominator.removeprefix("(").removesuffix(")"))
    if "." in prismatic_denominator:
        prismatic_denominator = f"({prismatic_denominator})"
    return f"{_to_prismatic_unit(numerator)}{slash}{prismatic_denominator}"


def unit_of_joints(unit: str, sliding: Sequence[bool]) -> str:
    """Return a unit for several joints, as `N.m (N where it slides)` for mixed ones."""
    prismatic_unit = unit_of_joint(unit, is_prismatic=True)
    if not any(sliding) or prismatic_unit == unit:
        return unit
    if all(sliding):
        return prismatic_unit
    return f"{unit} ({prismatic_unit} where it slides)"
