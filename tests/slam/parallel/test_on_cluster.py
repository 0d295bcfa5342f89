"""Photographs mapped by real processes of Dask: the same bits, workers that die, Ctrl-C."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from frontend.workers import workers
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.progress import Progress, silent
from slam.experiments.run import run
from slam.io.atomic import partial_path, was_killed
from slam.io.flight_folder import read_flight, write_flight
from slam.mapping.pipeline import optimize
from slam.parallel.cluster import cluster
from slam.parallel.processes import Processes
from slam.report.rasters.mosaic import write_mosaic
from tests.slam.small_flight import flown, photographs

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::ResourceWarning")]

PHOTOGRAPHS = 12


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with photographs of a simulated flight."""
    flight, path = flown(0), tmp_path_factory.mktemp("photographs") / "flight"
    assert flight.frames is not None
    step = len(flight.frames) // (4 * PHOTOGRAPHS)
    write_flight(photographs([(flight, step * k) for k in range(PHOTOGRAPHS)]), path)
    return path


def made(flight: Flight, out: Path, progress: Progress = silent) -> dict[str, bytes]:
    """Return poses, covariances and mosaic of a map."""
    estimate = optimize(flight, progress=progress)
    assert estimate.placed.sum() == PHOTOGRAPHS
    mosaic = write_mosaic(estimate, flight, out, progress=progress)
    return {
        "poses": estimate.w_T_b.tobytes(),
        "covariances": np.ascontiguousarray(estimate.covariances).tobytes(),
        "mosaic": mosaic.png.read_bytes(),
    }


@pytest.fixture(scope="module")
def with_threads(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return made(read_flight(folder), tmp_path_factory.mktemp("threads"))


class Killer:
    """Progress that kills a worker in the middle of a stage."""

    def __init__(self, stage: str) -> None:
        self.stage, self.killed = stage, 0

    def __call__(self, stage: str, done: int, total: int) -> None:
        if stage == self.stage and done >= 1 and not self.killed:
            (self.killed, *_) = workers().map(number_of_process, None, [0])
            os.kill(self.killed, signal.SIGKILL)


def number_of_process(shared: None, item: int) -> int:
    return os.getpid()


@pytest.mark.parametrize("killed_in", ["", "track", "loops", "mosaic"])
def test_a_map_has_the_same_bits_and_survives_a_worker(folder, with_threads, tmp_path, killed_in):
    killer = Killer(killed_in)
    with cluster(count=2):
        assert made(read_flight(folder), tmp_path, killer) == with_threads
    assert bool(killer.killed) == bool(killed_in)
    assert children() == []


def test_another_cluster_on_this_machine_is_no_warning(recwarn):
    """Each has a server of HTTP, and the port that Dask prefers may be taken by any program."""
    with socket.socket() as other:
        with suppress(OSError):  # where it is taken already
            other.bind(("", 8787))
            other.listen()
        with cluster(count=1):
            pass
    assert [str(warning.message) for warning in recwarn if "Port" in str(warning.message)] == []


def test_experiments_have_the_same_figures():
    with cluster(count=2) as chosen:
        there = run(["squares"], 2, chosen)
    np.testing.assert_equal(
        [trial.figures for trial in there["squares"]],
        [trial.figures for trial in run(["squares"], 2, Processes(1))["squares"]],
    )


@pytest.fixture
def lonely_scheduler(tmp_path) -> Iterator[str]:
    """The address of a scheduler without workers."""
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    where = tmp_path / "scheduler.json"
    process = subprocess.Popen(
        [*command, "--no-dashboard", "--scheduler-file", str(where)], stderr=subprocess.DEVNULL, cwd=tmp_path
    )
    try:
        while not where.exists() or not where.read_text().endswith("}"):
            assert process.poll() is None
            time.sleep(0.1)
        yield next(line.split('"')[3] for line in where.read_text().splitlines() if '"address"' in line)
    finally:
        process.terminate()
        process.wait()


def test_a_scheduler_without_workers_is_a_line_within_seconds(lonely_scheduler):
    begin = time.monotonic()
    with pytest.raises(InputError, match="it has no workers; start some"), cluster(lonely_scheduler):
        pass
    assert time.monotonic() - begin < 10.0


@pytest.mark.parametrize("stage", ["track", "neighbours"])
def test_ctrl_c_ends_the_command_and_its_workers_at_once(folder, tmp_path, stage):
    command = [sys.executable, "-m", "slam", "optimize", str(folder), "--cluster", "--out"]
    process = subprocess.Popen(
        [*command, str(tmp_path / "out")],
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    )
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith(stage):
            break
    begin = time.monotonic()
    process.send_signal(signal.SIGINT)
    assert process.stderr.read().splitlines()[-1] == "slam: interrupted; nothing was written"
    assert process.wait() == 130
    assert time.monotonic() - begin < 5.0
    process.stderr.close()
    # Neither outputs nor folders of workers stay, only results with which the next run goes on.
    assert set(tmp_path.iterdir()) <= {partial_path(tmp_path / "out")}
    assert not was_killed(tmp_path / "out")


def children() -> list[str]:
    """Return the processes that this one has started and that run."""
    listed = subprocess.run(
        ["ps", "--ppid", str(os.getpid()), "-o", "args="], capture_output=True, text=True, check=False
    )
    return [line for line in listed.stdout.splitlines() if "spawn_main" in line]
