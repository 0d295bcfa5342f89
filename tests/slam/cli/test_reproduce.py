"""``slam reproduce`` from end to end, on the experiments that need no camera."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from slam.cli import app
from slam.cli.output_folder import REPRODUCE_NAMES

NAMES = ("squares", "arithmetic")


def run(*arguments):
    return CliRunner().invoke(app, ["reproduce", *map(str, arguments)])


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reproduce") / "out"
    result = run(*NAMES, "--out", folder, "--seeds", 2, "--jobs", 1)
    assert result.exit_code == 0, result.output
    assert "reproduce.html" in result.output
    assert "agrees in part" in result.output
    return folder


def test_the_files_are_those_of_the_list(out):
    names = {path.name for path in out.iterdir()}
    figures = {f"{n}.{k}" for n in NAMES for k in ("json", "png")}
    assert names == {".slam-output", "reproduce.html", "summary.json", *figures}
    assert names <= set(REPRODUCE_NAMES)
    for name in NAMES:
        with Image.open(out / f"{name}.png") as picture:
            assert np.asarray(picture.convert("L")).std() > 10


def test_a_record_holds_both_figures_the_spread_and_every_seed(out):
    record = json.loads((out / "squares.json").read_text())
    assert [trial["seed"] for trial in record["trials"]] == [0, 1]
    row = record["rows"][0]
    (ours,) = row["ours"].values()
    gaps = [trial["horizontal_square/gap from end to start"] for trial in record["trials"]]
    assert ours["median"] == pytest.approx(np.median(gaps))
    assert min(gaps) <= ours["lower95"] <= ours["median"] <= ours["upper95"] <= max(gaps)
    assert ours["seeds"] == 2
    checked = json.loads((out / "arithmetic.json").read_text())
    assert len(checked["trials"]) == 1, "what is not random runs once"
    assert all(row["paper"] for row in checked["rows"])


def test_the_summary_has_verdicts_and_sentences(out):
    summary = json.loads((out / "summary.json").read_text())
    assert list(summary["experiments"]) == list(NAMES)
    for name in NAMES:
        record = json.loads((out / f"{name}.json").read_text())
        short = summary["experiments"][name]
        assert short["sentence"] == record["sentence"]
        assert short["sentence"].lower().startswith(short["verdict"])
        assert short["headline"] == record["rows"][0]


def test_the_page_stands_alone_and_has_every_row(out):
    page = (out / "reproduce.html").read_text()
    assert not re.search(r"(src|href)=\"(?!data:|#)", page)
    for name in NAMES:
        for row in json.loads((out / f"{name}.json").read_text())["rows"]:
            assert row["name"].replace("'", "&#39;") in page


def test_an_earlier_output_is_replaced(out):
    assert run("arithmetic", "--out", out, "--jobs", 1).exit_code == 0
    assert not (out / "squares.json").exists()


@pytest.mark.slow
def test_jobs_do_not_change_figures(tmp_path):
    for jobs in (1, 2):
        result = run("squares", "--out", tmp_path / f"{jobs}", "--seeds", 2, "--jobs", jobs)
        assert result.exit_code == 0, result.output
    one, two = ((tmp_path / jobs / "squares.json").read_bytes() for jobs in ("1", "2"))
    assert one == two


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("tabel1",), 1, "did you mean 'table1'"),
        (("hover", "--seeds", "0"), 2, "--seeds"),
        (("hover", "--jobs", "0"), 2, "--jobs"),
    ],
)
def test_wrong_arguments_are_refused(tmp_path, arguments, code, words):
    result = run(*arguments, "--out", tmp_path / "out")
    assert result.exit_code == code
    assert words in result.output
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("what", "code", "words"), [("interrupt", 130, "interrupted"), ("kill", 1, "--jobs")]
)
def test_an_interrupt_or_a_killed_worker_leaves_one_line_and_no_files(tmp_path, request, what, code, words):
    out = tmp_path / "out"
    command = ["reproduce", "table5", "--seeds", "200", "--jobs", "2", "--out", str(out)]
    main = [sys.executable, "-m", "slam"]
    # A shell that runs the tests in the background ignores interrupts, and its children inherit that.
    with_interrupts = [sys.executable, "-c", _RESTORE_INTERRUPTS, *main, *command]
    running = subprocess.Popen(
        with_interrupts, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    request.addfinalizer(lambda: _kill_group(running.pid))
    assert running.stderr is not None
    assert "table5" in running.stderr.readline(), "a first flight is done"
    workers = [worker for job in _children(running.pid) for worker in _children(job)]
    assert len(workers) == 2
    if what == "interrupt":
        os.killpg(running.pid, signal.SIGINT)
    else:
        os.kill(workers[0], signal.SIGKILL)
    _, errors = running.communicate(timeout=300)
    assert running.returncode == code, errors
    assert len([line for line in errors.splitlines() if line.startswith("slam: ")]) == 1
    assert words in errors
    assert not out.exists()
    assert not list(tmp_path.iterdir())
    assert not any(map(_runs, workers))


def _runs(process: int) -> bool:
    """Return whether a process runs; a zombie has ended, and only waits to be reaped."""
    try:
        stat = Path(f"/proc/{process}/stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


_RESTORE_INTERRUPTS = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
os.execv(sys.argv[1], sys.argv[1:])
"""


def _kill_group(leader: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(leader, signal.SIGKILL)


def _children(parent: int) -> list[int]:
    """Child processes but for the one that keeps account of shared resources."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            ancestor = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            line = (path / "cmdline").read_bytes()
        except OSError:
            continue
        if ancestor == parent and b"resource_tracker" not in line:
            found.append(int(path.name))
    return found
