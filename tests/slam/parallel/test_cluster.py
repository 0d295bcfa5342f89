"""A cluster's workers: here a stand-in for the library that works in threads, and what is refused at once."""

from __future__ import annotations

import socket
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, ThreadPoolExecutor
from typing import Any

import pytest

from frontend.workers import workers
from slam.core.errors import InputError
from slam.parallel.cluster import Cluster, cluster


class Client:
    """Stands in for the client of a scheduler."""

    def get_executor(self, pure: bool) -> Executor:
        assert not pure, "equal jobs are not the same job"
        return ThreadPoolExecutor(2)

    def submit(self, job: Callable[[Any], Any], value: Any, pure: bool) -> Any:
        return job(value)


def on_cluster() -> Cluster:
    return Cluster(Client(), 2, "--cluster")


class Folder:
    """Pictures that a process elsewhere does not see, unless ``shared``."""

    def __init__(self, here: bool = True, shared: bool = False) -> None:
        self.here, self.shared = here, shared

    def __reduce__(self) -> tuple[type[Folder], tuple[bool, bool]]:
        return Folder, (self.shared, self.shared)


def read(folder: Folder, k: int) -> int | None:
    return k if folder.here and k != 3 else None


def test_jobs_are_done_by_the_workers_in_order():
    assert list(on_cluster().map(read, Folder(shared=True), range(6))) == [0, 1, 2, None, 4, 5]


def test_pictures_that_only_this_machine_sees_are_refused():
    with pytest.raises(InputError, match="a worker cannot read a picture that can be read here; put"):
        list(on_cluster().map(read, Folder(), range(6)))


def test_what_cannot_be_sent_is_worked_on_here():
    def job(lock: threading.Lock, k: int) -> int:
        with lock:
            return k

    assert list(on_cluster().map(job, threading.Lock(), range(4))) == [0, 1, 2, 3]


class KilledWorker(Exception):
    pass


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (CancelledError(), "--cluster: the scheduler went away"),
        (KilledWorker("job"), "--cluster: a job ended several workers"),
        (OSError("the disk has gone"), None),
    ],
)
def test_lost_schedulers_and_workers_give_a_line(error, line):
    def job(shared: None, k: int) -> None:
        raise error

    with pytest.raises(InputError if line else type(error), match=line):
        list(on_cluster().map(job, None, range(3)))


def test_all_workers_get_work_whatever_memory_one_machine_has():
    assert on_cluster().within(1) == 2


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:{}", "127.0.0.1:{}", "nowhere", "tcp://:1", "ftp://a:1"]
)
def test_an_unreachable_scheduler_is_one_line_at_once(address):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))  # bound, but nothing listens
        begin = time.monotonic()
        where = address.format(free.getsockname()[1])
        with pytest.raises(InputError, match=f"--scheduler {where}: no scheduler") as refused, cluster(where):
            pass
    assert "\n" not in str(refused.value)
    assert time.monotonic() - begin < 3.0


def test_a_missing_extra_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"run: pip install 'lemniscate-slam\[cluster\]'"), cluster():
        pass
    assert not isinstance(workers(), Cluster)
