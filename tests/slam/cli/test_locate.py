"""The table of located pictures."""

import csv
import io
import os
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from slam.cli import app
from slam.cli.locate import _first_readable, locations_csv
from slam.mapping.relocation import nowhere


def test_a_picture_whose_name_is_not_utf_8_has_a_row():
    pictures = [Path(os.fsdecode(b"in/caf\xe9.jpg")), Path('in/"a", b.jpg')]
    text = locations_csv([(path, nowhere("unreadable: missing")) for path in pictures])
    text.encode("utf-8")
    rows = list(csv.reader(io.StringIO(text)))
    assert [row[:2] for row in rows[1:]] == [
        ["in/caf\\xe9.jpg", "unreadable: missing"],
        ['in/"a", b.jpg', "unreadable: missing"],
    ]


@pytest.mark.parametrize(
    ("names", "saying"),
    [
        (["broken.png"], r"the picture cannot be read: .*broken\.png \(no PNG, JPEG or TIFF\)"),
        (["broken.png", "gone.jpg"], r"none of the pictures can be read: .*, .*gone\.jpg \(missing\)"),
    ],
)
def test_pictures_none_of_which_can_be_read_are_refused_before_the_map_is_read(tmp_path, names, saying):
    (tmp_path / "broken.png").write_bytes(b"no picture")
    pictures = [str(tmp_path / name) for name in names]
    folders = {f"--{name}": str(tmp_path / name) for name in ("map", "flight", "out")}
    ran = CliRunner().invoke(app, ["locate", *pictures, *(word for pair in folders.items() for word in pair)])
    assert ran.exit_code == 1
    assert re.fullmatch(rf"slam: {saying}; give complete PNG, JPEG or TIFF files\n", ran.stderr), ran.stderr
    assert os.listdir(tmp_path) == ["broken.png"]


def test_the_picture_that_was_decoded_for_the_check_is_kept(tmp_path):
    paths = [tmp_path / name for name in ("gone.png", "a.png", "b.png")]
    for level, path in enumerate(paths[1:]):
        cv2.imwrite(str(path), np.full((4, 5), level, np.uint8))
    ((path, picture),) = _first_readable(paths).items()
    assert (path, picture.shape, picture.max()) == (paths[1], (4, 5), 0)
