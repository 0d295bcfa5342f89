"""Nothing that somebody else made, or that a run reads, is replaced by an output."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from slam.cli.output_folder import output_folder
from slam.core.errors import InputError
from tests.slam.cli.commands import SQUARE, run
from tests.slam.cli.written_output import contents, write_output


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
