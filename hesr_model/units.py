"""Units in which robots log, what they are in SI, and how joints that slide differ in them."""

import re
from collections.abc import Mapping, Sequence
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


_SLID = (
    (re.compile(r"\(([kmµu]?)N\.m\)|\b([kmµu]?)N\.m\b"), r"\1\2N"),
    (re.compile(r"\b([mµu]?)rad(?=\d|\b)"), r"\1m"),
    (re.compile(r"\bkg\.m2\b"), "kg"),
)


def unit_of_joint(unit: str, *, slides: bool) -> str:
    """Return a unit as it is at a joint that slides, from that at one that turns.

    Everything about friction is written for joints that turn. The equations of a joint that slides
    are the same ones in m and N: `N.m.s/rad` is `N.s/m` there, `1/(N.m)` is `1/N`.

    Parameters
    ----------
    unit : in FMI's spelling, with a prefix as in `mrad` or not; or a text with units in it. What
        is of a joint that slides already stays as it is.
    slides : whether the joint slides; where it turns, the unit comes back unchanged.
    """
    if slides:
        for pattern, slid in _SLID:
            unit = pattern.sub(slid, unit)
    return unit


def unit_of_joints(unit: str, sliding: Sequence[bool]) -> str:
    """Return a unit for what is said of several joints, as the heading of a table.

    Where some turn and some slide it is both, as `N.m (N where it slides)`.

    Parameters
    ----------
    unit : as for `unit_of_joint`, but no text.
    sliding : whether each joint slides; empty if all turn.
    """
    slid = unit_of_joint(unit, slides=True)
    if not any(sliding) or slid == unit:
        return unit
    return slid if all(sliding) else f"{unit} ({slid} where it slides)"
