"""What every command does at its very end: say what went wrong, also where text is not UTF-8."""

import codecs
import os
import sys
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import NoReturn

import click

from hesr_model.errors import HesrError
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
"""Sentence with the new form of each verb of earlier versions."""

_REFUSED = 2
_UNREAD = 1
"""Exit code where whoever reads the output has gone, as of Click."""

_LONGEST = 4000  # characters of a sentence: names of files may be of anything and of any length

_PLAIN = str.maketrans("✓✗–—‘’“”→·×µμ", "+x--''\"\">.xuu")
"""What stands for marks where an output has only some of all characters; each is as wide."""


@contextmanager
def errors_said() -> Iterator[None]:
    """Say every error in one sentence and exit with 2, other ones than bugs.

    What a file or the data in it is to blame for is found out where it is read. This is for what
    may happen everywhere: a disk that is full, memory that does not suffice.
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
        refuse("memory does not suffice for this; give less data at once, or a machine with more.")
    except RecursionError:
        refuse("a file that was read is nested too deeply.")


def refuse(sentence: str) -> NoReturn:
    """Print a sentence and exit with the code of bad input."""
    click.echo(f"hesr: {plain(sentence, _LONGEST)}", err=True)
    sys.exit(_REFUSED)


def _give_up_output() -> None:
    """Send what could not be written to nowhere, or Python tries again when it ends."""
    with suppress(OSError, ValueError):
        sys.stdout.flush()
    with suppress(OSError, ValueError):  # an output that is no file of the system
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def home_where_needed() -> None:
    """Give Matplotlib a folder where HOME cannot be written: else it complains on its own."""
    if not os.access(os.environ.get("HOME", ""), os.W_OK | os.X_OK):
        from hesr_model.support.cache import folder

        os.environ.setdefault("MPLCONFIGDIR", str(folder() / "matplotlib"))


def plain_where_needed() -> None:
    """Let standard output and error take any text, in ASCII where their encoding has no more."""
    codecs.register_error("hesr.plain", _plainly)
    for stream in (sys.stdout, sys.stderr):
        if reconfigure := getattr(stream, "reconfigure", None):
            reconfigure(errors="hesr.plain")


def _plainly(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = unicodedata.normalize("NFKD", error.object[error.start : error.end]).translate(_PLAIN)
    return "".join(c if c.isascii() else "?" for c in text), error.end
