"""Output of commands: tables, progress, logs, JSON, errors; and handling of interrupts."""

import _thread
import codecs
import logging
import os
import re
import signal
import sys
import threading
import time
import unicodedata
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import NoReturn, TextIO

import click

from hesr_model.errors import ArtifactError, ConfigError, HesrError
from hesr_model.support.files import (
    NO_ROOM,
    find_temporary_folder,
    require_room,
    scratch_folder,
    written_whole,
)
from hesr_model.support.progress import Interrupted, Stages, listed_in
from hesr_model.support.text import sanitise

_NEW_FORMS = {
    "laws": "hesr fit --list",
    "evaluate": "hesr test LAW... --on LOG",
    "replay": "hesr test X.fmu --on LOG",
    "properties": "hesr test LAW... --kind properties",
    "audit": "hesr test LAW... --kind passivity",
    "arena": "hesr test X.fmu... --on LOG",
    "constants": "hesr inspect LOG... --robot ROBOT --torque-constants",
    "thermal": "hesr fit LOG... --law law.json --add temperature -o warm.json",
    "sweep": "hesr simulate SWEEP.toml -o FOLDER, or --only RUN -o run.csv for one run",
    "fleet": "hesr monitor FLEET.toml -o FOLDER",
    "package": "hesr export SYSTEM.toml -o X.ssp, or -o X.fmu for one FMU",
    "results": "hesr report RESULT... -o X.md",
    "view": "hesr report RESULT --view, or -o arm.mp4 for a video",
    "interop": "make interop, in a checkout of HESR",
}
MOVED_VERBS = {verb: f"'hesr {verb}' is now: {form}." for verb, form in _NEW_FORMS.items()}
"""New form of each verb of earlier versions."""

_REFUSED_EXIT_CODE = 2
_CLOSED_OUTPUT_EXIT_CODE = 1  # exit code after the reader of the output has closed it, as Click's
_MAX_SENTENCE_LENGTH = 4000  # characters of a sentence: file names may be of any length

_MIN_MEMORY = 1 << 30  # [bytes] that libraries need
_MIN_OPEN_FILES = 64  # open at a time, that libraries need
_MAX_SOURCE_DATE = 253402300799  # [s] of SOURCE_DATE_EPOCH

_ASCII_REPLACEMENTS = str.maketrans("✓✗–—‘’“”→·×µμ", "+x--''\"\">.xuu")
"""Replacements, of the same width, for characters that the output cannot encode."""


@contextmanager
def report_errors() -> Iterator[None]:
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
        _discard_output()
        sys.exit(_CLOSED_OUTPUT_EXIT_CODE)
    except OSError as error:
        _discard_output()
        refuse(_describe_system_error(error))
    except MemoryError:
        refuse("not enough memory; give less data at once.")
    except RecursionError:
        refuse("an input file is nested too deeply.")


def _describe_system_error(error: OSError) -> str:
    """Return the sentence of an error of the system; writing reports no name of a file."""
    if error.filename is None and error.errno in NO_ROOM:
        try:
            require_room(find_temporary_folder())
        except ArtifactError as room_error:
            return str(room_error)
    reason = " ".join((error.strerror or str(error)).split()).rstrip(".")
    sentence = f"the system reports an error ({reason})."
    if isinstance(error.filename, str):
        return f"{sanitise(error.filename)}: {sentence}"
    return sentence


def require_environment() -> None:
    """Refuse limits and dates that make libraries crash, hang or raise SIGINT."""
    date = os.environ.get("SOURCE_DATE_EPOCH", "0")
    if not (date.isascii() and date.isdigit() and int(date) <= _MAX_SOURCE_DATE):
        raise ConfigError(f"SOURCE_DATE_EPOCH is '{date}'; expected whole seconds since 1970.")
    with suppress(ImportError):  # Windows has no such limits
        import resource

        for resource_limit, minimum, name, scale, unit, option in (
            (resource.RLIMIT_AS, _MIN_MEMORY, "memory", 10**6, " MB", "v"),
            (resource.RLIMIT_NOFILE, _MIN_OPEN_FILES, "open files", 1, "", "n"),
        ):
            limit = resource.getrlimit(resource_limit)[0]
            if limit != resource.RLIM_INFINITY and limit < minimum:
                raise ConfigError(
                    f"the limit of {name} is {limit // scale}{unit}; at least "
                    f"{minimum // scale}{unit} are needed (ulimit -{option})."
                )


def refuse(sentence: str) -> NoReturn:
    """Print a sentence and exit with the code of bad input."""
    click.echo(f"hesr: {sanitise(sentence, _MAX_SENTENCE_LENGTH)}", err=True)
    sys.exit(_REFUSED_EXIT_CODE)


def _discard_output() -> None:
    """Discard unwritten output, which Python would try to write again when it ends."""
    with suppress(OSError, ValueError):
        sys.stdout.flush()
    with suppress(OSError, ValueError):  # not a file descriptor
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def provide_home() -> None:
    """Give Matplotlib a folder if HOME is not writable, since it would print a warning."""
    if not os.access(os.environ.get("HOME", ""), os.W_OK | os.X_OK):
        from hesr_model.support.cache import folder

        os.environ.setdefault("MPLCONFIGDIR", str(folder() / "matplotlib"))


def open_closed_streams() -> None:
    """Connect closed standard streams to nothing: files opened later would take their numbers."""
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is not None:
            continue
        try:
            os.fstat(number)  # another file has taken the number
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
        setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode, encoding="utf-8"))


def accept_any_text() -> None:
    """Let standard output and error accept any text; outputs without UTF-8 get ASCII."""
    codecs.register_error("hesr.plain", _replace_unencodable)
    for stream in (sys.stdout, sys.stderr):
        reconfigure_stream = getattr(stream, "reconfigure", None)
        if reconfigure_stream:
            reconfigure_stream(errors="hesr.plain")


def _replace_unencodable(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = unicodedata.normalize("NFKD", error.object[error.start : error.end])
    text = text.translate(_ASCII_REPLACEMENTS)
    return re.sub(r"[^\x00-\x7f]", "?", text), error.end


INTERRUPTED = 130  # exit codes after signals: 128 and the number of the signal
STANDARD_OUTPUT = Path("-")
_MIN_INTERRUPT_INTERVAL = 2.0  # [s] within this time a second Ctrl-C does not disturb the clean-up
_REPEAT_DELAY = 0.05  # [s] delay before an interrupt that Python dropped is raised again
_PACKAGES = ("hesr_model", "fmu_src", "cosim", "hesr")
_log = logging.getLogger(__name__)


class _Ended(KeyboardInterrupt):
    """Request to end from another program (SIGTERM)."""


@contextmanager
def direct_output(*, quiet: bool, verbose: bool, json_file: Path | None) -> Iterator[TextIO | None]:
    """Run a block at the requested verbosity: errors only, or everything on standard error.

    Yield the standard output for an answer in JSON, None for errors only.
    """
    if quiet and verbose:
        raise ConfigError("--quiet and --verbose are contradictory; give one of them.")
    with ExitStack() as cleanup:
        answer_stream = None if quiet else sys.stdout
        cleanup.enter_context(_configure_logging(quiet=quiet, verbose=verbose))
        if quiet or json_file == STANDARD_OUTPUT:
            nowhere = cleanup.enter_context(Path(os.devnull).open("w", encoding="utf-8"))
            cleanup.enter_context(redirect_stdout(nowhere))
        try:
            yield answer_stream
        except HesrError:
            _log.debug("Origin of the error:", exc_info=True)
            raise
        except KeyboardInterrupt as interrupt:
            saved_note = ""
            cause = interrupt
            if isinstance(interrupt, Interrupted):
                saved_note = f", and {interrupt.resume_hint}"
                cause = interrupt.interrupt
            ending = "interrupted"
            exit_code = INTERRUPTED
            if isinstance(cause, _Ended):
                ending = "ended by another program"
                exit_code = 128 + signal.SIGTERM
            click.echo(f"hesr: {ending}; no file is half-written{saved_note}.", err=True)
            raise click.exceptions.Exit(exit_code) from interrupt


class _LogHandler(logging.StreamHandler[TextIO]):
    """Handler on the current standard error, which a progress bar redirects above itself.

    Files are read and bodies identified several times; a warning about them is printed once.
    """

    def __init__(self, *, repeats: bool) -> None:
        super().__init__()
        self._repeats = repeats
        self._printed_messages: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        message = record.getMessage()
        if message in self._printed_messages and not self._repeats:
            return
        self._printed_messages.add(message)
        self.setStream(sys.stderr)
        super().emit(record)


@contextmanager
def _configure_logging(*, quiet: bool, verbose: bool) -> Iterator[None]:
    handler = _LogHandler(repeats=verbose)
    previous_levels = {name: logging.getLogger(name).level for name in _PACKAGES}
    if verbose:
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    else:
        handler.setFormatter(logging.Formatter("hesr: %(message)s"))
        handler.setLevel(logging.WARNING)
    if quiet:
        handler.setLevel(logging.ERROR)
    for name in _PACKAGES:
        logging.getLogger(name).addHandler(handler)
        if verbose:
            logging.getLogger(name).setLevel(logging.DEBUG)
    try:
        yield
    finally:
        for name, level in previous_levels.items():
            logging.getLogger(name).removeHandler(handler)
            logging.getLogger(name).setLevel(level)


@contextmanager
def interrupt_on_signals() -> Iterator[None]:
    """Raise KeyboardInterrupt on Ctrl-C and SIGTERM, so that temporary files are removed."""
    if threading.current_thread() is not threading.main_thread():
        yield  # other threads receive no signals
        return
    # A script that starts a command in the background may make it ignore Ctrl-C.
    heeded_signals = [
        number
        for number in (signal.SIGINT, signal.SIGTERM)
        if signal.getsignal(number) is not signal.SIG_IGN
    ]
    if not heeded_signals:
        yield
        return
    interrupts = _Interrupts()
    previous_handlers = {
        number: signal.signal(number, interrupts.interrupt) for number in heeded_signals
    }
    sys.unraisablehook = interrupts.repeat
    try:
        yield
    finally:
        sys.unraisablehook = interrupts.previous_hook
        interrupts.cancel_repeats()
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)


class _Interrupts:
    """Handlers that raise an exception for a signal, and again if Python drops it."""

    def __init__(self) -> None:
        self.previous_hook = sys.unraisablehook
        self._last_time = -_MIN_INTERRUPT_INTERVAL  # [s] of the last interrupt
        self._timers: list[threading.Timer] = []

    def interrupt(self, number: int, _frame: object) -> None:
        """Raise the exception of a signal, unless it repeats one that is being handled."""
        now = time.monotonic()
        if now - self._last_time < _MIN_INTERRUPT_INTERVAL:
            return
        self._last_time = now
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        raise _Ended

    def repeat(self, unraisable: "sys.UnraisableHookArgs") -> None:
        """Raise once more what was raised during a deallocation, where Python drops exceptions."""
        if not isinstance(unraisable.exc_value, KeyboardInterrupt):
            self.previous_hook(unraisable)
            return
        self._last_time = -_MIN_INTERRUPT_INTERVAL
        number = signal.SIGINT
        if isinstance(unraisable.exc_value, _Ended):
            number = signal.SIGTERM
        timer = threading.Timer(_REPEAT_DELAY, _raise_in_main_thread, (number,))
        self._timers.append(timer)
        timer.start()

    def cancel_repeats(self) -> None:
        """Cancel what is still to be raised."""
        for timer in self._timers:
            timer.cancel()


def _raise_in_main_thread(number: int) -> None:
    thread_id = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and thread_id:
        signal.pthread_kill(thread_id, number)  # ends its waiting
    else:
        _thread.interrupt_main(signal.Signals(number))


@contextmanager
def show_progress(*, is_hidden: bool) -> Iterator[Stages]:
    """Show progress, times and current work on a terminal, from the first report on."""
    is_hidden = is_hidden or not sys.stderr.isatty()
    with ExitStack() as cleanup:
        bars: list[Stages] = []

        def report(stage: str, done: int, total: int) -> None:
            _log.info("%s: %d of %d", stage, done, total)
            if not (is_hidden or bars):
                bars.append(cleanup.enter_context(_progress_bar()))
            for bar in bars:
                bar(stage, done, total)

        yield report


@contextmanager
def _progress_bar() -> Iterator[Stages]:
    from rich import progress
    from rich.console import Console, RenderableType
    from rich.text import Text

    names: list[str] = []

    class Block(progress.Progress):
        def get_renderables(self) -> Iterable[RenderableType]:
            yield from super().get_renderables()
            at_work = "; ".join(names)
            if at_work:
                yield Text(f"  {at_work}", no_wrap=True, overflow="ellipsis")

    # Messages above the bar are not wrapped, so that paths in them can be copied.
    console = Console(stderr=True, soft_wrap=True)
    tasks: dict[str, progress.TaskID] = {}
    block = Block(
        progress.TextColumn("{task.description}"),
        progress.BarColumn(20),
        progress.TaskProgressColumn(),
        progress.TimeElapsedColumn(),
        progress.TextColumn("spent,"),
        progress.TimeRemainingColumn(),
        progress.TextColumn("left"),
        console=console,
        transient=True,
    )
    with listed_in(names), block as bar:

        def report(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                for task in bar.tasks:
                    bar.update(task.id, visible=not task.finished)
                tasks[stage] = bar.add_task(stage, total=total)
            bar.update(tasks[stage], completed=done)

        yield report


@contextmanager
def provide_answer_file(json_file: Path | None, output: TextIO | None) -> Iterator[Path | None]:
    """Yield the file for the JSON answer, if one is requested; `output` is that of ``-``."""
    if json_file is None:
        yield None
    elif json_file == STANDARD_OUTPUT:
        with scratch_folder() as folder:
            answer_path = Path(folder) / "answer.json"
            yield answer_path
            if output:
                click.echo(answer_path.read_text(encoding="utf-8"), nl=False, file=output)
    else:
        with written_whole(json_file) as temporary:
            yield temporary
