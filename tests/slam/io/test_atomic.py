"""Outputs appear whole or not at all."""

import errno
import fcntl
import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from slam.core.errors import InputError
from slam.io.atomic import atomic_file, atomic_folder, partial_path, write_whole

ROOT = Path(__file__).parents[3]


def names(folder):
    return sorted(p.name for p in folder.iterdir())


def test_file_appears_only_when_complete(tmp_path):
    target = tmp_path / "deep" / "a.tif"
    with atomic_file(target) as temporary:
        assert temporary.suffix == ".tif"
        assert partial_path(target) in temporary.parents
        temporary.write_text("new")
        assert not target.exists()
    assert target.read_text() == "new"
    assert names(target.parent) == ["a.tif"]


def test_failure_keeps_the_old_file(tmp_path):
    target = tmp_path / "a.txt"
    target.write_text("old")

    def interrupted():
        with atomic_file(target) as temporary:
            temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert target.read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


def test_file_may_be_recreated_by_its_writer(tmp_path):
    with atomic_file(tmp_path / "a.bin") as temporary:
        temporary.unlink()
        temporary.write_bytes(b"1")
    assert names(tmp_path) == ["a.bin"]


def test_permissions_are_the_users(tmp_path):
    with atomic_file(tmp_path / "a") as temporary:
        temporary.write_text("x")
    (tmp_path / "b").write_text("x")
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "b").stat().st_mode


def test_folder_appears_only_when_complete(tmp_path):
    target = tmp_path / "deep" / "out"
    with atomic_folder(target) as temporary:
        (temporary / "sub").mkdir()
        (temporary / "sub/a").write_text("x")
        assert not target.exists()
    assert (target / "sub/a").read_text() == "x"
    assert names(target.parent) == ["out"]


def test_empty_target_folder_is_accepted(tmp_path):
    (tmp_path / "out").mkdir()
    with atomic_folder(tmp_path / "out") as temporary:
        (temporary / "a").touch()
    assert names(tmp_path / "out") == ["a"]


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_non_empty_target_is_refused_and_kept(tmp_path, kind):
    target = tmp_path / "out"
    if kind == "folder":
        target.mkdir()
        (target / "mine").touch()
    else:
        target.touch()
    with pytest.raises(InputError, match="exists already"), atomic_folder(target):
        pytest.fail("must not start")
    assert names(tmp_path) == ["out"]
    assert kind == "file" or names(target) == ["mine"]


def test_replacing_keeps_the_old_folder_until_complete(tmp_path):
    target = tmp_path / "out"
    target.mkdir()
    (target / "old").touch()

    def failing():
        with atomic_folder(target, may_replace=lambda _: None) as temporary:
            (temporary / "new").touch()
            raise RuntimeError

    with pytest.raises(RuntimeError):
        failing()
    assert names(target) == ["old"]
    with atomic_folder(target, may_replace=lambda _: None) as temporary:
        (temporary / "new").touch()
        assert names(target) == ["old"]
    assert names(target) == ["new"]
    assert names(tmp_path) == ["out"]


def test_second_run_is_refused(tmp_path):
    with atomic_folder(tmp_path / "out") as one:
        (one / "a").touch()
        with pytest.raises(InputError, match="another run"), atomic_folder(tmp_path / "out"):
            pytest.fail("must not start")
        assert names(one) == ["a"]
    with (
        atomic_file(tmp_path / "f") as _,
        pytest.raises(InputError, match="another run"),
        atomic_file(tmp_path / "f"),
    ):
        pytest.fail("must not start")


CHILD = """
import sys, time
sys.path.insert(0, sys.argv[1])
from slam.io.atomic import atomic_folder
with atomic_folder(sys.argv[2], may_replace=lambda _: None) as folder:
    (folder / "half").write_text("x")
    print("ready", flush=True)
    time.sleep(600)
"""


@pytest.mark.parametrize("old", [True, False])
def test_run_after_a_kill_starts_clean(tmp_path, old):
    target = tmp_path / "out"
    if old:
        target.mkdir()
        (target / "old").touch()
    child = subprocess.Popen([sys.executable, "-c", CHILD, ROOT, target], stdout=subprocess.PIPE)
    assert child.stdout.readline() == b"ready\n"
    child.send_signal(signal.SIGKILL)
    child.wait()
    child.stdout.close()
    assert target.exists() == old
    with atomic_folder(target, may_replace=lambda _: None) as folder:
        assert names(folder) == []
        (folder / "whole").touch()
    assert names(target) == ["whole"]
    assert names(tmp_path) == ["out"]


KILLED_BETWEEN = """
import os, signal, sys
sys.path.insert(0, sys.argv[1])
from slam.io.atomic import atomic_folder
rename = os.rename
def killing(old, new):
    rename(old, new)
    if new.name == sys.argv[3]:
        os.kill(os.getpid(), signal.SIGKILL)
os.rename = killing
with atomic_folder(sys.argv[2], may_replace=lambda _: None) as folder:
    (folder / "b").touch()
"""


@pytest.mark.parametrize("moment", ["old", "replaced"])
def test_run_killed_between_the_renames_is_recovered(tmp_path, moment):
    """The old folder stands aside and the new one has not come: the old one comes back."""
    (tmp_path / "out").mkdir()
    (tmp_path / "out/a").touch()
    command = [sys.executable, "-c", KILLED_BETWEEN, ROOT, tmp_path / "out", moment]
    assert subprocess.run(command, check=False).returncode == -signal.SIGKILL
    assert names(tmp_path) == [".out.partial"]
    with pytest.raises(InputError, match="exists already"), atomic_folder(tmp_path / "out"):
        pytest.fail("must not start")
    assert names(tmp_path / "out") == ["a"]
    assert names(tmp_path) == ["out"]


def test_an_unchecked_old_folder_is_never_removed(tmp_path):
    """A run was killed when it had moved the folder aside, and the user made another of that name."""
    test_dir = tmp_path / "out"
    test_dir.mkdir()
    (test_dir / "a").touch()
    command = [sys.executable, "-c", KILLED_BETWEEN, ROOT, test_dir, "old"]
    assert subprocess.run(command, check=False).returncode == -signal.SIGKILL
    test_dir.mkdir()
    with pytest.raises(InputError, match="moved aside"), atomic_folder(test_dir):
        pytest.fail("must not start")
    assert names(tmp_path / ".out.partial/old") == ["a"]


@pytest.mark.parametrize("building", [atomic_file, atomic_folder])
@pytest.mark.parametrize("kind", ["file", "folder", "link"])
def test_a_foreign_working_folder_is_refused_and_kept(tmp_path, building, kind):
    theirs = tmp_path / ".out.partial"
    (tmp_path / "real").mkdir()
    (tmp_path / "real/new").touch()
    if kind == "file":
        theirs.touch()
    elif kind == "folder":
        (tmp_path / "real").rename(theirs)
    else:
        theirs.symlink_to("real")
    before = sorted(str(p) for p in tmp_path.rglob("*"))
    with pytest.raises(InputError, match="did not write"), building(tmp_path / "out"):
        pytest.fail("must not start")
    assert sorted(str(p) for p in tmp_path.rglob("*")) == before


def failing(error):
    def fail(*_: object, **__: object) -> None:
        raise error

    return fail


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS])
@pytest.mark.parametrize("building", [atomic_file, atomic_folder])
def test_a_full_disk_is_one_line_about_the_target(tmp_path, building, number):
    with pytest.raises(InputError, match="out: cannot be written") as caught, building(tmp_path / "out"):
        raise OSError(number, os.strerror(number))
    assert "\n" not in str(caught.value)
    assert names(tmp_path) == []


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_errors_of_its_own_steps_name_the_target(tmp_path, monkeypatch, step):
    (tmp_path / "out").write_text("old")
    monkeypatch.setattr(os, step, failing(OSError(errno.EIO, os.strerror(errno.EIO))))
    with pytest.raises(InputError, match="out: cannot be written; the disk reports a fault"):
        write_whole(tmp_path / "out", b"new")
    assert names(tmp_path) == ["out"]
    assert (tmp_path / "out").read_text() == "old"


@pytest.mark.parametrize("building", [atomic_file, atomic_folder])
def test_errors_elsewhere_pass_unchanged(tmp_path, building):
    """Neither a file that is missing, nor one beside the target, nor a disk that cannot be read."""
    for error in (
        FileNotFoundError(errno.ENOENT, "gone", str(tmp_path / "in.txt")),
        PermissionError(errno.EACCES, "denied", "/nowhere/in.txt"),
        IsADirectoryError(errno.EISDIR, "is a folder", str(tmp_path)),
        OSError(errno.EIO, os.strerror(errno.EIO)),
    ):
        with pytest.raises(OSError, match=re.escape(str(error))) as caught, building(tmp_path / "out"):
            raise error
        assert caught.value is error
    with pytest.raises(InputError, match="out: cannot be written"), building(tmp_path / "out") as partial:
        raise PermissionError(errno.EACCES, "denied", str(partial / "a"))
    assert names(tmp_path) == []


def test_created_parents_are_removed_after_a_failure(tmp_path):
    with pytest.raises(ZeroDivisionError), atomic_file(tmp_path / "a" / "b" / "out"):
        raise ZeroDivisionError
    with pytest.raises(InputError), atomic_folder(tmp_path / "a" / ("x" * 300)):
        pytest.fail("must not start")
    assert names(tmp_path) == []


def test_impossible_targets_are_refused(tmp_path):
    (tmp_path / "file").touch()
    for place in (tmp_path / "file" / "a", tmp_path / ("x" * 300)):
        with pytest.raises(InputError), atomic_file(place):
            pytest.fail("must not start")
        with pytest.raises(InputError), atomic_folder(place):
            pytest.fail("must not start")
    for place in (".", "/"):
        with pytest.raises(InputError, match="no name"), atomic_folder(place):
            pytest.fail("must not start")
    with pytest.raises(InputError, match="folder"), atomic_file(tmp_path):
        pytest.fail("must not start")


def test_a_run_that_looks_into_a_new_working_folder_leaves_it_to_the_one_that_made_it(tmp_path, monkeypatch):
    """The other run locks the folder before its marker is written, finds none, and gives up."""
    target, opened = tmp_path / "out", os.open

    def watched(path, *flags):
        if path == partial_path(target) and not (path / "slam-working-folder.txt").exists():
            other = opened(path, os.O_RDONLY)
            fcntl.flock(other, fcntl.LOCK_EX)
            threading.Timer(0.05, os.close, [other]).start()
        return opened(path, *flags)

    monkeypatch.setattr("slam.io.atomic.os.open", watched)
    with atomic_folder(target) as folder:
        (folder / "a").write_text("whole")
    assert names(tmp_path) == ["out"]


def test_many_runs_on_one_target_leave_one_complete_output(tmp_path):
    """Whoever wins, the output holds one run's two files and nothing else is left."""
    script = """
import sys
sys.path.insert(0, sys.argv[1])
from slam.core.errors import InputError
from slam.io.atomic import atomic_folder
for k in range(15):
    try:
        with atomic_folder(sys.argv[2], may_replace=lambda _: None) as folder:
            (folder / "a").write_text(sys.argv[3])
            (folder / "b").write_text(sys.argv[3])
    except InputError:
        pass
"""
    runs = [
        subprocess.Popen([sys.executable, "-c", script, ROOT, tmp_path / "out", str(k)]) for k in range(3)
    ]
    assert all(run.wait(timeout=300) == 0 for run in runs)
    assert names(tmp_path) == ["out"]
    assert (tmp_path / "out/a").read_text() == (tmp_path / "out/b").read_text()
