"""Guesses of the columns of an unknown table: candidates by name, then tried against each other."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, product
from typing import NamedTuple

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.bursts import find_period
from hesr_model.logs.column_names import (
    BY_LETTER,
    BY_UNIT,
    COMMANDED_QUANTITIES,
    FORCE_WORDS,
    FRACTION_ENDINGS,
    MEASURED_WORDS,
    SECONDS_ENDINGS,
    TIME_WORDS,
    Reading,
    UnitSize,
    find_fraction_unit,
    read_name,
    read_unit,
    simplify_name,
    split_tokens,
)
from hesr_model.logs.kinematics import DerivativeMatch, match_derivative
from hesr_model.logs.log_table import LogTable, TextCell, is_seconds_and_fraction
from hesr_model.support.arrays import Array
from hesr_model.units import COMMON_UNITS, find_si_factor

_NUMBER = re.compile(r"(?<!\d)\d{1,9}(?!\d)")  # a joint number; longer ones are slow to parse
_PLAUSIBLE_RATES = (5.0, 20_000.0)  # plausible sample rates [Hz]
_MAX_CANDIDATES = 8  # of a quantity that are tried
_MAX_LOG_RATIO = 0.1  # of a derivative and a velocity in the units of their names
_QUANTITIES = ("temperature", "dq", "q", "tau", "current")
_MAX_FAULTS = 2  # columns named like time whose faults a refusal tells
_MIN_BURSTS = 20  # stamps that tell a column of time with repeated stamps
_SUPPLY_WORDS = frozenset(("id", "bus", "supply", "dc", "battery", "input"))


@dataclass(frozen=True, kw_only=True)
class ColumnCandidate:
    """Columns that may be a quantity, one per joint.

    Attributes
    ----------
    names : names of the columns, in the order of the joints.
    unit : name, or size in SI; empty for SI.
    order : key by which the likelier one of two candidates is the smaller, by their names.
    reason : why the columns may be the quantity.
    """

    quantity: str
    names: tuple[str, ...]
    unit: UnitSize
    order: tuple[int | bool, ...]
    reason: str

    @property
    def rank(self) -> int:
        """How sure the reading of the names is."""
        return int(self.order[0])


@dataclass(frozen=True, kw_only=True)
class ColumnGuess:
    """Columns (a name for t, else one per joint), units and reasons by quantity.

    `t` may be a pair of seconds and nanoseconds, and `q` is empty if only velocities were found.
    `candidates` are all that the names allow, by quantity, the likeliest first.
    """

    columns: Mapping[str, str | tuple[str, ...]]
    units: Mapping[str, UnitSize] = field(default_factory=dict)
    reasons: Mapping[str, str] = field(default_factory=dict)
    candidates: Mapping[str, Sequence[ColumnCandidate]] = field(default_factory=dict)

    @property
    def joint_count(self) -> int:
        """Number of joints."""
        return len(self.columns["q"] or self.columns["dq"])


class _Group(NamedTuple):
    """Columns that differ in a number or in the name of a joint, which `key` leaves out."""

    key: str
    names: tuple[str, ...]


def guess_columns(
    table: LogTable,
    joints: Sequence[str] = (),
    *,
    timed: bool = True,
    stated: Mapping[str, Sequence[str]] | None = None,
) -> ColumnGuess:
    """Guess columns, maybe with names of `joints`, and time if `timed`; raises LogError.

    A unit in a name outranks any word. Of several positions and velocities, those are chosen of
    which one is the derivative of the other. Columns that are `stated`, by quantity, are kept.
    """
    columns: dict[str, str | tuple[str, ...]] = {}
    units: dict[str, UnitSize] = {}
    reasons: dict[str, str] = {}
    if timed or any(_rises(table, name) for name in _find_time_names(table)):
        time_name = _find_time(table)
        columns["t"] = time_name
        units["t"], reasons["t"] = _guess_time_unit(table, time_name)
        stamps = table.times(time_name, 1.0, missing=True)
    else:
        stamps = np.arange(table.rows, dtype=float)
    time_names = columns.get("t", ())
    if isinstance(time_names, str):
        time_names = (time_names,)
    candidates = _find_candidates(table, joints, without=time_names)
    candidates = _keep_stated(candidates, stated or {})
    time_size = float(find_si_factor("t", units.get("t", "s")))
    chosen = _choose_motion(table, stamps, time_size, candidates)
    for quantity, quantity_candidates in candidates.items():
        if quantity not in ("q", "dq"):
            chosen[quantity] = quantity_candidates[0]
    if "q" not in chosen and "dq" not in chosen:
        raise _report_no_positions(table, joints)
    for quantity, candidate in chosen.items():
        columns[quantity] = candidate.names
        reasons[quantity] = candidate.reason
        if candidate.unit:
            units[quantity] = candidate.unit
    if "q" not in chosen:
        columns["q"] = ""
        reasons["q"] = "no column looks like a position; it is the integral of the velocity"
    return ColumnGuess(columns=columns, units=units, reasons=reasons, candidates=candidates)


def _report_no_positions(table: LogTable, joints: Sequence[str]) -> LogError:
    joint_text = "a joint" if len(joints) < 2 else f"all {len(joints)} joints"
    return LogError(
        f"{table.path}: no columns look like positions or velocities of {joint_text}; it has "
        f"{table.listing}; name them under 'log.columns' of a robot file.",
        code="log.no_positions",
        where=table.path,
        key="log.columns",
    )


def _find_candidates(
    table: LogTable, joints: Sequence[str], without: Sequence[str]
) -> dict[str, Sequence[ColumnCandidate]]:
    """Return candidates by quantity, `without` some columns, the likeliest by name first."""
    # Of one joint, a column counts as itself: in 'speed [1/min]' the number is that of a unit.
    groups = [_Group(name, (name,)) for name in table.names]
    groups += [_Group(key, names) for key, names in _group_names(table.names, joints)]
    readings = {
        group.key: read_name(_label(table, *group)) or _read_bare_joint(group, joints)
        for group in groups
    }
    joint_count = len(joints) or _count_joints(groups, readings)
    candidates: dict[str, list[ColumnCandidate]] = {}
    for group in groups:
        if len(group.names) < joint_count or not set(without).isdisjoint(group.names):
            continue
        for reading in readings[group.key]:
            candidate = _build_candidate(group, reading, joint_count)
            of_quantity = candidates.setdefault(reading.quantity, [])
            if all(candidate.names != other.names for other in of_quantity):
                of_quantity.append(candidate)
    if joints:
        free_names = [name for name in table.names if name not in without]
        _add_mixed_names(free_names, joint_count, candidates)
    quantities = (*_QUANTITIES, *(f"{name}_cmd" for name in COMMANDED_QUANTITIES))
    return {
        quantity: sorted(candidates[quantity], key=lambda candidate: candidate.order)[
            :_MAX_CANDIDATES
        ]
        for quantity in quantities
        if quantity in candidates
    }


def _label(table: LogTable, key: str, names: Sequence[str]) -> str:
    """Return the key of columns, with the unit of their cells if all have the same."""
    units = {table.units.get(name, "") for name in names}
    unit = units.pop()
    return f"{key} [{unit}]" if unit and not units else key


def _keep_stated(
    candidates: Mapping[str, Sequence[ColumnCandidate]], stated: Mapping[str, Sequence[str]]
) -> dict[str, Sequence[ColumnCandidate]]:
    """Return the stated columns, and the candidates for other quantities."""
    stated_names = set(chain.from_iterable(stated.values()))
    remaining: dict[str, Sequence[ColumnCandidate]] = {}
    for quantity, quantity_candidates in candidates.items():
        free_candidates = [
            candidate
            for candidate in quantity_candidates
            if stated_names.isdisjoint(candidate.names)
        ]
        if free_candidates and quantity not in stated:
            remaining[quantity] = free_candidates
    for quantity, names in stated.items():
        remaining[quantity] = [
            ColumnCandidate(
                quantity=quantity, names=tuple(names), unit="", order=(BY_UNIT,), reason="stated"
            )
        ]
    return remaining


def _read_bare_joint(group: _Group, joints: Sequence[str]) -> list[Reading]:
    """Return the readings of columns that are called as the joints: positions, if nothing else."""
    if not joints or split_tokens(group.key):
        return []
    return read_name(group.names[0])


def _add_mixed_names(
    all_names: Sequence[str], joint_count: int, candidates: dict[str, list[ColumnCandidate]]
) -> None:
    """Add candidates of mixed names, as q_lift, q_1, q_2, where no pattern has enough columns."""
    names_by_quantity: dict[str, list[str]] = {}
    readings: dict[str, Reading] = {}
    for name in all_names:
        for reading in read_name(name)[:1]:
            names_by_quantity.setdefault(reading.quantity, []).append(name)
            readings.setdefault(reading.quantity, reading)
    for quantity, names in names_by_quantity.items():
        if quantity not in candidates and len(names) == joint_count:
            group = _Group(names[0], tuple(names))
            candidates[quantity] = [_build_candidate(group, readings[quantity], joint_count)]


def _build_candidate(group: _Group, reading: Reading, joint_count: int) -> ColumnCandidate:
    tokens = split_tokens(group.key)
    how = "by its unit" if reading.rank == BY_UNIT else "named so"
    return ColumnCandidate(
        quantity=reading.quantity,
        names=tuple(group.names[:joint_count]),
        unit=reading.unit,
        order=(
            reading.rank,
            not FORCE_WORDS.isdisjoint(tokens),
            not _SUPPLY_WORDS.isdisjoint(tokens),
            MEASURED_WORDS.isdisjoint(tokens),
            len(group.names),
            len(group.key),
        ),
        reason=f"{how}: {group.names[0]}",
    )


def _count_joints(groups: Sequence[_Group], readings: Mapping[str, list[Reading]]) -> int:
    """Return the number of joints for which most quantities have columns, the larger of equals."""
    best_count = 0
    best_quantity_count = 0
    for joint_count in sorted({len(group.names) for group in groups}):
        quantities = {
            readings[group.key][0].quantity
            for group in groups
            if len(group.names) >= joint_count and readings[group.key]
        }
        quantity_count = len(quantities & {"q", "dq"}) + bool(quantities & {"tau", "current"})
        if quantity_count and quantity_count >= best_quantity_count:
            best_count = joint_count
            best_quantity_count = quantity_count
    return best_count


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pair:
    """A position and a velocity, and how well the one predicts the other."""

    position: ColumnCandidate
    velocity: ColumnCandidate
    match: DerivativeMatch

    def fits_units(self, time_size: float) -> bool:
        """Return whether the derivative equals the velocity in the units of the names."""
        position_size = _find_size(self.position)
        velocity_size = _find_size(self.velocity)
        ratio = abs(self.match.factor) * position_size / (velocity_size * time_size)
        return ratio > 0.0 and abs(np.log(ratio)) < _MAX_LOG_RATIO


def _find_size(candidate: ColumnCandidate) -> float:
    """Return the size in SI of a candidate's unit."""
    if not candidate.unit:
        return 1.0
    return float(find_si_factor(candidate.quantity, candidate.unit))


def _choose_motion(
    table: LogTable,
    stamps: Array,
    time_size: float,
    candidates: Mapping[str, Sequence[ColumnCandidate]],
) -> dict[str, ColumnCandidate]:
    """Return position and velocity: by names, unless the one is the derivative of another one."""
    positions = candidates.get("q", ())
    velocities = candidates.get("dq", ())
    firsts = (*positions[:1], *velocities[:1])
    by_name = {candidate.quantity: candidate for candidate in firsts}
    has_letters = any(candidate.rank >= BY_LETTER for candidate in by_name.values())
    if len(by_name) < 2 or (len(positions) == len(velocities) == 1 and not has_letters):
        return by_name
    pairs = [
        _Pair(position=q, velocity=dq, match=_match_columns(table, stamps, q.names, dq.names))
        for q, dq in product(positions, velocities)
        if set(q.names).isdisjoint(dq.names)
    ]
    explaining = [pair for pair in pairs if pair.match.explains]
    if not explaining:
        return _drop_letters(by_name)
    best = min(explaining, key=lambda pair: pair.match.share)
    contenders = [pair for pair in explaining if not best.match.beats(pair.match)]
    chosen = min(
        contenders,
        # Motors and joints behind a gear match each other, in other units than those of the names.
        key=lambda pair: (
            not pair.fits_units(time_size),
            pair.position.order,
            pair.velocity.order,
        ),
    )
    others = {candidate.names for candidate in (*positions, *velocities)}
    others -= {chosen.position.names, chosen.velocity.names}
    if not others:
        return {"q": chosen.position, "dq": chosen.velocity}
    return {
        "q": replace(
            chosen.position,
            reason=f"{chosen.position.reason}; {chosen.velocity.names[0]} is its derivative",
        ),
        "dq": replace(
            chosen.velocity,
            reason=f"{chosen.velocity.reason}; it is the derivative of {chosen.position.names[0]}",
        ),
    }


def _drop_letters(by_name: dict[str, ColumnCandidate]) -> dict[str, ColumnCandidate]:
    """Drop what only a letter names, unless nothing else is left."""
    named = {
        quantity: candidate for quantity, candidate in by_name.items() if candidate.rank < BY_LETTER
    }
    return named or {"q": by_name["q"]}


def _match_columns(
    table: LogTable, stamps: Array, q_names: Sequence[str], dq_names: Sequence[str]
) -> DerivativeMatch:
    try:
        q = table.numbers(q_names, missing=True)
        dq = table.numbers(dq_names, missing=True)
    except LogError:  # of columns with text, which cannot be chosen
        return DerivativeMatch(factor=0.0, errors=np.ones(1))
    return match_derivative(stamps, q, dq)


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
                named.setdefault(name.replace(joint, "{}", 1), {})[number] = name
    for key, names_by_number in (*named.items(), *numbered.items()):
        numbers = sorted(names_by_number)
        if len(numbers) > 1 or len(joints) == 1:
            yield key, tuple(names_by_number[number] for number in numbers)


def _find_time(table: LogTable) -> str | tuple[str, str]:
    pairs = [pair for pair in _find_time_pairs(table) if _rises(table, pair)]
    if pairs:
        return min(pairs)
    time_names = _find_time_names(table)
    rising_names = [name for name in time_names if _rises(table, name)]
    rising_names = rising_names or [name for name in time_names if _rises_in_bursts(table, name)]
    if not rising_names:
        faults = [_describe_time(table, name) for name in time_names[:_MAX_FAULTS]]
        raise LogError(
            f"{table.path}: no column looks like time{''.join(faults)}; it has {table.listing}; "
            "name it under 'log.columns.t' of a robot file, or state 'log.rate' [Hz].",
            code="log.no_time",
            where=table.path,
            key="log.columns.t",
        )
    return min(rising_names, key=len)


def _find_time_names(table: LogTable) -> list[str]:
    return [
        name
        for name in table.names
        if TIME_WORDS & set(split_tokens(name))
        or (read_unit(name) or ("",))[0] == "t"
        or _holds_dates(table, name)
    ]


def _holds_dates(table: LogTable, name: str) -> bool:
    cells = table.arrays(table.names.index(name))
    return not isinstance(cells, TextCell) and cells.dtype.kind == "M"


def _find_time_pairs(table: LogTable) -> list[tuple[str, str]]:
    """Return columns of whole seconds with columns of the nanoseconds since, as of ROS."""
    fraction_endings = tuple(chain.from_iterable(FRACTION_ENDINGS.values()))
    seconds_by_stem = _find_stems(table.names, SECONDS_ENDINGS)
    fractions_by_stem = _find_stems(table.names, fraction_endings)
    pairs = []
    for stem, seconds in seconds_by_stem.items():
        fraction = fractions_by_stem.get(stem, seconds)
        if fraction != seconds and _is_pair(table, seconds, fraction):
            pairs.append((seconds, fraction))
    return pairs


def _find_stems(names: Sequence[str], endings: Sequence[str]) -> dict[str, str]:
    """Return the names that have one of some endings, by what is before it in lower case."""
    stems = {}
    for name in names:
        plain = simplify_name(name)
        for ending in sorted(endings, key=len, reverse=True):
            if plain.endswith(ending):
                stems[plain.removesuffix(ending)] = name
                break
    return stems


def _is_pair(table: LogTable, seconds: str, fraction: str) -> bool:
    try:
        values = table.numbers((seconds, fraction), missing=True)
    except LogError:
        return False
    return is_seconds_and_fraction(values, find_fraction_unit(fraction))


def _rises(table: LogTable, name: str | tuple[str, str]) -> bool:
    try:
        stamps = table.times(name, 1.0, missing=True)
    except LogError:
        return False
    steps = np.diff(stamps[np.isfinite(stamps)])
    return len(steps) > 1 and bool(np.mean(steps > 0) > 0.9)


def _describe_time(table: LogTable, name: str) -> str:
    """Return why a column that is named like time is none."""
    cells = table.arrays(table.names.index(name))
    if isinstance(cells, TextCell):
        return f", '{name}' holds {cells.text!r} where {cells.expected} is needed"
    return f", '{name}' does not rise"


def _rises_in_bursts(table: LogTable, name: str) -> bool:
    """Return whether stamps rise, but for rows that repeat the stamp of the row before."""
    try:
        stamps = table.times(name, 1.0, missing=True)
    except LogError:
        return False
    steps = np.diff(stamps[np.isfinite(stamps)])
    has_bursts = np.count_nonzero(steps > 0.0) >= _MIN_BURSTS
    return bool(has_bursts and np.all(steps >= 0.0))


def _guess_time_unit(table: LogTable, name: str | tuple[str, str]) -> tuple[str, str]:
    if not isinstance(name, str):
        return "s", f"whole seconds, and {find_fraction_unit(name[1])} since: {', '.join(name)}"
    stamps = table.times(name, 1.0, missing=True)
    period = find_period(stamps[np.isfinite(stamps)])
    lowest_rate, highest_rate = _PLAUSIBLE_RATES
    plausible_units = [
        candidate
        for candidate, factor in COMMON_UNITS["t"].items()
        if lowest_rate <= 1.0 / max(period * factor, 1e-300) <= highest_rate
    ]
    quantity, unit = read_unit(_label(table, name, (name,))) or ("", "")
    named_unit = unit or "s"
    if quantity == "t" and named_unit in plausible_units:
        return str(named_unit), f"named so: {name}"
    if not plausible_units:
        return "s", "no unit gives a plausible sample rate"
    unit = min(
        plausible_units,
        key=lambda candidate: abs(np.log(period * COMMON_UNITS["t"][candidate] * 200.0)),
    )
    return unit, f"rows are then {period * COMMON_UNITS['t'][unit] * 1e3:.3g} ms apart"
