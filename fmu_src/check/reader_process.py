"""One process in the sandbox that reads all untrusted files of an archive."""

from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

from hesr_model.support.child import Child
from hesr_model.support.process import DiedError

# Loaded once for all processes.
_MODULES = ("fmu_src.check.readers", "lxml.etree", "fmpy.validation", "lief", "zipfile")


class ReaderProcess:
    """A process that calls functions on files; it is replaced after its death.

    Starting it costs more than its work, so that an archive has one. Archives share none, since a
    file that corrupts its reader would have a say on others.

    Parameters
    ----------
    folder : parent of its own folder.
    readable : folders of the files that it may read.
    """

    def __init__(self, folder: Path, *readable: Path) -> None:
        self._folder = folder
        self._readable = readable
        self._child: Child | None = None
        self._cleanup = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def run(self, function: str, file: Path, seconds: float) -> Any:
        """Return the result of "module:function" for a file.

        Raises DiedError if the function fails or takes more than `seconds` [s].
        """
        try:
            if self._child is None:
                self._child = self._start(seconds)
            self._child.seconds = seconds
            return self._child.run(function, str(file))
        except DiedError:
            self._end()
            raise

    def _start(self, seconds: float) -> Child:
        process_folder = self._cleanup.enter_context(TemporaryDirectory(dir=self._folder))
        child = Child(Path(process_folder), seconds, self._readable, *_MODULES)
        self._cleanup.callback(child.kill)
        return child

    def _end(self) -> None:
        self._child = None
        self._cleanup.close()
