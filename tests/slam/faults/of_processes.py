"""Faults 50 to 52: a run that is killed or interrupted, a disk that refuses, memory, and two runs at once."""

from __future__ import annotations

import errno
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from slam.cli import app
from slam.io.atomic import locked
from tests.slam.faults.fault import Event, Sources, assert_refused, listing

STAGES = ("track", "neighbours", "graph", "loops", "refine")
"""Stages of a map, each named on standard error when it begins."""


def started(source: Path, out: Path, until: str) -> subprocess.Popen[str]:
    """A run in a process of its own that has begun a stage."""
    command = [sys.executable, "-m", "slam", "optimize", str(source), "--out", str(out), "--no-mosaic"]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(command, text=True, env=environment, **pipes)
    assert process.stderr is not None
    assert any(line.startswith(until) for line in process.stderr), until
    return process


def result_of(source: Path, out: Path) -> bytes:
    """The trajectory of an undisturbed run."""
    arguments = ["optimize", str(source), "--out", str(out), "--no-mosaic"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.stderr
    return (out / "trajectory.tum").read_bytes()


def killed(sources: Sources, place: Path) -> str:
    """Kill a run in each stage; the next one gives what an undisturbed one gives, and leaves nothing else."""
    source, out = sources["optimize"], place / "out"
    for stage in STAGES:
        process = started(source, out, stage)
        process.kill()
        process.communicate(timeout=300)
        assert not out.exists(), stage
    assert result_of(source, out) == result_of(source, place / "undisturbed")
    assert sorted(path.name for path in place.iterdir()) == ["out", "undisturbed"]
    return "the same"


def interrupted(sources: Sources, place: Path) -> str:
    """Ctrl-C ends the stage that runs: no other one begins."""
    process = started(sources["optimize"], place / "out", "track")
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=300)
    assert not [line for line in stderr.splitlines() if line.startswith(STAGES[1:])]
    assert process.returncode == 130
    assert listing(place) == []
    return stderr


def refused_by_the_system(call: str, number: int) -> Callable[[Sources, Path], str]:
    """The system refuses a call on a new run over an old output, which stays as it was."""

    def play(sources: Sources, place: Path) -> str:
        (place / "graph.g2o").write_bytes((sources["graph"] / "laps.g2o").read_bytes())
        result_of(place / "graph.g2o", place / "out")
        before = {path: path.read_bytes() for path in place.rglob("*") if path.is_file()}

        def refuse(*_: object, **__: object) -> None:
            raise OSError(number, os.strerror(number))

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(os, call, refuse)
            result = CliRunner().invoke(
                app, ["optimize", str(place / "graph.g2o"), "--out", str(place / "out")]
            )
        assert_refused(result.exit_code, result.stderr)
        assert {path: path.read_bytes() for path in place.rglob("*") if path.is_file()} == before
        return result.stderr

    return play


def limited(limit: int, size: int) -> Callable[[Sources, Path], str]:
    """A run under a limit of the system."""

    def play(sources: Sources, place: Path) -> str:
        def restrict() -> None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(limit, (size, size))

        command = [sys.executable, "-m", "slam", "optimize", str(sources["graph"] / "laps.g2o")]
        command += ["--out", str(place / "out")]
        done = subprocess.run(command, capture_output=True, text=True, check=False, preexec_fn=restrict)
        assert_refused(done.returncode, done.stderr)
        assert listing(place) == []
        return done.stderr

    return play


def killed_for_memory(sources: Sources, place: Path) -> str:
    """The system kills the child that works, as it does where memory runs out; the parent says what to do."""
    process = started(sources["optimize"], place / "out", "track")
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    assert len(children) == 1
    os.kill(int(children[0]), signal.SIGKILL)
    _, stderr = process.communicate(timeout=300)
    assert_refused(process.returncode, stderr)
    assert not (place / "out").exists()
    return stderr


def two_runs(sources: Sources, place: Path) -> str:
    with locked(place / "out"):
        graph = str(sources["graph"] / "laps.g2o")
        result = CliRunner().invoke(app, ["optimize", graph, "--out", str(place / "out")])
    assert_refused(result.exit_code, result.stderr)
    assert listing(place) == []
    return result.stderr


FAULTS = (
    Event(50, "killed in every stage", "R", "the same", killed, is_slow=True),
    Event(51, "full disk", "E", "disk is full", limited(resource.RLIMIT_FSIZE, 4096), is_slow=True),
    Event(51, "fault of the disk", "E", "disk reports a fault", refused_by_the_system("fsync", errno.EIO)),
    Event(51, "read-only disk", "E", "read-only", refused_by_the_system("mkdir", errno.EROFS)),
    Event(51, "Ctrl-C", "R", "interrupted; nothing was written", interrupted, is_slow=True),
    Event(52, "little address space", "E", "raise the limit", limited(resource.RLIMIT_AS, 512 << 20)),
    Event(52, "killed for memory", "E", "memory ran out; .*--gsd", killed_for_memory, is_slow=True),
    Event(52, "two runs on one output", "E", "another run is writing it", two_runs),
)
