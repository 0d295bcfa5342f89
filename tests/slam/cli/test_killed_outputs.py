"""What a run that was killed, interrupted or refused leaves beside its output, for the next one."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from slam.cli.output_folder import EVALUATE_NAMES, output_folder
from slam.core.errors import InputError
from slam.io.atomic import checkpoint_path, locked, partial_path
from tests.slam.cli.written_output import contents, write_output

KILLED = """
import os, signal, sys
from pathlib import Path
from slam.cli.output_folder import output_folder
target, moment = Path(sys.argv[1]), sys.argv[2]
rename = os.rename
def killing(old, new):
    if moment == "between the renames" and Path(new) == target and Path(old).name == "new":
        os.kill(os.getpid(), signal.SIGKILL)
    rename(old, new)
os.rename = killing
with output_folder(target) as folder:
    (folder / "summary.json").write_text("new")
    if moment == "while writing":
        os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("moment", ["while writing", "between the renames"])
def test_after_a_kill_the_next_run_gets_the_lock_and_loses_nothing(target, moment):
    write_output(target, "old")
    killed = subprocess.run([sys.executable, "-c", KILLED, str(target), moment], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert target.with_name(".out.partial").exists(), "what it wrote survives, its lock does not"
    with pytest.raises(ZeroDivisionError), output_folder(target):
        raise ZeroDivisionError  # a run that fails shows what the killed one left
    assert contents(target) == {"summary.json": "old", "loops.csv": "old"}
    write_output(target, "newer")
    assert contents(target)["summary.json"] == "newer"
    assert os.listdir(target.parent) == ["out"]


def test_the_run_after_a_killed_one_says_so(target, capsys):
    """A control group that kills all its processes leaves nobody to print a line."""
    write_output(target, "first")
    assert capsys.readouterr().err == ""
    subprocess.run([sys.executable, "-c", KILLED, str(target), "while writing"], check=False)
    write_output(target, "second")
    (line,) = capsys.readouterr().err.splitlines()
    assert "the last run into this folder was killed" in line
    assert "--gsd" in line
    write_output(target, "third")
    assert capsys.readouterr().err == ""


def test_leftovers_of_a_killed_run_lock_nothing(target):
    write_output(target, "old")
    killed = subprocess.run([sys.executable, "-c", KILLED, str(target), "while writing"], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert partial_path(target).is_dir()
    with locked(target):
        pass
    assert os.listdir(target.parent) == ["out"]


KILLED_FILE = """
import os, signal, sys
from slam.io.atomic import atomic_file
with atomic_file(sys.argv[1]) as partial:
    partial.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_leftovers_of_a_killed_evaluation_are_replaced(target):
    write_output(target, "old")
    subprocess.run([sys.executable, "-c", KILLED_FILE, str(target / EVALUATE_NAMES[0])], check=False)
    assert partial_path(target / EVALUATE_NAMES[0]).is_dir()
    write_output(target, "new")
    assert contents(target) == {"summary.json": "new", "loops.csv": "new"}


KEEPING = """
import os, signal, sys
from slam.cli.output_folder import output_folder
from slam.io.atomic import checkpoint_path
with output_folder(sys.argv[1]) as folder:
    checkpoint_path(folder).write_text("results")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def keeping(target: Path, error: BaseException | None) -> None:
    """A run that keeps results, and ends with an error."""
    with output_folder(target) as folder:
        checkpoint_path(folder).write_text("results")
        (folder / "summary.json").write_text("{}")
        if error:
            raise error


def kept(target: Path) -> Path:
    return checkpoint_path(partial_path(target) / "new")


def test_results_of_a_killed_run_stay_until_a_run_has_finished(target, capsys):
    target.parent.mkdir(parents=True, exist_ok=True)
    subprocess.run([sys.executable, "-c", KEEPING, str(target)], check=False)
    assert kept(target).read_text() == "results"
    with locked(target):  # `slam evaluate` of an earlier output
        pass
    assert kept(target).read_text() == "results"
    with output_folder(target) as folder:
        assert checkpoint_path(folder).read_text() == "results"
        (folder / "summary.json").write_text("{}")
    assert os.listdir(target.parent) == ["out"]


@pytest.mark.parametrize("error", [KeyboardInterrupt(), SystemExit(143), MemoryError(), RuntimeError()])
def test_an_interrupted_run_says_that_its_results_are_kept(target, capsys, error):
    with pytest.raises(type(error)):
        keeping(target, error)
    assert kept(target).read_text() == "results"
    assert "goes on with it" in capsys.readouterr().err
    keeping(target, None)
    assert "killed" not in capsys.readouterr().err
    assert os.listdir(target.parent) == ["out"]


def test_a_refused_input_keeps_nothing(target, capsys):
    with pytest.raises(InputError):
        keeping(target, InputError("refused"))
    assert not target.parent.exists() or os.listdir(target.parent) == []
    assert capsys.readouterr().err == ""


def full_disk(is_told: bool) -> Exception:
    """What a writer raises, itself or in one line."""
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    if not is_told:
        return full
    told = InputError("cannot be written")
    told.__context__ = full
    return told


@pytest.mark.parametrize("is_told", [False, True])
def test_results_stay_where_a_full_disk_ends_the_run(target, capsys, is_told):
    """Once some space is free, the same command has only the outputs left to write."""
    with pytest.raises(InputError):
        keeping(target, full_disk(is_told))
    assert kept(target).read_text() == "results"
    assert "goes on with it" in capsys.readouterr().err


def test_another_run_is_not_told_that_its_results_are_kept(target, capsys):
    with output_folder(target) as folder:
        checkpoint_path(folder).write_text("results")
        (folder / "summary.json").write_text("{}")
        with pytest.raises(InputError, match="another run"), output_folder(target):
            pass
    assert capsys.readouterr().err == ""
