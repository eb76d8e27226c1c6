"""Errors of all commands as sentences, on outputs without UTF-8 as well."""

import codecs
import os
import sys
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import NoReturn

import click

from hesr_model.errors import ConfigError, HesrError
from hesr_model.support.text import plain

_NEW_FORMS = {
    "laws": "hesr fit --list",
    "evaluate": "hesr test LAW... --on LOG",
    "replay": "hesr test X.fmu --on LOG",
    "properties": "hesr test LAW... --kind properties",
    "audit": "hesr test LAW... --kind passivity",
    "arena": "hesr test X.fmu... --on LEADERBOARD.toml -o board.html",
    "constants": "hesr inspect LOG... --robot ROBOT --torque-constants",
    "thermal": "hesr fit LOG... --law law.json --add temperature -o warm.json",
    "sweep": "hesr simulate SWEEP.toml -o FOLDER, or --only RUN -o run.csv for one run",
    "fleet": "hesr monitor FLEET.toml -o FOLDER",
    "package": "hesr export SYSTEM.toml -o X.ssp, or -o X.fmu for one FMU",
    "results": "hesr report RESULT... -o X.md",
    "view": "hesr report RESULT --view, or -o arm.mp4 for a video",
    "interop": "make interop, in a checkout of HESR",
}
MOVED = {verb: f"'hesr {verb}' is now: {form}." for verb, form in _NEW_FORMS.items()}
"""New form of each verb of earlier versions."""

_REFUSED = 2
_UNREAD = 1  # exit code after the reader of the output has closed it, as Click's
_LONGEST = 4000  # characters of a sentence: file names may be of any length

_LEAST_MEMORY, _LEAST_FILES = 1 << 30, 64  # limits that libraries need [bytes, open at a time]
_LAST_DATE = 253402300799  # [s] of SOURCE_DATE_EPOCH

_PLAIN = str.maketrans("✓✗–—‘’“”→·×µμ", "+x--''\"\">.xuu")
"""Replacements, of the same width, for characters that the output cannot encode."""


@contextmanager
def errors_said() -> Iterator[None]:
    """Print every error as one sentence and exit with 2; bugs keep their traceback.

    These include errors that readers do not report, such as a full disk.
    """
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except HesrError as error:
        refuse(str(error))
    except BrokenPipeError:
        _give_up_output()
        sys.exit(_UNREAD)
    except OSError as error:
        where = f"{plain(error.filename)}: " if isinstance(error.filename, str) else ""
        reason = " ".join((error.strerror or str(error)).split()).rstrip(".")
        _give_up_output()
        refuse(f"{where}the system reports an error ({reason}).")
    except MemoryError:
        refuse("not enough memory; give less data at once.")
    except RecursionError:
        refuse("an input file is nested too deeply.")


def require_environment() -> None:
    """Refuse limits and dates that make libraries crash, hang or raise SIGINT."""
    date = os.environ.get("SOURCE_DATE_EPOCH", "0")
    if not (date.isascii() and date.isdigit() and int(date) <= _LAST_DATE):
        raise ConfigError(f"SOURCE_DATE_EPOCH is '{date}'; expected whole seconds since 1970.")
    with suppress(ImportError):  # Windows has no such limits
        import resource

        for kind, least, name, unit, option in (
            (resource.RLIMIT_AS, _LEAST_MEMORY, "memory", " MB", "v"),
            (resource.RLIMIT_NOFILE, _LEAST_FILES, "open files", "", "n"),
        ):
            limit = resource.getrlimit(kind)[0]
            if limit != resource.RLIM_INFINITY and limit < least:
                scale = 10**6 if unit else 1
                raise ConfigError(
                    f"the limit of {name} is {limit // scale}{unit}; at least "
                    f"{least // scale}{unit} are needed (ulimit -{option})."
                )


def refuse(sentence: str) -> NoReturn:
    """Print a sentence and exit with the code of bad input."""
    click.echo(f"hesr: {plain(sentence, _LONGEST)}", err=True)
    sys.exit(_REFUSED)


def _give_up_output() -> None:
    """Discard unwritten output, which Python would try to write again when it ends."""
    with suppress(OSError, ValueError):
        sys.stdout.flush()
    with suppress(OSError, ValueError):  # not a file descriptor
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def home_where_needed() -> None:
    """Give Matplotlib a folder if HOME is not writable, since it would print a warning."""
    if not os.access(os.environ.get("HOME", ""), os.W_OK | os.X_OK):
        from hesr_model.support.cache import folder

        os.environ.setdefault("MPLCONFIGDIR", str(folder() / "matplotlib"))


def plain_where_needed() -> None:
    """Let standard output and error accept any text; outputs without UTF-8 get ASCII."""
    codecs.register_error("hesr.plain", _plainly)
    for stream in (sys.stdout, sys.stderr):
        if reconfigure := getattr(stream, "reconfigure", None):
            reconfigure(errors="hesr.plain")


def _plainly(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = unicodedata.normalize("NFKD", error.object[error.start : error.end]).translate(_PLAIN)
    return "".join(c if c.isascii() else "?" for c in text), error.end
