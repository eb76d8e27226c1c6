"""Runs of a sweep on dask.distributed, with FMUs cached by hash; lost chunks are repeated."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from ipaddress import ip_address
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from fmu_src.run.trust import is_known, is_trusted, remember
from hesr.extras.sweep.plan import Plan
from hesr.extras.sweep.work import RunOutputs, Task, run_rows
from hesr_model.errors import ArgumentError, WorkerError
from hesr_model.support import cache
from hesr_model.support.arrays import Array
from hesr_model.support.extras import install_command
from hesr_model.support.files import sha256, written_whole

if TYPE_CHECKING:
    from distributed import Client

_MAX_ROUNDS = 5
_ENCRYPTED = ("tls", "wss")
_LOST_ERRORS = ("KilledWorker", "CancelledError", "FutureCancelledError", "CommClosedError")
_TIME_LIMIT = 20  # [s] for the scheduler to answer and to have a worker


@contextmanager
def run_on_cluster(
    plan: Plan, open_starts: list[int], address: str
) -> Iterator[Iterator[tuple[int, RunOutputs]]]:
    """Yield an iterator of finished chunks with their first runs; `address` as tcp://host:8786.

    Raises ConfigError without dask.distributed or scheduler; the iterator raises WorkerError.
    """
    try:
        from distributed import Client, Security
    except ImportError as error:
        raise ArgumentError(f"'cluster' needs: {install_command('cluster')}.") from error
    security = Security()
    try:
        context = security.get_connection_args("client")["ssl_context"]
        if context is None and urlsplit(address).scheme in _ENCRYPTED:
            raise OSError("no 'ca-file', 'client.cert' and 'client.key' in distributed.comm.tls")
    except OSError as error:  # errors of OpenSSL included
        raise ArgumentError(f"'cluster': Dask's TLS settings are not usable ({error}).") from error
    try:
        client = Client(address, timeout=_TIME_LIMIT, set_as_default=False, security=security)
    except (OSError, ValueError) as error:
        raise ArgumentError(f"'cluster': found no scheduler at {address}.") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_TIME_LIMIT)
        except TimeoutError as error:
            raise ArgumentError(f"'cluster': the scheduler at {address} has no worker.") from error
        yield _run_chunks(client, plan, open_starts)


def require_encryption(address: str, *, insecure: bool) -> None:
    """Raise ConfigError for an unencrypted address of another machine unless `insecure`."""
    parts = urlsplit(address)
    if insecure or parts.scheme in (*_ENCRYPTED, "inproc"):
        return
    host = parts.hostname or ""
    with suppress(ValueError):
        if ip_address(host).is_loopback:
            return
    if host != "localhost":
        raise ArgumentError(
            f"'cluster': {address} is not encrypted; use tls:// with the TLS settings of Dask, or "
            "'insecure' in a network that you trust."
        )


def _run_chunks(
    client: "Client", plan: Plan, open_starts: list[int]
) -> Iterator[tuple[int, RunOutputs]]:
    from distributed import as_completed

    trusted = {digest: is_trusted(fmu) for fmu, digest in plan.digests.items()}
    open_chunks = dict.fromkeys(open_starts)
    for _ in range(_MAX_ROUNDS):
        if not open_chunks:
            return
        contents = client.scatter(
            {digest: fmu.read_bytes() for fmu, digest in plan.digests.items()}, broadcast=True
        )
        names = {str(fmu): digest for fmu, digest in plan.digests.items()}
        fmus = names, trusted, contents
        futures = {
            client.submit(
                run_on_worker, plan.task, plan.chunk(chunk_start), *fmus, pure=False
            ): chunk_start
            for chunk_start in open_chunks
        }
        for future in as_completed(futures, loop=client.loop):
            if future.status == "finished":
                chunk_start = futures[future]
                del open_chunks[chunk_start]
                yield chunk_start, future.result()
            elif future.status == "error":
                error = future.exception()
                if type(error).__name__ not in _LOST_ERRORS:
                    raise error
            future.release()
    if open_chunks:
        raise WorkerError(
            f"workers of the cluster died {_MAX_ROUNDS} times; {len(open_chunks)} chunks of "
            "runs are left; repeat the command to continue."
        )


def run_on_worker(
    task: Task,
    values: Array,
    names: Mapping[str, str],
    trusted: Mapping[str, bool],
    contents: Mapping[str, bytes],
) -> RunOutputs:
    """Do runs (n, d) on a worker, with FMUs as bytes by hash; `trusted` run without a sandbox."""
    folder = cache.folder() / "fmus"
    files = {}
    for name, digest in names.items():
        fmu_path = files[name] = folder / f"{digest}.fmu"
        if not (fmu_path.is_file() and sha256(fmu_path) == digest):
            with written_whole(fmu_path) as temporary:
                temporary.write_bytes(contents[digest])
        if trusted[digest] and not is_known(digest):
            remember(fmu_path)
    components = tuple(
        component.model_copy(update={"fmu": files[str(component.fmu)]})
        for component in task.system.components
    )
    system = task.system.model_copy(update={"components": components})
    return run_rows(replace(task, system=system), values)
