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
    if isinstance(unit, str):
        return LOG_UNITS[quantity][unit.removeprefix("-")] * (-1.0 if unit.startswith("-") else 1.0)
    return float(unit)


def reverse_unit(unit: str | float) -> str | float:
    """Return the unit with the opposite direction."""
    if isinstance(unit, str):
        return unit.removeprefix("-") if unit.startswith("-") else f"-{unit}"
    return -unit


def is_allowed_unit(quantity: str, unit: str | float, *, is_prismatic: bool) -> bool:
    """Return whether a joint can be logged in a unit; sliding ones also in rad, rad/s and N.m."""
    if quantity in COMMON_UNITS or not isinstance(unit, str):
        return True
    unit = unit.removeprefix("-")
    if is_prismatic:
        return unit in PRISMATIC_UNITS[quantity] or REVOLUTE_UNITS[quantity].get(unit) == 1.0
    return unit in REVOLUTE_UNITS[quantity]


def _to_prismatic_unit(product: str) -> str:
    factors: list[str] = []
    for factor in product.split("."):
        prefix, angle, power = factor.partition("rad")
        last_factor = factors[-1] if factors else ""
        if (last_factor[-1:], factor) == ("N", "m") or (last_factor, factor) == ("kg", "m2"):
            continue
        factors.append(f"{prefix}m{power}" if angle else factor)
    return ".".join(factors)


def unit_of_joint(unit: str, *, is_prismatic: bool) -> str:
    """Return the unit at a joint, `N.s/m` for `N.m.s/rad` if it slides."""
    if not is_prismatic:
        return unit
    if " " in unit:
        raise ValueError(f"'{unit}' is not a unit")
    numerator, slash, denominator = unit.partition("/")
    prismatic_denominator = _to_prismatic_unit(denominator.removeprefix("(").removesuffix(")"))
    return (
        _to_prismatic_unit(numerator)
        + slash
        + (f"({prismatic_denominator})" if "." in prismatic_denominator else prismatic_denominator)
    )


def unit_of_joints(unit: str, sliding: Sequence[bool]) -> str:
    """Return a unit for several joints, as `N.m (N where it slides)` for mixed ones."""
    prismatic_unit = unit_of_joint(unit, is_prismatic=True)
    if not any(sliding) or prismatic_unit == unit:
        return unit
    return prismatic_unit if all(sliding) else f"{unit} ({prismatic_unit} where it slides)"
