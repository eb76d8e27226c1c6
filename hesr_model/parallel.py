"""Processes for independent jobs: fresh ones, stopped at once where anything fails."""

import multiprocessing
import os
import signal
import tempfile
from collections.abc import Callable, Container, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing.process import BaseProcess
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any, TypeVar

from hesr_model import interrupts

Result = TypeVar("Result")

_JOBS = "jobs"

_jobs: Sequence[Callable[[], Any]] = ()
"""Of a worker, which reads all of them when it begins."""


@contextmanager
def begun(
    jobs: Sequence[Callable[[], Result]], workers: int | None = None
) -> Iterator[list[Callable[[], Result]]]:
    """Begin jobs; yield for each, in their order, what waits for its result.

    Where the block fails, also by Ctrl-C, all processes are stopped at once.

    Parameters
    ----------
    jobs : functions without arguments that can be sent to another process, with all they hold.
    workers : processes; one for each core where not given. With one there is none: a job is done
        in this process when its result is asked for.
    """
    count = min(workers or os.cpu_count() or 1, len(jobs))
    if count <= 1:
        yield list(jobs)
        return
    others = set(multiprocessing.active_children())
    # Fresh processes: forking one that already runs BLAS or logging threads may dead-lock.
    context = multiprocessing.get_context("spawn")
    with ExitStack() as cleanup:
        with interrupts.put_off():  # or there may be a folder of which nobody knows
            folder = Path(cleanup.enter_context(tempfile.TemporaryDirectory(prefix="hesr-")))
        # Workers read the jobs from a file. A pipe is too short for them: where workers are
        # stopped, nobody empties it, and who still writes into it never ends.
        (folder / _JOBS).write_bytes(ForkingPickler.dumps(list(jobs)))
        pool = cleanup.enter_context(ProcessPoolExecutor(count, context, _begin, (folder,)))
        cleanup.push(partial(_stop, pool, others))
        with interrupts.put_off():  # submitting starts processes, which must not be half-begun
            futures = [pool.submit(_do, k) for k in range(len(jobs))]
        yield [future.result for future in futures]


def _stop(
    pool: ProcessPoolExecutor, others: Container[BaseProcess], error: object, *_: object
) -> None:
    """Stop the processes of a pool, where there is an error."""
    if error is None:
        return
    pool.shutdown(wait=False, cancel_futures=True)
    stopped = [worker for worker in multiprocessing.active_children() if worker not in others]
    for worker in stopped:
        worker.terminate()
    for worker in stopped:
        worker.join()


def _begin(folder: Path) -> None:
    """Take the jobs, and leave to the parent what comes when a worker is stopped.

    Ctrl-C is answered once, by the parent, which stops its workers; those then have no time to
    tidy, so that their temporary files stand where the parent removes them.
    """
    global _jobs
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    tempfile.tempdir = str(folder)
    _jobs = ForkingPickler.loads((folder / _JOBS).read_bytes())


def _do(k: int) -> Any:
    return _jobs[k]()
