"""Processes for independent jobs: fresh ones, stopped at once where anything fails."""

import multiprocessing
import signal
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager


def _begin(temporary: str) -> None:
    """Leave to the parent what comes when a worker is stopped.

    Ctrl-C is answered once, by the parent, which stops its workers; those then have no time to
    tidy, so that their temporary files stand where the parent removes them.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    tempfile.tempdir = temporary


@contextmanager
def workers(count: int) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool of processes, which are stopped at once where the block fails.

    Submitting starts them: do it while interrupts are put off, or Ctrl-C reaches one half-begun.
    """
    others = set(multiprocessing.active_children())
    # Fresh processes: forking one that already runs BLAS or logging threads may dead-lock.
    context = multiprocessing.get_context("spawn")
    with (
        tempfile.TemporaryDirectory(prefix="hesr-") as temporary,
        ProcessPoolExecutor(count, context, initializer=_begin, initargs=(temporary,)) as pool,
    ):
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            stopped = set(multiprocessing.active_children()) - others
            for worker in stopped:
                worker.terminate()
            for worker in stopped:
                worker.join()
            raise
