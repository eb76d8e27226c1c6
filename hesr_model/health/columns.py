"""Columns of a log that a robot file leaves open: guessed, tried, and what stays undecided."""

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from hesr_model.errors import LogError
from hesr_model.health.joints import apply_changes
from hesr_model.logs.column_names import UnitSize
from hesr_model.logs.guess import ColumnCandidate, ColumnGuess, guess_columns
from hesr_model.logs.log_format import LogColumns, LogFormat, LogUnits, column_names
from hesr_model.logs.log_table import LogTable
from hesr_model.robots.robot import RobotDescription

_MOTION = ("q", "dq")
_EFFORTS = ("tau", "current")
_OPTIONAL = ("temperature", "q_cmd", "dq_cmd")
_PLACEHOLDER_CONSTANT = 1.0  # of torque, until it is stated


@dataclass(frozen=True, kw_only=True)
class ColumnProposal:
    """A description with columns, reasons by key, and all candidates for its torque or current.

    `refusal` says why a quantity has no columns.
    """

    description: RobotDescription
    reasons: Mapping[str, str] = field(default_factory=dict)
    efforts: Sequence[ColumnCandidate] = ()
    refusal: LogError | None = None


def propose_columns(table: LogTable, description: RobotDescription) -> ColumnProposal:
    """Guess the columns that a robot file does not state and that a table lacks by default.

    Columns with names of the user are kept, also if the table lacks them: reading the log then says
    which one is missing.
    """
    settled = _find_settled(table, description)
    open_quantities = _find_open(description.log, settled)
    if not open_quantities:
        return _add_constants(ColumnProposal(description=description), settled)
    return _guess_open(table, description, settled, open_quantities)


def _guess_open(
    table: LogTable,
    description: RobotDescription,
    settled: Mapping[str, Sequence[str]],
    open_quantities: list[str],
) -> ColumnProposal:
    """Guess columns of quantities, beside those by quantity that are settled."""
    stated = {quantity: names for quantity, names in settled.items() if quantity != "t"}
    refusal = None
    try:
        guess = guess_columns(
            table, description.joints, timed="t" in open_quantities, stated=stated
        )
    except LogError as error:
        if error.code != "log.no_time":
            return ColumnProposal(description=description, refusal=error)
        refusal = error
        guess = guess_columns(table, description.joints, timed=False, stated=stated)
    if "tau" in open_quantities and "tau" in guess.columns:
        # A current needs a constant that nobody stated.
        open_quantities = [name for name in open_quantities if name != "current"]
    candidates = [*open_quantities, *(name for name in _OPTIONAL if name not in settled)]
    guessed = {name: guess.columns[name] for name in candidates if name in guess.columns}
    changes: dict[str, Any] = {}
    reasons: dict[str, str] = {}

    def settle(key: str, value: object, reason: str) -> None:
        changes[key] = value
        reasons[key] = f"likely: {reason}"

    for name, names in guessed.items():
        settle(f"log.columns.{name}", names, guess.reasons.get(name, "it rises"))
    if "dq" in open_quantities and "dq" not in guessed:
        settle("log.columns.dq", "", "no column looks like a velocity")
    for name, unit in _find_units(guess, guessed, description.log.units).items():
        settle(f"log.units.{name}", unit, guess.reasons[name])
    return _add_constants(
        ColumnProposal(
            description=apply_changes(description, changes),
            reasons=reasons,
            efforts=_list_efforts(guess, guessed),
            refusal=refusal,
        ),
        {**settled, **guessed},
    )


def _find_units(
    guess: ColumnGuess, guessed: Container[str], units: LogUnits
) -> dict[str, UnitSize]:
    """Return the units of guessed quantities for which the robot file has the default."""
    return {
        name: unit
        for name, unit in guess.units.items()
        if name in guessed and getattr(units, name) == getattr(LogUnits(), name)
    }


def _list_efforts(guess: ColumnGuess, guessed: Container[str]) -> Sequence[ColumnCandidate]:
    """Return all candidates for the torque or, without one, for the current."""
    for name in _EFFORTS:
        if name in guessed:
            return guess.candidates[name]
    return ()


def _find_settled(table: LogTable, description: RobotDescription) -> dict[str, Sequence[str]]:
    """Return the columns by quantity that the user named, or that the table has by default."""
    columns = description.log.columns
    settled: dict[str, Sequence[str]] = {}
    for quantity in ("t", *_MOTION, *_EFFORTS, *_OPTIONAL):
        pattern = getattr(columns, quantity)
        names = _list_names(quantity, pattern, description.joints)
        is_stated = pattern != getattr(LogColumns(), quantity)
        if is_stated or set(names) <= set(table.names):
            settled[quantity] = names
    return settled


def _list_names(
    quantity: str, pattern: str | tuple[str, ...], joints: Sequence[str]
) -> tuple[str, ...]:
    if not pattern:
        return ()
    if quantity == "t" and isinstance(pattern, str):
        return (pattern,)
    if quantity == "t":
        return tuple(pattern)
    return tuple(column_names(pattern, joints))


def _find_open(log_format: LogFormat, settled: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the quantities that a log needs and that have no columns yet."""
    open_quantities = [quantity for quantity in _MOTION if quantity not in settled]
    if log_format.rate is None and "t" not in settled:
        open_quantities.insert(0, "t")
    has_constants = log_format.torque_per_ampere is not None
    is_current_stated = log_format.columns.current != LogColumns().current
    has_effort = "tau" in settled or ("current" in settled and (has_constants or is_current_stated))
    if log_format.cylinder is None and not has_effort:
        open_quantities += _EFFORTS
    return open_quantities


def _add_constants(
    proposal: ColumnProposal, columns: Mapping[str, str | Sequence[str]]
) -> ColumnProposal:
    """Add guessed torque constants if only currents have columns."""
    description = proposal.description
    log_format = description.log
    needs_constants = "current" in columns and "tau" not in columns
    if not needs_constants or log_format.torque_per_ampere is not None or log_format.cylinder:
        return proposal
    changes = {
        "log.torque_per_ampere": (_PLACEHOLDER_CONSTANT,) * len(description.joints),
        "sources.torque_per_ampere": "guessed",
    }
    reason = "guess: only currents are logged"
    return replace(
        proposal,
        description=apply_changes(description, changes),
        reasons={**proposal.reasons, "log.torque_per_ampere": reason},
    )
