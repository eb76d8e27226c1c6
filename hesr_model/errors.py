"""Errors that a user can cause.

Each carries one sentence that names the file, the column or key, the row where it applies, what
was found and what is needed. The command line prints that sentence and exits with 2.
"""

import re

from hesr_model.support.text import escaped

_LONGEST = 2000  # characters of a sentence; what a file holds may have millions


class HesrError(Exception):
    """Base of every error that a user can cause and mend.

    Its sentence may quote what stands in a file: it is shortened, and characters that cannot be
    printed are escaped.
    """

    def __init__(self, sentence: str) -> None:
        if len(sentence) > _LONGEST:
            sentence = f"{sentence[: _LONGEST // 2]} ... {sentence[-_LONGEST // 2 :]}"
        super().__init__("\n".join(map(escaped, sentence.split("\n"))))


class ConfigError(HesrError):
    """A TOML file or a command-line argument does not say what is needed."""


class ArgumentError(ConfigError):
    """Arguments of a call, or options of a command, that do not go together.

    Its sentence quotes parameters by their names in Python.
    """

    def on_command_line(self) -> str:
        """Return the sentence with the parameters as options."""
        return re.sub(r"'([a-z_]+)'", lambda m: f"--{m[1].replace('_', '-')}", str(self))


class LogError(HesrError):
    """A robot log cannot be used as it is."""


class TableError(HesrError, ValueError, TypeError):
    """A table in memory cannot be used; also what libraries of estimators expect to be raised."""


class RobotError(HesrError):
    """A robot description and its kinematic model do not fit together."""


class FitError(HesrError):
    """The data do not determine what was to be estimated."""


class ArtifactError(HesrError):
    """A saved result cannot be read or written."""


class ExportError(HesrError):
    """An FMU cannot be built from the given model."""


class SimulationError(HesrError):
    """A component or a system of FMUs failed while it was running."""


class WorkerError(HesrError):
    """A worker process ended before its job was done."""
