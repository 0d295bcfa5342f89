"""An output folder is whole or absent, whatever happens in between, and belongs to one run at a time."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from slam.cli.output_folder import OPTIMIZE_NAMES, is_output, output_folder
from slam.core.errors import InputError, explain
from slam.io.atomic import locked
from tests.slam.cli.written_output import contents, write_output


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
