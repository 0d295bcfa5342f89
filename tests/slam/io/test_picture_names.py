"""Names that files write for pictures, where the paths of the pictures are known."""

from __future__ import annotations

from slam.io.picture_names import PictureNames


def test_an_exact_path_comes_before_a_name_that_looks_like_it():
    names = PictureNames.of(["a_x.jpg", "x.jpg"], ["a_x.jpg", "a/x.jpg"])

    found = names.matched(["a/X.jpg", "a_x.jpg"], "flight")

    assert found.picture == {"a/X.jpg": "x.jpg", "a_x.jpg": "a_x.jpg"}
    assert PictureNames.of(["a_x.jpg", "x.jpg"]).find("a/x.jpg") == "a_x.jpg"


def test_names_in_other_folders_are_unknown_beside_the_exact_path():
    names = PictureNames.of(["x.jpg"], ["x.jpg"])

    found = names.matched(["x.jpg", "b/x.jpg", "c/x.jpg"], "flight")

    assert found.picture == {"x.jpg": "x.jpg"}
    assert found.unknown == ("b/x.jpg", "c/x.jpg")
    assert found.unclear == ()


def test_a_name_in_another_folder_than_that_of_the_picture_is_unknown():
    names = PictureNames.of(["x.jpg"], ["a/x.jpg"])

    found = names.matched(["b/x.jpg"], "flight")

    assert (found.picture, found.unknown) == ({}, ("b/x.jpg",))
    assert PictureNames.of(["x.jpg"]).matched(["b/x.jpg"], "flight").picture == {"b/x.jpg": "x.jpg"}
