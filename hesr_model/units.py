"""Units of logs in SI, and units of sliding joints."""

from collections.abc import Mapping, Sequence
from math import pi

TURNING: Mapping[str, Mapping[str, float]] = {
    "q": {"rad": 1.0, "deg": pi / 180.0, "rev": 2.0 * pi},
    "dq": {"rad/s": 1.0, "deg/s": pi / 180.0, "rpm": pi / 30.0, "rev/s": 2.0 * pi},
    "q_link": {"rad": 1.0, "deg": pi / 180.0, "rev": 2.0 * pi},
    "tau": {"N.m": 1.0, "mN.m": 1e-3},
}  # in rad, rad/s, N.m

SLIDING: Mapping[str, Mapping[str, float]] = {
    "q": {"m": 1.0, "mm": 1e-3},
    "dq": {"m/s": 1.0, "mm/s": 1e-3},
    "q_link": {"m": 1.0, "mm": 1e-3},
    "tau": {"N": 1.0},
}  # in m, m/s, N

OTHERS: Mapping[str, Mapping[str, float]] = {
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "current": {"A": 1.0, "mA": 1e-3},
}

KNOWN: Mapping[str, Mapping[str, float]] = {
    **OTHERS,
    **{quantity: {**TURNING[quantity], **SLIDING[quantity]} for quantity in TURNING},
}  # in SI, by quantity (t, q, dq, q_link, tau, current)


def in_si(quantity: str, unit: str | float) -> float:
    """Return the size of a unit in SI; negative for ``-deg``."""
    if isinstance(unit, str):
        return KNOWN[quantity][unit.removeprefix("-")] * (-1.0 if unit.startswith("-") else 1.0)
    return float(unit)


def backwards(unit: str | float) -> str | float:
    """Return the unit with the opposite direction."""
    if isinstance(unit, str):
        return unit.removeprefix("-") if unit.startswith("-") else f"-{unit}"
    return -unit


def fits(quantity: str, unit: str | float, *, slides: bool) -> bool:
    """Return whether a joint can be logged in a unit; sliding ones also in rad, rad/s and N.m."""
    if quantity in OTHERS or not isinstance(unit, str):
        return True
    unit = unit.removeprefix("-")
    if slides:
        return unit in SLIDING[quantity] or TURNING[quantity].get(unit) == 1.0
    return unit in TURNING[quantity]


def _slid(product: str) -> str:
    factors: list[str] = []
    for factor in product.split("."):
        prefix, angle, power = factor.partition("rad")
        before = factors[-1] if factors else ""
        if (before[-1:], factor) == ("N", "m") or (before, factor) == ("kg", "m2"):
            continue
        factors.append(f"{prefix}m{power}" if angle else factor)
    return ".".join(factors)


def unit_of_joint(unit: str, *, slides: bool) -> str:
    """Return the unit at a joint, `N.s/m` for `N.m.s/rad` if it slides."""
    if not slides:
        return unit
    if " " in unit:
        raise ValueError(f"'{unit}' is not a unit")
    over, slash, under = unit.partition("/")
    below = _slid(under.removeprefix("(").removesuffix(")"))
    return _slid(over) + slash + (f"({below})" if "." in below else below)


def unit_of_joints(unit: str, sliding: Sequence[bool]) -> str:
    """Return a unit for several joints, as `N.m (N where it slides)` for mixed ones."""
    slid = unit_of_joint(unit, slides=True)
    if not any(sliding) or slid == unit:
        return unit
    return slid if all(sliding) else f"{unit} ({slid} where it slides)"
