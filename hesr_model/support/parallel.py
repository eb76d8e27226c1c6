"""Independent jobs in worker processes, which are stopped at once where anything fails."""

import os
import shutil
import signal
import tempfile
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from importlib import import_module
from multiprocessing import resource_tracker
from pathlib import Path
from queue import Empty
from typing import TYPE_CHECKING, Any, TypeVar

import cloudpickle

from hesr_model.errors import WorkerError
from hesr_model.support import interrupts
from hesr_model.support.cache import USED
from hesr_model.support.garbage import collect_seldom

if TYPE_CHECKING:
    from concurrent.futures import Future

    from joblib.externals.loky import ProcessPoolExecutor

Result = TypeVar("Result")

_JOBS = "jobs"
_GROWTH = 1 << 30  # [B] by which a worker may grow before a fresh one takes its place
_ORPHANED = 1.0  # [s] after which a worker sees that its parent is gone
_ONE_THREAD = dict.fromkeys(
    (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "BLIS_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
    ),
    "1",
)
"""Environment of a worker: as many threads as processes, and sums that do not depend on them."""

_folder = Path()
_batch: tuple[int, Sequence[Callable[[], Any]]] = (-1, ())
"""Of a worker: where jobs are, and those that it has read last, with their number."""


@contextmanager
def results_of(
    jobs: Sequence[Callable[[], Result]],
    workers: int | None = None,
    costs: Sequence[float] = (),
) -> Iterator[Iterator[Result]]:
    """Run jobs, each in a process; yield the iterator of their results, in the order of the jobs.

    The processes are fresh ones, or those of `one_pool`, with one BLAS thread each, and do not
    import the calling script. When the block is left they are gone, or wait for the next one; where
    it fails, also by Ctrl-C, they are stopped at once.

    Parameters
    ----------
    jobs : functions without arguments, with all that they hold; what the calling script has
        defined is sent along.
    workers : processes; one for each core where not given. With one there is none: a job is done
        in this process when its result is asked for.
    costs : of the jobs, roughly, in any unit; the dearest begin first, so that none is left alone
        at the end.

    Raises
    ------
    WorkerError
        By the iterator, if a process ended before its job was done.
    """
    count = min(workers or os.cpu_count() or 1, len(jobs))
    if count <= 1:
        yield (job() for job in jobs)
        return
    shared = _sharing if workers is None else None
    with ExitStack() as cleanup:
        cleanup.enter_context(warnings.catch_warnings())
        # That a worker that has used much memory is replaced by a fresh one is no news.
        warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
        if shared is None:
            pool = cleanup.enter_context(_Pool(count))
        else:
            cleanup.push(shared.stopped_by)
            pool = shared.pool()
        with interrupts.deferred():  # submitting starts processes, which must not be half-started
            futures = pool.submit(jobs, costs)
        yield (_result(future.result) for future in futures)


@contextmanager
def one_pool(*modules: str, first: Sequence[Callable[[], object]] = ()) -> Iterator[None]:
    """Let all blocks of `results_of` within share processes, but for those that name a number.

    They stay as long as this block, or until a block within fails; the next one has fresh ones.

    Parameters
    ----------
    modules : what the processes import while this one gets its first jobs together, which is when
        they start.
    first : what some process does then, too; whether it succeeds or not, nobody waits for it.
    """
    global _sharing
    if _sharing is not None:
        yield
        return
    with _Shared() as shared:
        _sharing = shared
        if modules and (count := os.cpu_count() or 1) > 1:
            with interrupts.deferred():
                shared.pool().submit([partial(_imported, modules)] * count + list(first))
        try:
            yield
        finally:
            _sharing = None


def shared() -> bool:
    """Whether blocks share processes here."""
    return _sharing is not None


class _Pool:
    """Processes, and the folder from which they read their jobs; a context manager.

    Parameters
    ----------
    count : of the processes.
    """

    def __init__(self, count: int) -> None:
        self._count, self._batches = count, 0
        self._cleanup = ExitStack()

    def __enter__(self) -> "_Pool":
        """Make the folder, and get ready; processes start with the first jobs."""
        from joblib.externals.loky import ProcessPoolExecutor

        with ExitStack() as cleanup:
            with interrupts.deferred():  # or there may be a folder of which nobody knows
                self._folder = Path(
                    cleanup.enter_context(tempfile.TemporaryDirectory(prefix="hesr-"))
                )
            if os.name == "posix":
                # It serves semaphores, and lets Ctrl-C through again where its start was held back.
                resource_tracker.ensure_running()
            with interrupts.deferred():
                self._pool = ProcessPoolExecutor(
                    self._count,
                    initializer=_start,
                    initargs=(self._folder, os.getpid()),
                    env=_environment(),
                )
                cleanup.push(partial(_shut_down, self._pool))
            self._cleanup = cleanup.pop_all()
        return self

    def __exit__(self, *raised: Any) -> None:
        """End the processes, at once where there is an error, and remove the folder."""
        self._cleanup.__exit__(*raised)

    def submit(
        self, jobs: Sequence[Callable[[], Result]], costs: Sequence[float] = ()
    ) -> "list[Future[tuple[Result, Counter[tuple[str, bool]]]]]":
        """Let the processes do jobs, the dearest first."""
        # Workers read the jobs from a file. A pipe is too short for them: where workers are
        # stopped, nobody empties it, and who still writes into it never ends.
        self._batches += 1
        (self._folder / f"{_JOBS}{self._batches}").write_bytes(cloudpickle.dumps(list(jobs)))
        order = sorted(range(len(jobs)), key=lambda k: -costs[k] if costs else k)
        futures = {k: self._pool.submit(_run, self._batches, k) for k in order}
        return [futures[k] for k in range(len(jobs))]


class _Shared:
    """A pool for many blocks, made when it is first wanted; a context manager."""

    def __init__(self) -> None:
        self._pool: _Pool | None = None

    def __enter__(self) -> "_Shared":
        return self

    def __exit__(self, *raised: Any) -> None:
        pool, self._pool = self._pool, None
        if pool:
            pool.__exit__(*raised)

    def pool(self) -> _Pool:
        """Return the pool."""
        if self._pool is None:
            self._pool = _Pool(os.cpu_count() or 1).__enter__()
        return self._pool

    def stopped_by(self, kind: type[BaseException] | None, *raised: Any) -> None:
        """Stop the processes at once where a block has failed."""
        if kind is not None:
            self.__exit__(kind, *raised)


_sharing: _Shared | None = None


def _environment() -> Mapping[str, str]:
    """Return what workers have in their environment beside what stands in that of the parent."""
    # A crash is said by the parent, in a sentence; a stack of Python in C is for who asks for it.
    return _ONE_THREAD | {"PYTHONFAULTHANDLER": os.environ.get("PYTHONFAULTHANDLER", "")}


def _shut_down(pool: "ProcessPoolExecutor", error: object, *_: object) -> None:
    """Let idle workers end; where there is an error, stop all with what they have started."""
    if error is not None:
        # Its thread drops the jobs that wait, and then looks for those whose numbers it still has.
        with suppress(Empty):
            while True:
                pool._work_ids.get_nowait()
    pool.shutdown(wait=True, kill_workers=error is not None)


def _result(wait: Callable[[], "tuple[Result, Counter[tuple[str, bool]]]"]) -> Result:
    try:
        result, used = wait()
    except BrokenProcessPool as error:
        raise WorkerError(
            "a worker process ended before its job was done, killed by another program or for "
            "lack of memory; run it again, with fewer processes if memory is short."
        ) from error
    USED.update(used)
    return result


def _start(folder: Path, parent: int) -> None:
    """Learn where jobs are, and leave to the parent what comes when a worker is stopped.

    Signals to the whole group are answered once, by the parent, which kills its workers; those
    then have no time to tidy, so that their temporary files stand where the parent removes them.
    """
    from joblib.externals.loky import process_executor

    global _folder
    collect_seldom()
    # A fresh process imports for seconds what this one has: pictures, symbols and physics together
    # are more than what is a leak to the pool, which has no option for it.
    process_executor._MAX_MEMORY_LEAK_SIZE = _GROWTH
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent, folder), daemon=True).start()
    tempfile.tempdir = str(folder)
    _folder = folder


def _end_with(parent: int, folder: Path) -> None:
    """End this process when its parent has been killed and can neither stop it nor tidy."""
    while os.getppid() == parent:
        time.sleep(_ORPHANED)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


def _imported(modules: Sequence[str]) -> None:
    for name in modules:
        import_module(name)


def _run(batch: int, k: int) -> tuple[Any, Counter[tuple[str, bool]]]:
    """Do a job; return what it gives, and what it has used of the cache."""
    global _batch
    before = USED.copy()
    if _batch[0] != batch:
        _batch = batch, cloudpickle.loads((_folder / f"{_JOBS}{batch}").read_bytes())
    return _batch[1][k](), USED - before
