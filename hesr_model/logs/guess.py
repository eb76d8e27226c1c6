"""Guesses of the columns of an unknown table."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.log_table import LogTable
from hesr_model.units import COMMON_UNITS


def _split_words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_QUANTITY_WORDS: Mapping[str, frozenset[str]] = {
    "temperature": _split_words("temperature temperatures temp temps"),
    "dq": _split_words(
        "dq qd qdot dqdt vel velocity velocities speed speeds omega qp geschwindigkeit drehzahl"
    ),
    "q": _split_words(
        "q pos position positions angle angles theta qm encoder enc displacement winkel weg"
    ),
    "tau": _split_words(
        "tau torque torques trq effort efforts moment moments drehmoment tq nm force forces kraft"
    ),
    "current": _split_words("i im cur curr current currents amp amps ampere iq strom motorstrom"),
}  # Words in column names; the first match wins
# Torques of sliding joints, unless a torque is logged.
_FORCE_WORDS = _split_words("force forces kraft")
_COMMANDED_QUANTITIES = ("q", "dq")  # quantities whose commands are read
_JOINT_WORDS = _split_words("joint axis")  # positions, unless another quantity matches
_COMMAND_WORDS = _split_words("target desired des ref reference cmd command setpoint goal")
_IGNORED_WORDS = _split_words(
    "acc acceleration ddq qdd error err tcp ext external voltage control window limit mode status "
    "dir"
)
_MOTOR_WORDS = _split_words("qm motor motors")
_MEASURED_WORDS = _split_words("actual act meas measured msr")
_TIME_WORDS = _split_words(
    "t time timestamp stamp timestamps datetime date clock unix secs seconds sec zeit"
)
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
_PLAUSIBLE_RATES = (5.0, 20_000.0)  # plausible sample rates [Hz]


@dataclass(frozen=True, kw_only=True)
class ColumnGuess:
    """Columns (a name for t, else one per joint), units and reasons by quantity."""

    columns: Mapping[str, str | tuple[str, ...]]
    units: Mapping[str, str] = field(default_factory=dict)
    reasons: Mapping[str, str] = field(default_factory=dict)


def guess_columns(
    table: LogTable, joints: Sequence[str] = (), *, timed: bool = True
) -> ColumnGuess:
    """Guess columns, maybe with names of `joints`, and time if `timed`; raises LogError."""
    groups = list(_group_names(table.names, joints))
    joint_count = len(joints) or max(
        (len(group) for _, group in groups if _recognise_quantity(group[0]) == "q"), default=0
    )
    position_names = [name for name in table.names if _recognise_quantity(name) == "q"]
    if (
        joint_count < 2
        and not any(_recognise_quantity(group[0]) == "q" for _, group in groups)
        and len(position_names) == 1
    ):
        groups = [("", (name,)) for name in table.names]
        joint_count = 1
    columns: dict[str, str | tuple[str, ...]] = {}
    units = {}
    reasons = {}
    for quantity in (*_QUANTITY_WORDS, *(f"{name}_cmd" for name in _COMMANDED_QUANTITIES)):
        candidate_groups = [
            group
            for _, group in groups
            if _recognise_quantity(group[0]) == quantity and len(group) >= joint_count > 0
        ]
        if not candidate_groups and joints:
            quantity_names = tuple(
                name for name in table.names if _recognise_quantity(name) == quantity
            )
            # Mixed names, as q_lift, q_1, q_2.
            candidate_groups = [quantity_names] * (len(quantity_names) == joint_count)
        if candidate_groups:
            best_group = min(
                candidate_groups,
                key=lambda group: (
                    not _FORCE_WORDS.isdisjoint(_split_tokens(group[0])),
                    _MEASURED_WORDS.isdisjoint(_split_tokens(group[0])),
                    len(group),
                    len(group[0]),
                ),
            )
            columns[quantity] = tuple(best_group[:joint_count])
            reasons[quantity] = f"named so: {best_group[0]}"
            unit = _recognise_unit(quantity, best_group[0])
            if unit:
                units[quantity] = unit
    if timed or any(_rises(table, name) for name in _find_time_names(table)):
        columns["t"] = _find_time(table)
        units["t"], reasons["t"] = _guess_time_unit(table, str(columns["t"]))
    if "q" not in columns:
        joint_text = "a joint" if joint_count < 2 else f"all {joint_count} joints"
        raise LogError(
            f"{table.path}: no columns look like positions of {joint_text}; it has "
            f"{table.listing}; name them under 'log.columns' of a robot file.",
            code="log.no_positions",
            where=table.path,
            key="log.columns",
        )
    return ColumnGuess(columns=columns, units=units, reasons=reasons)


def is_of_motor(name: str) -> bool:
    """Return whether a column is named like a motor's."""
    return not _MOTOR_WORDS.isdisjoint(_split_tokens(name))


def _group_names(
    names: Sequence[str], joints: Sequence[str]
) -> Iterator[tuple[str, tuple[str, ...]]]:
    numbered: dict[str, dict[int, str]] = {}
    named: dict[str, dict[int, str]] = {}
    for name in names:
        for match in _NUMBER.finditer(name):
            key = f"{name[: match.start()]}{{}}{name[match.end() :]}"
            numbered.setdefault(key, {})[int(match[0])] = name
        for number, joint in enumerate(joints):
            if joint in name:
                named.setdefault(name.replace(joint, "{name}", 1), {})[number] = name
    for key, names_by_number in (*named.items(), *numbered.items()):
        numbers = sorted(names_by_number)
        if len(numbers) > 1 or len(joints) == 1:
            yield key, tuple(names_by_number[number] for number in numbers)


def _split_tokens(name: str) -> list[str]:
    return [token.lower() for token in _TOKEN.findall(_AXES.sub(r"i\1", name))]


def _recognise_quantity(name: str) -> str:
    tokens = set(_split_tokens(name))
    if tokens & _IGNORED_WORDS:
        return ""
    quantity = next(
        (candidate for candidate, words in _QUANTITY_WORDS.items() if tokens & words), ""
    )
    quantity = quantity or ("q" if tokens & _JOINT_WORDS else "")
    if tokens & _COMMAND_WORDS:
        return f"{quantity}_cmd" if quantity in _COMMANDED_QUANTITIES else ""
    return quantity


def _recognise_unit(quantity: str, name: str) -> str:
    units = _UNITS.get(quantity, {})
    words = re.split(r"[^a-z°]+", name.lower())  # keeps "mA" in one word
    return next((units[word] for word in (*words, *_split_tokens(name)) if word in units), "")


def _find_time(table: LogTable) -> str:
    rising_names = [name for name in _find_time_names(table) if _rises(table, name)]
    if not rising_names:
        raise LogError(
            f"{table.path}: no column looks like time; it has {table.listing}; name it under "
            "'log.columns.t' of a robot file, or state 'log.rate' [Hz].",
            code="log.no_time",
            where=table.path,
            key="log.columns.t",
        )
    return min(rising_names, key=len)


def _find_time_names(table: LogTable) -> list[str]:
    return [name for name in table.names if _TIME_WORDS & set(_split_tokens(name))]


def _rises(table: LogTable, name: str) -> bool:
    try:
        stamps = table.times(name, 1.0, missing=True)
    except LogError:
        return False
    steps = np.diff(stamps[np.isfinite(stamps)])
    return len(steps) > 1 and bool(np.mean(steps > 0) > 0.9)


def _guess_time_unit(table: LogTable, name: str) -> tuple[str, str]:
    stamps = table.times(name, 1.0, missing=True)
    period = float(np.median(np.diff(stamps[np.isfinite(stamps)])))
    lowest_rate, highest_rate = _PLAUSIBLE_RATES
    plausible_units = [
        candidate
        for candidate, factor in COMMON_UNITS["t"].items()
        if lowest_rate <= 1.0 / max(period * factor, 1e-300) <= highest_rate
    ]
    named_unit = _recognise_unit("t", name)
    if named_unit in plausible_units:
        return named_unit, f"named so: {name}"
    if not plausible_units:
        return "s", "no unit gives a plausible sample rate"
    unit = min(
        plausible_units,
        key=lambda candidate: abs(np.log(period * COMMON_UNITS["t"][candidate] * 200.0)),
    )
    return unit, f"rows are then {period * COMMON_UNITS['t'][unit] * 1e3:.3g} ms apart"
