"""Limits of the machine: full standard output, no threads, a process that the system ends."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from slam.cli.limits import check_limits
from tests.slam.cli.commands import SQUARE

FULL = Path("/dev/full")
needs_full = pytest.mark.skipif(not FULL.exists(), reason="there is no device that is always full")
needs_linux = pytest.mark.skipif(sys.platform != "linux", reason="commands are supervised on Linux")


def shell(*arguments: object, **options):
    command = [sys.executable, "-m", "slam", *map(str, arguments)]
    return subprocess.run(command, text=True, check=False, timeout=300, **options)


@pytest.fixture
def graph(tmp_path) -> Path:
    path = tmp_path / "square.g2o"
    path.write_text(SQUARE)
    return path


@needs_full
@pytest.mark.parametrize("command", ["--version", "info"])
def test_a_full_standard_output_is_named(graph, command):
    source = () if command == "--version" else (graph,)
    with FULL.open("w") as full:
        done = shell(command, *source, stdout=full, stderr=subprocess.PIPE)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("slam: standard output: the disk is full"), done.stderr
    assert "Traceback" not in done.stderr


@needs_full
def test_a_full_standard_error_costs_no_result(graph, tmp_path):
    with FULL.open("w") as full:
        done = shell("optimize", graph, "--out", tmp_path / "out", stdout=subprocess.PIPE, stderr=full)
    assert done.returncode == 0
    assert (tmp_path / "out" / "summary.json").exists()


def test_a_standard_output_that_cannot_wait_gets_everything(graph):
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    command = [sys.executable, "-m", "slam", "--help"]
    with subprocess.Popen(command, stdout=writer, stderr=subprocess.PIPE, text=True) as running:
        os.close(writer)
        with open(reader) as text:
            assert "criticise" in text.read()
        assert running.stderr is not None
        assert running.stderr.read() == ""
    assert running.returncode == 0


@pytest.mark.parametrize("startable", [0, 1])
def test_threads_that_cannot_be_started(monkeypatch, startable):
    start, left = threading.Thread.start, [startable]

    def refuse(thread: threading.Thread) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise RuntimeError("can't start new thread")
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", refuse)
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "7")
    if not startable:
        with pytest.raises(RuntimeError):
            check_limits()
    else:
        check_limits()
        assert os.environ["OPENBLAS_NUM_THREADS"] == "1"


def supervised(job: str, **options) -> subprocess.Popen:
    """A process whose child does the job."""
    script = f"import os, signal, time\nfrom slam.cli.supervisor import continue_in_child\n{job}"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([sys.executable, "-c", script], text=True, **pipes, **options)


@needs_linux
@pytest.mark.parametrize(
    ("job", "code", "message"),
    [
        ("os.kill(os.getpid(), signal.SIGKILL)", 1, r"slam: [^\n]*memory ran out; [^\n]*--gsd[^\n]*\n"),
        ("os.kill(os.getpid(), signal.SIGSEGV)", 1, r"slam: internal error: [^\n]*SIGSEGV[^\n]*\n"),
        ("os.kill(os.getpid(), signal.SIGTERM)", 143, ""),
        ("os._exit(130)", 130, ""),
        ("pass", 0, ""),
    ],
)
def test_the_end_of_the_child_is_reported(job, code, message):
    process = supervised(f"continue_in_child()\n{job}")
    _, stderr = process.communicate(timeout=300)
    assert process.returncode == code
    assert re.fullmatch(message, stderr), stderr


@needs_linux
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_reaches_the_child_once(sent):
    job = f"""
got = []
signal.signal({int(sent)}, lambda *_: got.append(1))
continue_in_child()
print("ready", flush=True)
while not got:
    time.sleep(0.01)
time.sleep(0.2)  # for a second one
print(len(got))"""
    process = supervised(job, start_new_session=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    os.killpg(process.pid, sent)
    assert process.communicate(timeout=300)[0] == "1\n"


@needs_linux
def test_the_child_does_not_outlive_a_killed_parent():
    process = supervised("continue_in_child()\nprint(os.getpid(), flush=True)\ntime.sleep(600)")
    assert process.stdout is not None
    child = int(process.stdout.readline())
    assert child != process.pid
    process.kill()
    process.communicate(timeout=300)
    for _ in range(6000):
        if not Path(f"/proc/{child}").exists():
            return
        time.sleep(0.05)
    raise AssertionError("the child goes on")
