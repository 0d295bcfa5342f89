"""Workers on a cluster of Dask: processes of this machine, or those of a scheduler, on many machines."""

from __future__ import annotations

import logging
import os
import pickle
import signal
import socket
import tempfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from importlib import import_module
from typing import Any
from urllib.parse import urlsplit

from frontend.cores import usable_cores
from frontend.workers import Item, Ready, Result, Shared, Workers, share_with
from slam.core.errors import InputError
from slam.core.version import VERSION
from slam.parallel.processes import limit_threads

UNREACHABLE_S = 3.0
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
    if scheduler is not None:
        _check_address(scheduler)  # in an instant, while the library takes seconds to load
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
        workers = Cluster(client, count, "--cluster" if scheduler is None else f"--scheduler {scheduler}")
        stack.enter_context(share_with(workers))
        yield workers


class _TiedToProcessError(Exception):
    """The shared input of a stage's jobs cannot be sent to another process."""


class Cluster(Workers):
    """The workers of a scheduler."""

    def __init__(self, client: Any, count: int, name: str) -> None:
        super().__init__(count)
        self._client, self._name = client, name

    @contextmanager
    def executor(self, count: int) -> Iterator[Executor]:
        """Raises ``InputError`` where the scheduler goes away, or where one job ends several workers."""
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
        """Return a handle of the value, which each worker fetches once."""
        # The result of a task is computed again when the worker that holds it dies; scattered data are lost.
        try:
            pickled = import_module("cloudpickle").dumps(value)
        except (pickle.PicklingError, TypeError, AttributeError, ValueError):
            raise _TiedToProcessError from None
        shared: Shared = self._client.submit(_loaded, pickled, pure=False)
        return shared

    def within(self, at_once: int | None) -> int:
        """Return the number of workers: they have memory of their own."""
        return self.count

    def submit(
        self, pool: Executor, job: Callable[[Shared, Item], Result], shared: Shared, item: Item
    ) -> Future[Result]:
        """Hand out a job to a worker, where it uses one thread."""
        return pool.submit(_alone, job, shared, item)

    def map(
        self,
        job: Callable[[Shared, Item], Result],
        shared: Shared,
        items: Iterable[Item | Ready[Result]],
        at_once: int | None = None,
        ahead: int | None = None,
    ) -> Iterator[Result]:
        """As `Workers.map`; jobs on what is open in this process, such as a video, are its threads' jobs."""
        try:
            yield from super().map(job, shared, items, at_once, ahead)
        except _TiedToProcessError:
            yield from Workers().map(job, shared, items, at_once, ahead)

    def _taken(
        self, job: Callable[[Shared, Item], Result], shared: Shared, item: Item | None, done: Future[Result]
    ) -> Result:
        result = done.result()
        if result is None and item is not None:  # the worker cannot read what the job is about: can we?
            result = job(shared, item)
            if result is not None:
                raise InputError(
                    f"{self._name}: a worker cannot read a picture that can be read here; put the pictures "
                    "into a folder that all machines see at the same absolute path, and give that path"
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
    loggers = [logging.getLogger(name) for name in logging.root.manager.loggerDict if _of_library(name)]
    before = [logger.level for logger in loggers]
    for logger in loggers:  # each has a level and a handler of its own
        logger.setLevel(_NOTHING)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def _of_library(name: str) -> bool:
    return name.partition(".")[0] in ("distributed", "tornado")


@contextmanager
def _local(distributed: Any, count: int) -> Iterator[str]:
    """Start workers on this machine, which end with the block at once, whatever they are doing."""
    settings = import_module("dask").config
    with (
        tempfile.TemporaryDirectory(prefix="slam-cluster-", ignore_cleanup_errors=True) as folder,
        settings.set({"temporary-directory": folder}),
    ):
        local = distributed.LocalCluster(
            n_workers=0,
            threads_per_worker=1,
            memory_limit=0,
            # Its server of HTTP cannot be left out: a free port, for this machine alone, without pages.
            dashboard_address="127.0.0.1:0",
            scheduler_kwargs={"dashboard": False},
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
    client = distributed.Client.__new__(distributed.Client)
    try:
        client.__init__(address, timeout=UNREACHABLE_S, set_as_default=False)
    except Exception:  # noqa: BLE001  of another program that answers, it takes any bytes for a message
        client.status = "closed"  # or the library tries for ten more seconds to close it
        raise _unreachable(address) from None
    try:
        yield client
    finally:
        client.close(timeout=1)


def _check_address(scheduler: str) -> None:
    """Raise ``InputError`` where nothing listens at an address: the library tries again until its timeout."""
    try:
        place = urlsplit(scheduler if "://" in scheduler else f"tcp://{scheduler}")
        if place.scheme not in ("tcp", "tls") or not place.hostname or not place.port:
            raise _unreachable(scheduler)
        socket.create_connection((place.hostname, place.port), UNREACHABLE_S).close()
    except (OSError, ValueError):
        raise _unreachable(scheduler) from None


def _unreachable(address: str) -> InputError:
    return InputError(
        f"--scheduler {address}: no scheduler of Dask answers; check the address, such as "
        "tcp://10.0.0.5:8786, and that `dask scheduler` runs there"
    )


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
