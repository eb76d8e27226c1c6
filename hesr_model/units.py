"""Units in which robots log, and what they are in SI."""

from collections.abc import Mapping
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


def fits(quantity: str, unit: str, *, slides: bool) -> bool:
    """Tell whether a joint of this kind can be logged in a unit.

    The SI unit of a joint that turns (rad, rad/s, N.m) is the default of every robot file and
    stands for the SI unit of a joint that slides as well.
    """
    if quantity in OTHERS:
        return True
    if slides:
        return unit in SLIDING[quantity] or TURNING[quantity].get(unit) == 1.0
    return unit in TURNING[quantity]
