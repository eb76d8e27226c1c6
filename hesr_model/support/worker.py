"""A worker process of `support.parallel`.

A request on stdin is a line with the numbers of a batch and a job; an answer on stdout, a line with
its size and the pickled tuple (error or None, result, cache use).
"""

import logging
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import IO, Any

import cloudpickle

from hesr_model.support import cache
from hesr_model.support.cache import USED
from hesr_model.support.garbage import collect_seldom

JOBS = "jobs"  # prefix of files with pickled jobs

JobAnswer = tuple[BaseException | None, Any, Counter[tuple[str, bool]]]

_GROWTH = 1 << 30  # memory growth after which a worker starts afresh [B]
_ORPHANED = 1.0  # period of checks for the parent [s]


def work(folder: Path, parent: int) -> None:
    """Answer requests until stdin closes."""
    import psutil

    # Only the parent answers signals to the process group.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    threading.Thread(target=_end_with, args=(parent, folder), daemon=True).start()
    collect_seldom()
    for name in (cache.__name__, "fmu_src.run.sandbox_rights"):  # the parent has warned
        logging.getLogger(name).setLevel(logging.ERROR)
    tempfile.tempdir = str(folder)
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    with Path(os.devnull).open("rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)  # jobs may print
    process = psutil.Process()
    first_size = process.memory_info().rss
    for request in requests:
        batch, k = request.decode().split()
        data = _answer(folder / f"{JOBS}{batch}", int(k))
        answers.write(f"{len(data)}\n".encode() + data)
        answers.flush()
        if process.memory_info().rss > first_size + _GROWTH and os.name == "posix":
            os.dup2(requests.fileno(), 0)
            os.dup2(answers.fileno(), 1)
            os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])


@lru_cache(maxsize=1)
def _batch(file: Path) -> Sequence[Callable[[], Any]]:
    jobs: Sequence[Callable[[], Any]] = cloudpickle.loads(file.read_bytes())
    return jobs


def _answer(file: Path, k: int) -> bytes:
    before = USED.copy()
    answer: JobAnswer
    try:
        answer = None, _batch(file)[k](), USED - before
        return bytes(cloudpickle.dumps(answer))
    except BaseException as error:
        error.add_note("".join(traceback.format_exception(error)))
        answer = error, None, USED - before
    try:
        return bytes(cloudpickle.dumps(answer))
    except Exception:  # its class cannot be pickled
        return bytes(cloudpickle.dumps((RuntimeError(repr(answer[0])), None, answer[2])))


def read_answer(answers: IO[bytes]) -> JobAnswer:
    """Read one answer; raises EOFError if the worker has ended."""
    size = answers.readline()
    data = answers.read(int(size or 0))
    if not size or len(data) < int(size):
        raise EOFError
    answer: JobAnswer = cloudpickle.loads(data)
    return answer


def _end_with(parent: int, folder: Path) -> None:
    while os.getppid() == parent:
        time.sleep(_ORPHANED)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)
