"""Errors that a user can cause: one sentence each, with place, value found and value needed."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Self

from hesr_model.support.text import escape

_MAX_SENTENCE_LENGTH = 2000  # characters of a sentence; a file may contain millions


class HesrError(Exception):
    """Base of user errors; quoted files are shortened and escaped.

    Programs compare attributes, since sentences may change.

    Attributes
    ----------
    code : str
        Name of the rule that was broken, such as ``"log.unit"``; empty if the
        rule has no name.
    where : str
        File, or other place, of the offending value; may be empty.
    key : str
        Key within `where`, such as ``"log.units.q"``; empty if the whole file
        is refused.
    """

    def __init__(
        self, sentence: str, *, code: str = "", where: str | Path = "", key: str = ""
    ) -> None:
        if len(sentence) > _MAX_SENTENCE_LENGTH:
            sentence = (
                f"{sentence[: _MAX_SENTENCE_LENGTH // 2]} ... "
                f"{sentence[-_MAX_SENTENCE_LENGTH // 2 :]}"
            )
        super().__init__("\n".join(map(escape, sentence.split("\n"))))
        self.code = code
        self.where = str(where)
        self.key = key

    def add_place(self, where: str | Path) -> Self:
        """Return the same error, with a place in front of its sentence."""
        return type(self)(f"{where}: {self}", code=self.code, where=where, key=self.key)

    def format_for_command_line(self, options: Mapping[str, str]) -> str:  # noqa: ARG002  # overridden
        """Return the sentence with options for parameters, if it names any."""
        return str(self)


class RuleError(ValueError):
    """A value breaks a rule of its schema; a reader adds the place and raises a `HesrError`.

    `key` is relative to the object that is validated: empty for the validator of one field.
    """

    def __init__(self, reason: str, *, code: str, key: str = "") -> None:
        super().__init__(reason)
        self.code = code
        self.key = key


class ConfigError(HesrError):
    """A TOML file or an argument is invalid."""


class ArgumentError(ConfigError):
    """Arguments, quoted by their Python names, are contradictory."""

    def format_for_command_line(self, options: Mapping[str, str]) -> str:
        """Return the sentence with options for parameters."""
        return re.sub(r"'([a-z_]+)'", lambda match: options.get(match[1], match[0]), str(self))


class LogError(HesrError):
    """A robot log cannot be used."""


class TableError(HesrError, ValueError, TypeError):
    """A table in memory cannot be used; also the types scikit-learn expects."""


class RobotError(HesrError):
    """A robot description does not match its model file."""


class FitError(HesrError):
    """The data do not determine the unknowns."""


class ArtifactError(HesrError):
    """A saved result cannot be read or written."""


class ExportError(HesrError):
    """An FMU cannot be built."""


class SimulationError(HesrError):
    """A component or a system of FMUs failed."""


class WorkerError(HesrError):
    """A worker process ended before its job."""
