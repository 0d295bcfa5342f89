"""An output folder is whole or absent, whatever happens in between, and belongs to one run at a time."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from slam.cli.output_folder import (
    EVALUATE_NAMES,
    MARKER_NAME,
    OPTIMIZE_NAMES,
    is_output,
    output_folder,
)
from slam.core.errors import InputError, explain
from slam.io.atomic import kept_path, locked, partial_path
from tests.slam.cli.test_cli import SQUARE, run


def write_output(target: Path, text: str) -> None:
    with output_folder(target) as folder:
        (folder / "summary.json").write_text(text)
        (folder / "loops.csv").write_text(text)


def contents(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir() if path.name != MARKER_NAME}


@pytest.fixture
def target(tmp_path):
    return tmp_path / "place" / "out"


def test_nothing_is_seen_until_the_end(target):
    with output_folder(target) as folder:
        (folder / "summary.json").write_text("new")
        assert not target.exists()
    assert contents(target) == {"summary.json": "new"}
    assert os.listdir(target.parent) == ["out"], "no lock and no temporary folder is left"


def test_a_failure_leaves_nothing_not_even_new_parents(tmp_path):
    with pytest.raises(ZeroDivisionError), output_folder(tmp_path / "a" / "b" / "out") as folder:  # noqa: PT012
        (folder / "summary.json").write_text("half")
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("failure", [ZeroDivisionError, KeyboardInterrupt, SystemExit, MemoryError])
def test_a_failure_leaves_the_old_output(target, failure):
    write_output(target, "old")
    with pytest.raises(failure), output_folder(target) as folder:  # noqa: PT012
        (folder / "summary.json").write_text("half")
        raise failure
    assert contents(target) == {"summary.json": "old", "loops.csv": "old"}
    assert os.listdir(target.parent) == ["out"]


def test_a_new_output_replaces_the_old_one_whole(target):
    write_output(target, "old")
    with output_folder(target) as folder:
        (folder / "summary.json").write_text("new")
    assert contents(target) == {"summary.json": "new"}, "no file of the old run among those of the new"


@pytest.mark.parametrize(
    "plant",
    [
        lambda d: (d / "thesis.tex").write_text("mine"),
        lambda d: (d / "mosaic.png").mkdir(),
        lambda d: (d / ".git").mkdir(),
    ],
)
def test_foreign_content_is_not_replaced(target, plant):
    write_output(target, "old")
    plant(target)
    before = sorted(os.listdir(target))
    with pytest.raises(InputError, match="did not write") as refusal, output_folder(target):
        pytest.fail("the block must not run")
    assert "\n" not in str(refusal.value)
    assert sorted(os.listdir(target)) == before


def test_files_without_a_summary_are_not_replaced(target):
    target.mkdir(parents=True)
    (target / "mosaic.png").write_text("a picture of theirs")
    with pytest.raises(InputError, match="did not write"), output_folder(target):
        pytest.fail("the block must not run")


def test_an_empty_folder_is_accepted(target):
    target.mkdir(parents=True)
    write_output(target, "new")
    assert is_output(target)


def test_a_file_and_the_current_folder_are_refused(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("mine")
    monkeypatch.chdir(tmp_path)
    for target in ("file", ".", ".."):
        with pytest.raises(InputError, match="--out is"), output_folder(target):
            pytest.fail("the block must not run")
    assert (tmp_path / "file").read_text() == "mine"


def test_an_output_that_the_run_reads_is_not_replaced(target):
    """A map from which pictures are located, or its graph.g2o."""
    write_output(target, "old")
    (target.parent / "link").symlink_to("out")
    for read in (target, target / "loops.csv", target.parent / "link" / "loops.csv"):
        with pytest.raises(InputError, match="which the command reads"), output_folder(target, [read]):
            pass
    with output_folder(target, [target.parent / "other" / "graph.g2o"]):
        pass


def test_a_graph_is_not_replaced_by_its_own_solution(tmp_path):
    graph = tmp_path / "square.g2o"
    graph.write_text(SQUARE)
    assert run("optimize", graph, "--out", tmp_path / "map").exit_code == 0
    written = (tmp_path / "map" / "summary.json").read_text()
    assert run("optimize", tmp_path / "map" / "graph.g2o", "--out", tmp_path / "map").exit_code == 1
    assert (tmp_path / "map" / "summary.json").read_text() == written


def test_a_link_to_a_folder_stays_a_link(tmp_path):
    write_output(tmp_path / "real", "old")
    (tmp_path / "link").symlink_to("real")
    write_output(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink()
    assert contents(tmp_path / "real")["summary.json"] == "new"


def test_a_second_run_into_the_same_folder_is_refused(target):
    with output_folder(target) as folder:
        (folder / "summary.json").write_text("first")
        with pytest.raises(InputError, match="another run"), output_folder(target):
            pytest.fail("the block must not run")
    assert contents(target) == {"summary.json": "first"}


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


def test_a_full_disk_is_reported_in_one_line(target):
    write_output(target, "old")
    with pytest.raises(InputError, match="disk is full"), output_folder(target) as folder:  # noqa: PT012
        (folder / "summary.json").write_text("half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder / "mosaic.tif"))
    assert contents(target) == {"summary.json": "old", "loops.csv": "old"}


def test_a_read_only_place_is_refused_in_one_line(target, monkeypatch):
    def read_only(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(target))

    monkeypatch.setattr(Path, "mkdir", read_only)
    with pytest.raises(InputError, match="read-only"), output_folder(target):
        pytest.fail("the block must not run")


def test_files_can_be_added_to_an_output_by_one_run_at_a_time(target):
    write_output(target, "old")
    with locked(target):
        for other in (locked(target), output_folder(target)):
            with pytest.raises(InputError, match="another run"), other:
                pytest.fail("the block must not run")
        (target / "evaluation.json").write_text("added")
    assert os.listdir(target.parent) == ["out"]
    write_output(target, "new")
    assert "evaluation.json" not in contents(target), "it spoke of the output before"


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


KEEPING = """
import os, signal, sys
from slam.cli.output_folder import output_folder
from slam.io.atomic import kept_path
with output_folder(sys.argv[1]) as folder:
    kept_path(folder).write_text("results")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def keeping(target: Path, error: BaseException | None) -> None:
    """A run that keeps results, and ends with an error."""
    with output_folder(target) as folder:
        kept_path(folder).write_text("results")
        (folder / "summary.json").write_text("{}")
        if error:
            raise error


def kept(target: Path) -> Path:
    return kept_path(partial_path(target) / "new")


def test_results_of_a_killed_run_stay_until_a_run_has_finished(target, capsys):
    target.parent.mkdir(parents=True, exist_ok=True)
    subprocess.run([sys.executable, "-c", KEEPING, str(target)], check=False)
    assert kept(target).read_text() == "results"
    with locked(target):  # `slam evaluate` of an earlier output
        pass
    assert kept(target).read_text() == "results"
    with output_folder(target) as folder:
        assert kept_path(folder).read_text() == "results"
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
        kept_path(folder).write_text("results")
        (folder / "summary.json").write_text("{}")
        with pytest.raises(InputError, match="another run"), output_folder(target):
            pass
    assert capsys.readouterr().err == ""


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


def test_a_foreign_summary_and_report_are_not_replaced(target):
    target.mkdir(parents=True)
    (target / "summary.json").write_text('{"status": "theirs"}')
    (target / "report.html").write_text("theirs")
    with pytest.raises(InputError, match="did not write"), output_folder(target):
        pytest.fail("the block must not run")
    assert contents(target) == {"summary.json": '{"status": "theirs"}', "report.html": "theirs"}


def test_a_name_that_this_output_did_not_write_is_foreign(target):
    """A map without a mosaic into which the user put a picture of that name."""
    write_output(target, "old")
    (target / "mosaic.png").write_text("theirs")
    with pytest.raises(InputError, match=r"mosaic\.png"), output_folder(target):
        pytest.fail("the block must not run")
    assert (target / "mosaic.png").read_text() == "theirs"


def test_what_came_in_during_the_run_is_kept(target):
    write_output(target, "old")
    with pytest.raises(InputError, match=r"out: holds 'notes\.txt'"), output_folder(target) as folder:  # noqa: PT012
        (folder / "summary.json").write_text("new")
        (target / "notes.txt").write_text("theirs")
    assert contents(target) == {"summary.json": "old", "loops.csv": "old", "notes.txt": "theirs"}
    assert os.listdir(target.parent) == ["out"]


def first_version(target: Path) -> None:
    """The files of a map of version 0.1.0: no marker."""
    target.mkdir(parents=True)
    for name in ("graph.g2o", "trajectory.tum", "estimate.npz", "loops.csv", "report.html"):
        (target / name).write_text("old")
    keys = "status frames keyframes edges landmarks timing_s peak_rss_mb warnings"
    (target / "summary.json").write_text(json.dumps(dict.fromkeys(keys.split(), 0)))


def test_an_output_of_the_first_version_is_replaced(target):
    first_version(target)
    write_output(target, "new")
    assert contents(target) == {"summary.json": "new", "loops.csv": "new"}


@pytest.mark.parametrize("lacking", ["graph.g2o", "estimate.npz", "summary.json"])
def test_what_only_resembles_the_first_version_is_kept(target, lacking):
    first_version(target)
    (target / lacking).unlink()
    before = contents(target)
    with pytest.raises(InputError, match="delete it yourself"), output_folder(target):
        pytest.fail("the block must not run")
    assert contents(target) == before


@pytest.mark.parametrize("content", [[], ["new"]])
def test_folders_of_somebody_beside_the_output_stay(target, content):
    def somebodys(name: str) -> Path:
        theirs = target.with_name(name)
        theirs.mkdir(parents=True)
        for entry in content:
            (theirs / entry).touch()
        return theirs

    aside = somebodys(".out.old")
    write_output(target, "new")
    assert os.listdir(aside) == content
    working = somebodys(".out.partial")
    with pytest.raises(InputError, match=r"\.out\.partial.* did not write") as refusal, output_folder(target):
        pytest.fail("the block must not run")
    assert "\n" not in str(refusal.value)
    assert os.listdir(working) == content


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (errno.ENOSPC, "disk is full"),
        (errno.EROFS, "read-only"),
        (errno.EACCES, "permission"),
        (errno.ENOENT, "does not exist"),
        (errno.EIO, "disk"),
    ],
)
def test_system_errors_are_explained(code, message):
    assert message in explain(OSError(code, os.strerror(code), "/some/place"))


def test_unknown_system_errors_keep_the_system_s_words():
    assert explain(OSError(errno.ENXIO, os.strerror(errno.ENXIO))).startswith(os.strerror(errno.ENXIO))


def test_the_names_of_the_output_files():
    contract = (
        "trajectory.tum graph.g2o mosaic.tif mosaic.png report.html summary.json estimate.npz loops.csv"
    )
    assert set(contract.split()) <= set(OPTIMIZE_NAMES)
