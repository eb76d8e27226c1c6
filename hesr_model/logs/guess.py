"""Guesses of the columns of an unknown table."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.log_table import LogTable
from hesr_model.units import OTHERS


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_WORDS: Mapping[str, frozenset[str]] = {
    "temperature": _words("temperature temperatures temp temps"),
    "dq": _words(
        "dq qd qdot dqdt vel velocity velocities speed speeds omega qp geschwindigkeit drehzahl"
    ),
    "q": _words(
        "q pos position positions angle angles theta qm encoder enc displacement winkel weg"
    ),
    "tau": _words(
        "tau torque torques trq effort efforts moment moments drehmoment tq nm force forces kraft"
    ),
    "current": _words("i im cur curr current currents amp amps ampere iq strom motorstrom"),
}  # Words in column names; the first match wins
_FORCES = _words("force forces kraft")  # torques of sliding joints, unless a torque is logged
_COMMANDED = ("q", "dq")  # quantities whose commands are read
_PLACES = _words("joint axis")  # positions, unless another quantity matches
_COMMANDS = _words("target desired des ref reference cmd command setpoint goal")
_OTHERS = _words(
    "acc acceleration ddq qdd error err tcp ext external voltage control window limit mode status "
    "dir"
)  # ignored columns
_MOTORS = _words("qm motor motors")
_MEASURED = _words("actual act meas measured msr")
_TIME = _words("t time timestamp stamp timestamps datetime date clock unix secs seconds sec zeit")
_UNITS: Mapping[str, Mapping[str, str]] = {
    "q": {"deg": "deg", "degree": "deg", "degrees": "deg", "grad": "deg", "mm": "mm", "rev": "rev"},
    "dq": dict.fromkeys(("deg", "degs", "dps", "degrees"), "deg/s") | {"rpm": "rpm", "mm": "mm/s"},
    "tau": {"mnm": "mN.m"},
    "current": {"ma": "mA"},
    "temperature": {"kelvin": "K"},
    "t": {word: word[:2] for word in ("ms", "msec", "us", "usec", "ns", "nsec")}
    | {"nanoseconds": "ns", "milliseconds": "ms"},
}
_TOKEN = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|°")
_AXES = re.compile(r"(?<![A-Za-z])[iI]_([dq])(?![A-Za-z])")  # i_q is a current, not a position
_NUMBER = re.compile(r"(?<!\d)\d{1,9}(?!\d)")  # a joint number; longer ones are slow to parse
_RATES = (5.0, 20_000.0)  # plausible sample rates [Hz]


@dataclass(frozen=True, kw_only=True)
class Guess:
    """Columns (a name for t, else one per joint), units and reasons by quantity."""

    columns: Mapping[str, str | tuple[str, ...]]
    units: Mapping[str, str] = field(default_factory=dict)
    reasons: Mapping[str, str] = field(default_factory=dict)


def guess(table: LogTable, joints: Sequence[str] = (), *, timed: bool = True) -> Guess:
    """Guess columns, maybe with names of `joints`, and time if `timed`; raises LogError."""
    groups = list(_groups(table.names, joints))
    count = len(joints) or max((len(g) for _, g in groups if _quantity(g[0]) == "q"), default=0)
    alone = [name for name in table.names if _quantity(name) == "q"]
    if count < 2 and not any(_quantity(g[0]) == "q" for _, g in groups) and len(alone) == 1:
        groups = [("", (name,)) for name in table.names]
        count = 1
    columns: dict[str, str | tuple[str, ...]] = {}
    units = {}
    reasons = {}
    for quantity in (*_WORDS, *(f"{name}_cmd" for name in _COMMANDED)):
        fitting = [g for _, g in groups if _quantity(g[0]) == quantity and len(g) >= count > 0]
        if not fitting and joints:
            alike = tuple(name for name in table.names if _quantity(name) == quantity)
            fitting = [alike] * (len(alike) == count)  # mixed names, as q_lift, q_1, q_2
        if fitting:
            best = min(
                fitting,
                key=lambda g: (
                    not _FORCES.isdisjoint(_tokens(g[0])),
                    _MEASURED.isdisjoint(_tokens(g[0])),
                    len(g),
                    len(g[0]),
                ),
            )
            columns[quantity] = tuple(best[:count])
            reasons[quantity] = f"named so: {best[0]}"
            unit = _unit(quantity, best[0])
            if unit:
                units[quantity] = unit
    if timed or any(_rises(table, name) for name in _named_as_time(table)):
        columns["t"] = _time(table)
        units["t"], reasons["t"] = _time_unit(table, str(columns["t"]))
    if "q" not in columns:
        wanted = "a joint" if count < 2 else f"all {count} joints"
        raise LogError(
            f"{table.path}: no columns look like positions of {wanted}; it has "
            f"{table.listing}; name them under 'log.columns' of a robot file.",
            code="log.no_positions",
            where=table.path,
            key="log.columns",
        )
    return Guess(columns=columns, units=units, reasons=reasons)


def is_of_motor(name: str) -> bool:
    """Return whether a column is named like a motor's."""
    return not _MOTORS.isdisjoint(_tokens(name))


def _groups(names: Sequence[str], joints: Sequence[str]) -> Iterator[tuple[str, tuple[str, ...]]]:
    numbered: dict[str, dict[int, str]] = {}
    named: dict[str, dict[int, str]] = {}
    for name in names:
        for place in _NUMBER.finditer(name):
            key = f"{name[: place.start()]}{{}}{name[place.end() :]}"
            numbered.setdefault(key, {})[int(place[0])] = name
        for k, joint in enumerate(joints):
            if joint in name:
                named.setdefault(name.replace(joint, "{name}", 1), {})[k] = name
    for key, found in (*named.items(), *numbered.items()):
        places = sorted(found)
        if len(places) > 1 or len(joints) == 1:
            yield key, tuple(found[k] for k in places)


def _tokens(name: str) -> list[str]:
    return [token.lower() for token in _TOKEN.findall(_AXES.sub(r"i\1", name))]


def _quantity(name: str) -> str:
    tokens = set(_tokens(name))
    if tokens & _OTHERS:
        return ""
    found = next((quantity for quantity, words in _WORDS.items() if tokens & words), "")
    found = found or ("q" if tokens & _PLACES else "")
    if tokens & _COMMANDS:
        return f"{found}_cmd" if found in _COMMANDED else ""
    return found


def _unit(quantity: str, name: str) -> str:
    known = _UNITS.get(quantity, {})
    words = re.split(r"[^a-z°]+", name.lower())  # keeps "mA" in one word
    return next((known[word] for word in (*words, *_tokens(name)) if word in known), "")


def _time(table: LogTable) -> str:
    rising = [name for name in _named_as_time(table) if _rises(table, name)]
    if not rising:
        raise LogError(
            f"{table.path}: no column looks like time; it has {table.listing}; name it under "
            "'log.columns.t' of a robot file, or state 'log.rate' [Hz].",
            code="log.no_time",
            where=table.path,
            key="log.columns.t",
        )
    return min(rising, key=len)


def _named_as_time(table: LogTable) -> list[str]:
    return [name for name in table.names if _TIME & set(_tokens(name))]


def _rises(table: LogTable, name: str) -> bool:
    try:
        stamps = table.times(name, 1.0, missing=True)
    except LogError:
        return False
    steps = np.diff(stamps[np.isfinite(stamps)])
    return len(steps) > 1 and bool(np.mean(steps > 0) > 0.9)


def _time_unit(table: LogTable, name: str) -> tuple[str, str]:
    stamps = table.times(name, 1.0, missing=True)
    step = float(np.median(np.diff(stamps[np.isfinite(stamps)])))
    low, high = _RATES
    possible = [u for u, f in OTHERS["t"].items() if low <= 1.0 / max(step * f, 1e-300) <= high]
    said = _unit("t", name)
    if said in possible:
        return said, f"named so: {name}"
    if not possible:
        return "s", "no unit gives a plausible sample rate"
    unit = min(possible, key=lambda u: abs(np.log(step * OTHERS["t"][u] * 200.0)))
    return unit, f"rows are then {step * OTHERS['t'][unit] * 1e3:.3g} ms apart"
