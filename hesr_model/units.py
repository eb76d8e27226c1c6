"""Units in which robots log, what they are in SI, and how joints that slide differ in them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import pi

TURNING: Mapping[str, Mapping[str, float]] = {
    "q": {"rad": 1.0, "deg": pi / 180.0, "rev": 2.0 * pi},
    "dq": {"rad/s": 1.0, "deg/s": pi / 180.0, "rpm": pi / 30.0, "rev/s": 2.0 * pi},
    "tau": {"N.m": 1.0, "mN.m": 1e-3},
}
"""Of joints that turn: one unit in rad, rad/s, N.m."""

SLIDING: Mapping[str, Mapping[str, float]] = {
    "q": {"m": 1.0, "mm": 1e-3},
    "dq": {"m/s": 1.0, "mm/s": 1e-3},
    "tau": {"N": 1.0},
}
"""Of joints that slide: one unit in m, m/s, N."""

OTHERS: Mapping[str, Mapping[str, float]] = {
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "current": {"A": 1.0, "mA": 1e-3},
}

KNOWN: Mapping[str, Mapping[str, float]] = {
    **OTHERS,
    **{quantity: {**TURNING[quantity], **SLIDING[quantity]} for quantity in TURNING},
}
"""By quantity (t, q, dq, tau, current): one unit in SI."""


def in_si(quantity: str, unit: str | float) -> float:
    """Return what one logged unit is in SI; a number is that already, ``-deg`` counts backwards.

    Raises
    ------
    KeyError
        If the unit is unknown.
    """
    if isinstance(unit, str):
        return KNOWN[quantity][unit.removeprefix("-")] * (-1.0 if unit.startswith("-") else 1.0)
    return float(unit)


def backwards(unit: str | float) -> str | float:
    """Return the unit of a log that counts the other way."""
    if isinstance(unit, str):
        return unit.removeprefix("-") if unit.startswith("-") else f"-{unit}"
    return -unit


def fits(quantity: str, unit: str | float, *, slides: bool) -> bool:
    """Tell whether a joint of this kind can be logged in a unit; a number fits any.

    The SI unit of a joint that turns (rad, rad/s, N.m) is the default of every robot file and
    stands for the SI unit of a joint that slides as well.
    """
    if quantity in OTHERS or not isinstance(unit, str):
        return True
    unit = unit.removeprefix("-")
    if slides:
        return unit in SLIDING[quantity] or TURNING[quantity].get(unit) == 1.0
    return unit in TURNING[quantity]


@dataclass(frozen=True)
class Unit:
    """A unit of something at a joint, as FMI spells it: where the joint turns, and where it slides.

    Everything about friction is written for joints that turn. The equations of a joint that slides
    are the same ones in m and N: `N.m.s/rad` is `N.s/m` there, `1/(N.m)` is `1/N`.
    """

    turning: str
    sliding: str

    @classmethod
    def read(cls, symbol: str) -> "Unit":
        """Return the unit of a joint that turns, as `mrad/s` or `rad/(s.N.m)`.

        One of a joint that slides already is the same at both.

        Raises
        ------
        ValueError
            If it is a text instead of a unit.
        """
        if " " in symbol:
            raise ValueError(f"'{symbol}' is no unit")
        over, slash, under = symbol.partition("/")
        below = _slid(under.removeprefix("(").removesuffix(")"))
        brackets = "({})" if "." in below else "{}"
        return cls(symbol, _slid(over) + slash + brackets.format(below))


def _slid(product: str) -> str:
    """Return one side of a fraction with m for rad, N for N.m and kg for kg.m2."""
    factors: list[str] = []
    for factor in product.split("."):
        prefix, angle, power = factor.partition("rad")
        before = factors[-1] if factors else ""
        if (before[-1:], factor) == ("N", "m") or (before, factor) == ("kg", "m2"):
            continue
        factors.append(f"{prefix}m{power}" if angle else factor)
    return ".".join(factors)


def unit_of_joint(unit: str, *, slides: bool) -> str:
    """Return the unit of something at a joint, from that at one that turns; see `Unit`."""
    return Unit.read(unit).sliding if slides else unit


def unit_of_joints(unit: str, sliding: Sequence[bool]) -> str:
    """Return a unit for what is said of several joints, as the heading of a table.

    Where some turn and some slide it is both, as `N.m (N where it slides)`.

    Parameters
    ----------
    unit : at a joint that turns.
    sliding : whether each joint slides; empty if all turn.
    """
    slid = unit_of_joint(unit, slides=True)
    if not any(sliding) or slid == unit:
        return unit
    return slid if all(sliding) else f"{unit} ({slid} where it slides)"
