"""Pictures that a list of control points names, and those of the flight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.core.streams import Frames
from slam.io.photos.import_photos import import_photos
from tests.slam.io.made_gcp_list import ROWS, UTM, flight, read, refused
from tests.slam.io.photos.photo_files import fill, jpeg


def test_a_picture_may_have_blanks_in_its_name(tmp_path):
    names = ("my flight/north side 1.jpg", "b.jpg")
    of = replace(flight(), frames=Frames(np.arange(2.0), names, lambda _: None))
    rows = [f"465005.0 5249995.0 402.5 100 200 {name} gate check" for name in ("North side 1.jpg", "b.jpg")]
    ((point,), notes) = read(tmp_path, [*UTM, *rows], of)
    assert ([view.picture for view in point.views], point.name, point.role) == (list(names), "gate", "check")
    assert not notes


def test_a_name_of_two_pictures_is_refused(tmp_path):
    two = replace(flight(), frames=Frames(np.arange(2.0), ("a/X.JPG", "b/X.JPG"), lambda _: None))
    assert "several; write its folder too" in refused(tmp_path, [*UTM, "1 2 3 4 5 X.JPG"], two)


@pytest.mark.parametrize("names", [("a/X.JPG", "b/X.JPG"), ("a_X.JPG", "b_X.JPG")])
def test_pictures_of_a_folder_that_is_not_mapped_are_left_out(tmp_path, names):
    """The list may be that of all folders, of which some are mapped."""
    two = replace(flight(), frames=Frames(np.arange(2.0), names, lambda _: None))
    rows = [f"465005.0 5249995.0 402.5 4 5 {folder}/X.JPG here" for folder in "abc"]
    ((point,), (note,)) = read(tmp_path, [*UTM, *rows], two)
    assert [view.picture for view in point.views] == list(names)
    assert "line 4: no picture of the flight has this name" in str(note)
    assert "c/X.JPG" in str(note)


@pytest.mark.parametrize("name", ["X.JPG", "a/X.JPG", "a_X.JPG"])
def test_pictures_of_one_name_in_other_folders_are_not_those_of_the_flight(tmp_path, name):
    of = replace(flight(), name="a", frames=Frames(np.arange(1.0), (name,), lambda _: None))
    rows = [f"465005.0 5249995.0 402.5 {k} 5 {each} here" for k, each in enumerate(("b/X.JPG", "a/X.JPG"))]
    ((point,), (note,)) = read(tmp_path, [*UTM, *rows], of)
    assert [view[1:] for view in point.views] == [(1.0, 5.0)]
    assert "b/X.JPG" in str(note)


def test_a_picture_in_two_folders_that_may_both_be_the_flights_is_refused(tmp_path):
    of = replace(flight(), frames=Frames(np.arange(1.0), ("X.JPG",), lambda _: None))
    rows = [f"465005.0 5249995.0 402.5 4 5 {each}/X.JPG here" for each in "bc"]
    assert "in several folders, of which the flight has one" in refused(tmp_path, [*UTM, *rows], of)
    same = ["images/X.JPG", "/home/me/images/X.JPG", "X.JPG"]
    rows = [f"465005.0 5249995.0 402.5 4 5 {each} {k}" for k, each in enumerate(same)]
    points, notes = read(tmp_path, [*UTM, *rows], of)
    assert len(points) == 3
    assert not notes


def test_photographs_of_one_name_are_told_apart_by_their_folder(tmp_path):
    """The names are those that a folder of photographs gives them."""
    files = {f"{folder}/P{k}.jpg": jpeg(seed=k) for k, folder in enumerate("ab")}
    files |= {f"{folder}/Q.jpg": jpeg(seed=9 + k, place=(30.17, -98.09)) for k, folder in enumerate("ab")}
    folder = fill(tmp_path / "photos", files)
    of = import_photos(folder)
    rows = ["-98.09 30.17 300 3 4 a/Q.jpg here", f"-98.09 30.17 300 5 6 {folder}\\b\\Q.JPG here"]
    ((point,), notes) = read(tmp_path, ["EPSG:4326", *rows], of)
    assert [view.picture for view in point.views] == ["a_Q.jpg", "b_Q.jpg"]
    assert not notes
    assert "several; write its folder too" in refused(tmp_path, ["EPSG:4326", "-98 30 3 4 5 Q.jpg"], of)


def test_rows_of_other_pictures_are_named_and_left_out(tmp_path):
    (north, _), (note,) = read(tmp_path, [*UTM, *ROWS, ROWS[0].replace("0010", "9999")])
    assert len(north.views) == 2
    assert "line 5: no picture of the flight has this name" in str(note)
    assert "DJI_9999.JPG" in str(note)
