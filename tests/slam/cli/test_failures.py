"""Failures of the commands: one line, and earlier outputs stay."""

from __future__ import annotations

import os
import re
import resource
import shutil
import signal
import tempfile
from pathlib import Path

import pytest

import slam.__main__
import slam.cli.graph
from tests.slam.cli.commands import SQUARE, assert_refused, last_line, run, shell


@pytest.fixture(scope="module")
def solved(tmp_path_factory) -> Path:
    """The output of the graph; tests copy it before they change it."""
    folder = tmp_path_factory.mktemp("solved")
    (folder / "square.g2o").write_text(SQUARE)
    assert run("optimize", folder / "square.g2o", "--out", folder / "out").exit_code == 0
    return folder / "out"


def test_foreign_files_stay(graph, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("mine")
    assert_refused(run("optimize", graph, "--out", tmp_path / "out"), "thesis.tex")
    assert os.listdir(tmp_path / "out") == ["thesis.tex"]


@pytest.mark.parametrize(
    ("failure", "saying", "code"),
    [
        (KeyboardInterrupt(), "interrupted", 130),
        (MemoryError(), "memory", 1),
        (OSError(12, "Cannot allocate memory", "/out"), "--no-mosaic", 1),
        (ImportError("libopenblas.so: failed to map segment from shared object"), "--no-mosaic", 1),
        (OSError(28, "No space left on device", "/out/mosaic.tif"), "disk is full", 1),
        (OSError(28, "No space left on device", tempfile.gettempdir()), "TMPDIR", 1),
        (BlockingIOError(11, "Resource temporarily unavailable"), "ulimit -u", 1),
        (RuntimeError("can't start new thread"), "ulimit -u", 1),
        (OSError(30, "Read-only file system", "/out/mosaic.tif"), "read-only", 1),
        (ZeroDivisionError("a\nb"), "internal error: ZeroDivisionError", 1),
    ],
)
def test_a_failure_in_the_middle_leaves_the_old_output(
    graph, solved, tmp_path, monkeypatch, failure, saying, code
):
    shutil.copytree(solved, tmp_path / "out")
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}

    def fail(*_: object) -> None:
        raise failure

    monkeypatch.setattr(slam.cli.graph, "_estimate", fail)
    assert_refused(run("optimize", graph, "--out", tmp_path / "out"), saying, code)
    assert_refused(run("optimize", graph, "--out", tmp_path / "fresh"), saying, code)
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before
    assert sorted(os.listdir(tmp_path)) == ["out", "square.g2o"]


def test_debug_prints_the_traceback(graph, tmp_path, monkeypatch):
    monkeypatch.setattr(slam.cli.graph, "_estimate", lambda *_: 1 / 0)
    result = run("--debug", "optimize", graph, "--out", tmp_path / "out")
    assert result.exit_code == 1
    assert "Traceback" in result.stderr
    assert "ZeroDivisionError" in result.stderr


def test_a_full_disk_is_one_line(graph, tmp_path, no_figures):
    """A real refusal of the system, by a limit on the size of files, in a process of its own."""
    assert run("optimize", graph, "--out", tmp_path / "out").exit_code == 0
    before = (tmp_path / "out" / "summary.json").read_bytes()

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))

    done = shell("optimize", graph, "--out", tmp_path / "out", preexec_fn=limit)
    assert done.returncode == 1
    assert re.fullmatch(r"slam: [^\n]+\n", last_line(done.stderr)), done.stderr
    assert (tmp_path / "out" / "summary.json").read_bytes() == before
    assert sorted(os.listdir(tmp_path)) == ["out", "square.g2o"]
