"""Independent jobs in worker processes, which are killed at once if anything fails.

A request to a worker is a line with the numbers of a batch and a job; an answer is a line with its
size and the pickled tuple (error or None, result, cache use).
"""

import json
import logging
import os
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from functools import lru_cache, partial
from importlib import import_module
from pathlib import Path
from queue import SimpleQueue
from subprocess import PIPE
from threading import Thread
from typing import IO, Any, TypeVar

import cloudpickle

from hesr_model.errors import WorkerError
from hesr_model.support import cache
from hesr_model.support.cache import USED
from hesr_model.support.files import remove_scratch, scratch_folder
from hesr_model.support.lazy import collect_seldom
from hesr_model.support.process import ChildProcess, kill_by_mark, new_mark, python_command
from hesr_model.support.progress import current, deferred, running

JOBS = "jobs"  # prefix of files with pickled jobs
JobAnswer = tuple[BaseException | None, Any, Counter[tuple[str, bool]]]
_MAX_GROWTH = 1 << 30  # memory growth after which a worker starts afresh [B]
_PARENT_CHECK_PERIOD = 1.0  # period of checks for the parent [s]


def work(folder: Path, parent: int) -> None:
    """Answer requests until stdin closes."""
    import psutil

    # Only the parent answers signals to the process group.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    threading.Thread(target=_exit_after_parent, args=(parent, folder), daemon=True).start()
    collect_seldom()
    for name in (cache.__name__, "hesr_model.support.child"):  # the parent has warned
        logging.getLogger(name).setLevel(logging.ERROR)
    tempfile.tempdir = str(folder)
    requests = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb")
    with Path(os.devnull).open("rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)  # jobs may print
    process = psutil.Process()
    first_size = process.memory_info().rss
    for request in requests:
        batch, k = request.decode().split()
        data = _make_answer(folder / f"{JOBS}{batch}", int(k))
        answers.write(f"{len(data)}\n".encode() + data)
        answers.flush()
        if process.memory_info().rss > first_size + _MAX_GROWTH and os.name == "posix":
            os.dup2(requests.fileno(), 0)
            os.dup2(answers.fileno(), 1)
            # The options of `python_command` are repeated by the arguments.
            os.execv(sys.executable, sys.orig_argv)


Preparation = Callable[[], None]
_carriers: list[Callable[[], Preparation | None]] = []


def carry(carrier: Callable[[], Preparation | None]) -> None:
    """Let workers repeat what this process has registered.

    The `carrier` is called for each batch; what it returns, a worker calls before the batch.
    Classes of a notebook travel in it by value.
    """
    _carriers.append(carrier)


@lru_cache(maxsize=1)
def _load_batch(file: Path) -> Sequence[Callable[[], Any]]:
    preparations: Sequence[Preparation]
    jobs: Sequence[Callable[[], Any]]
    preparations, jobs = cloudpickle.loads(file.read_bytes())
    for prepare in preparations:
        prepare()
    return jobs


def _make_answer(file: Path, k: int) -> bytes:
    before = USED.copy()
    answer: JobAnswer
    try:
        answer = None, _load_batch(file)[k](), USED - before
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


def _exit_after_parent(parent: int, folder: Path) -> None:
    while os.getppid() == parent:
        time.sleep(_PARENT_CHECK_PERIOD)
    remove_scratch(folder)
    os._exit(1)


Returned = TypeVar("Returned")

_START = (
    "import json, sys; from pathlib import Path; path, folder, parent = json.loads(sys.argv[1]); "
    "sys.path[:] = path; from hesr_model.support.parallel import work; work(Path(folder), parent)"
)
_LIBRARIES = ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "BLIS_NUM", "VECLIB_MAXIMUM")
_ENVIRONMENT = {f"{library}_THREADS": "1" for library in _LIBRARIES}  # for reproducible sums


@contextmanager
def results_of(
    jobs: Sequence[Callable[[], Returned]],
    workers: int | None = None,
    costs: Sequence[float] = (),
    names: Sequence[str] = (),
) -> Iterator[Iterator[Returned]]:
    """Run jobs in processes; yield the iterator of their results, in the order of the jobs.

    Jobs with large `costs` start first; `names` are shown while jobs run. Processes are new, one
    per core by default, or those of `one_pool`. One worker is this process. The iterator raises
    WorkerError if a process ended before its job was done.
    """
    count = min(workers or os.cpu_count() or 1, len(jobs))
    if count <= 1:
        yield _run_in_process(jobs, names)
        return
    with ExitStack() as cleanup:
        if _sharing is None or workers is not None:
            pool = cleanup.enter_context(_Pool(count))
        else:
            cleanup.push(_sharing.stop_on_error)
            pool = _sharing
        yield (_unpack_answer(future) for future in pool.submit(jobs, costs, names))


@contextmanager
def one_pool(*modules: str, first: Sequence[Callable[[], object]] = ()) -> Iterator[None]:
    """Share processes among all blocks of `results_of` within that do not give `workers`.

    They first import `modules`, then do the jobs `first`, whose results and errors are dropped.
    After a block has failed the next one starts new processes.
    """
    global _sharing
    if _sharing is not None:
        yield
        return
    count = os.cpu_count() or 1
    with _Pool(count) as _sharing:
        if modules and count > 1:
            _sharing.submit([partial(_import, modules)] * count + list(first))
        try:
            yield
        finally:
            _sharing = None


def is_sharing() -> bool:
    """Return whether blocks share processes here."""
    return _sharing is not None


_Task = tuple[int, int, Future[JobAnswer], AbstractContextManager[None]]


class _Pool:
    """Processes that start with the first jobs, and anew with the first ones after an error."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._batches = 0
        self._tasks: SimpleQueue[_Task | None] = SimpleQueue()
        self._children: list[ChildProcess] = []
        self._threads: list[Thread] = []
        self._mark = new_mark()
        self._cleanup = ExitStack()

    def __enter__(self) -> "_Pool":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with self._cleanup:
            if kind is not None:
                self._kill()
            for _thread in self._threads:
                self._tasks.put(None)
            for thread in self._threads:
                thread.join()
            for child in self._children:
                child.process.wait()
        self._tasks = SimpleQueue()
        self._children = []
        self._threads = []

    def stop_on_error(self, kind: type[BaseException] | None, *raised: object) -> None:
        """Kill the processes if a block has failed."""
        if kind is not None:
            self.__exit__(kind, *raised)

    def submit(
        self,
        jobs: Sequence[Callable[[], object]],
        costs: Sequence[float] = (),
        names: Sequence[str] = (),
    ) -> list[Future[JobAnswer]]:
        """Queue jobs, the most expensive first; return futures of answers."""
        self._batches += 1
        with deferred():
            if not self._children:
                self._folder = self._cleanup.enter_context(scratch_folder())
            while len(self._children) < self._count:
                self._start()
        preparations = [carrier() for carrier in _carriers]
        batch = [prepare for prepare in preparations if prepare is not None], list(jobs)
        (self._folder / f"{JOBS}{self._batches}").write_bytes(cloudpickle.dumps(batch))
        futures = [Future[JobAnswer]() for _ in jobs]
        order = list(range(len(jobs)))
        if costs:
            order.sort(key=lambda k: -costs[k])
        for k in order:
            self._tasks.put((self._batches, k, futures[k], _display(names, k)))
        return futures

    def _start(self) -> None:
        arguments = json.dumps([sys.path, str(self._folder), os.getpid()])
        # The parent reports crashes; set PYTHONFAULTHANDLER for a traceback.
        faults = {"PYTHONFAULTHANDLER": os.environ.get("PYTHONFAULTHANDLER", "")}
        child = ChildProcess(
            python_command("-c", _START, arguments),
            None,
            mark=self._mark,
            environment=_ENVIRONMENT | faults,
            start_new_session=False,  # a signal to the process group ends all
            stdin=PIPE,
            stdout=PIPE,
        )
        self._children.append(child)
        self._threads.append(Thread(target=self._serve, args=(child,), daemon=True))
        self._threads[-1].start()

    def _serve(self, child: ChildProcess) -> None:
        requests = child.process.stdin
        answers = child.process.stdout
        assert requests is not None
        assert answers is not None
        with requests, answers:
            while (task := self._tasks.get()) is not None:
                batch, k, future, display = task
                try:
                    with display:
                        os.write(requests.fileno(), f"{batch} {k}\n".encode())
                        answer = read_answer(answers)
                    future.set_result(answer)
                except (EOFError, OSError):
                    for worker in self._children:
                        worker.process.kill()
                    future.set_exception(
                        WorkerError(
                            "a worker process was killed, perhaps for lack of memory; run it "
                            "again with fewer workers."
                        )
                    )
                except Exception as error:  # the answer cannot be unpickled here
                    future.set_exception(error)

    def _kill(self) -> None:
        for child in self._children:
            child.process.kill()
        kill_by_mark(self._mark)


_sharing: _Pool | None = None


def _display(names: Sequence[str], k: int) -> AbstractContextManager[None]:
    if not names:
        return nullcontext()
    return running(names[k], current())


def _run_in_process(
    jobs: Sequence[Callable[[], Returned]], names: Sequence[str]
) -> Iterator[Returned]:
    for k, job in enumerate(jobs):
        with _display(names, k):
            result = job()
        yield result


def _unpack_answer(future: "Future[JobAnswer]") -> Any:
    error, result, cache_use = future.result()
    USED.update(cache_use)
    if error is not None:
        raise error
    return result


def _import(modules: Sequence[str]) -> None:  # a result would be imported by the parent as well
    for name in modules:
        import_module(name)
