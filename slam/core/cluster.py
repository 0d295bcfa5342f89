"""Workers on a cluster of Dask: processes of this machine, or those of a scheduler, on many machines."""

from __future__ import annotations

import logging
import os
import pickle
import signal
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from importlib import import_module
from typing import Any

from frontend.cores import usable_cores
from frontend.workers import Item, Result, Shared, Workers, share_with
from slam.core.errors import InputError
from slam.core.processes import limit_threads
from slam.core.version import VERSION

UNREACHABLE_S = 5.0
"""Time for the scheduler to answer, and for its first worker to come."""
_NOTHING = logging.CRITICAL + 1
"""Level of the log that lets nothing through."""
_SETTINGS = {
    # Memory that a mosaic's plan takes: it is sent once for all tiles.
    "distributed.admin.large-graph-warning-threshold": "1 GB",
    # By default the variables of this process are changed, and with them the threads of its libraries.
    "distributed.nanny.pre-spawn-environ": {},
}


@contextmanager
def cluster(scheduler: str | None = None, count: int | None = None) -> Iterator[Workers]:
    """Share the jobs of this thread among the workers of a cluster until the block ends.

    ``scheduler``: address of a scheduler of Dask, such as tcp://10.0.0.5:8786; None for ``count`` processes
    on this machine, one on each core by default. Photographs must be in a folder that all workers see at the
    same path. The results are the same to the bit as without a cluster.

    Raises ``InputError`` without the packages of the extra ``cluster``, where the scheduler does not answer
    or has no workers, and where a worker has another version of this package.
    """
    distributed = _distributed()
    with ExitStack() as stack:
        stack.enter_context(import_module("dask").config.set(_SETTINGS))
        stack.enter_context(_silent_log())
        if scheduler is None:
            count = count or usable_cores()
            client = stack.enter_context(
                _client(distributed, stack.enter_context(_local(distributed, count)))
            )
        else:
            client = stack.enter_context(_client(distributed, scheduler))
            count = _checked(client, scheduler)
        workers = _Cluster(client, count, "--cluster" if scheduler is None else f"--scheduler {scheduler}")
        stack.enter_context(share_with(workers))
        yield workers


class _Cluster(Workers):
    """The workers of a scheduler."""

    def __init__(self, client: Any, count: int, name: str) -> None:
        super().__init__(count)
        self._client, self._name = client, name

    @contextmanager
    def executor(self, count: int) -> Iterator[Executor]:
        pool = self._client.get_executor(pure=False)
        try:
            yield pool
        except CancelledError:
            raise InputError(
                f"{self._name}: the scheduler went away; start it again, and then the command"
            ) from None
        except Exception as error:
            if type(error).__name__ != "KilledWorker":
                raise
            raise InputError(
                f"{self._name}: a job ended several workers, one after the other; is their memory short?"
            ) from None
        finally:
            pool.shutdown(wait=False)

    def share(self, value: Shared) -> Shared:
        # The result of a task is computed again when the worker that holds it dies; scattered data are lost.
        pickled = import_module("cloudpickle").dumps(value)
        shared: Shared = self._client.submit(_loaded, pickled, pure=False)
        return shared

    def within(self, at_once: int | None) -> int:
        return self.count

    def submit(
        self, pool: Executor, job: Callable[[Shared, Item], Result], shared: Shared, item: Item
    ) -> Future[Result]:
        return pool.submit(_alone, job, shared, item)

    def _taken(
        self, job: Callable[[Shared, Item], Result], shared: Shared, item: Item | None, done: Future[Result]
    ) -> Result:
        result = done.result()
        if result is None and item is not None:  # the worker cannot read what the job is about: can we?
            result = job(shared, item)
            if result is not None:
                raise InputError(
                    f"{self._name}: a worker cannot read a picture that can be read here; put the pictures "
                    "into a folder that all workers see at the same path"
                )
        return result


def _distributed() -> Any:
    try:
        return import_module("distributed")
    except ImportError:
        raise InputError(
            "the package distributed that runs a cluster is not installed; run: pip install "
            "'lemniscate-slam[cluster]'"
        ) from None


@contextmanager
def _silent_log() -> Iterator[None]:
    """Keep what the library logs about lost workers and connections from the screen: they are survived."""
    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(_NOTHING)
    try:
        yield
    finally:
        logger.setLevel(before)


@contextmanager
def _local(distributed: Any, count: int) -> Iterator[str]:
    """Start workers on this machine, which end with the block at once, whatever they are doing."""
    with tempfile.TemporaryDirectory(prefix="slam-cluster-", ignore_cleanup_errors=True) as folder:
        local = distributed.LocalCluster(
            n_workers=0,
            threads_per_worker=1,
            memory_limit=0,
            dashboard_address=None,
            local_directory=folder,
            silence_logs=_NOTHING,
        )
        try:
            local.scale(count)  # they start while this process goes on
            yield local.scheduler_address
        finally:
            for nanny in local.workers.values():
                if nanny.pid is not None:
                    with suppress(ProcessLookupError):
                        os.kill(nanny.pid, signal.SIGKILL)
            local.close()


@contextmanager
def _client(distributed: Any, address: str) -> Iterator[Any]:
    try:
        client = distributed.Client(address, timeout=UNREACHABLE_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"--scheduler {address}: no scheduler of Dask answers ({type(error).__name__}); check the "
            "address, such as tcp://10.0.0.5:8786, and that `dask scheduler` runs there"
        ) from None
    try:
        yield client
    finally:
        client.close(timeout=1)


def _checked(client: Any, scheduler: str) -> int:
    """Wait for workers, check that all have this version, and return how many jobs they run at a time."""
    try:
        client.wait_for_workers(1, timeout=UNREACHABLE_S)
    except TimeoutError:
        raise InputError(
            f"--scheduler {scheduler}: it has no workers; start some with `dask worker {scheduler}`"
        ) from None
    for worker, version in client.run(_version, on_error="return").items():
        if version != VERSION:
            has = f"has version {version} of slam" if isinstance(version, str) else "cannot import slam"
            raise InputError(
                f"--scheduler {scheduler}: the worker {worker} {has}, and this is {VERSION}; install the "
                "same on all machines"
            )
    return sum(client.nthreads().values())


def _version() -> str:
    return VERSION


def _loaded(pickled: bytes) -> Any:
    return pickle.loads(pickled)


def _alone(job: Callable[[Shared, Item], Result], shared: Shared, item: Item) -> Result:
    """Do a job on a worker, with no more threads than its own."""
    _limit_threads()
    return job(shared, item)


_limit_threads = cache(limit_threads)
