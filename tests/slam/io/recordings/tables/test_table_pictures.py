"""Tables whose rows name pictures: the pictures come along with the readings."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from slam.core.errors import InputError
from tests.slam.io.recordings.read_recording import read
from tests.slam.io.recordings.tables.made_table import table


def pictures(folder):
    (folder / "frames").mkdir()
    for k in range(3):
        cv2.imwrite(str(folder / "frames" / f"{k}.png"), np.full((48, 64), 10 * k, np.uint8))


def test_pictures_of_a_table_have_its_times(tmp_path):
    pictures(tmp_path)
    rows = ("0.5,frames/0.png,1.5", ",frames/1.png,1.5", "1.5,,1.6", "2.5,frames\\2.png,1.7")
    flight = read(table(tmp_path / "a.csv", "time [s],filename,range [m]", *rows))
    assert flight.frames.stamps_s == pytest.approx([0, 2])
    assert flight.frames.load(1).max() == 20
    assert flight.sonar.range_m.tolist() == [1.5, 1.6, 1.7]
    flight = read(tmp_path / "a.csv", cam0="")
    assert flight.frames is None
    assert len(flight.sonar.range_m) == 3


def test_names_without_files_are_a_column_that_is_left(tmp_path):
    flight = read(table(tmp_path / "a.csv", "time [s],filename,range [m]", "0,a.png,1", "1,b.png,2"))
    assert flight.frames is None
    assert [source.channel for source in flight.sources if not source.stream] == ["picture"]


def test_a_picture_outside_of_the_folder_is_refused(tmp_path):
    path = table(tmp_path / "a.csv", "time [s],filename,range [m]", "0,../a.png,1")
    with pytest.raises(InputError, match="leads out of the folder"):
        read(path)


@pytest.mark.parametrize("label", ["/etc", "../x", "x" * 300, "x" * 300 + ".png"])
def test_a_column_that_names_no_pictures_is_left(tmp_path, label):
    flight = read(table(tmp_path / "a.csv", "time [s],label,range [m]", f"0,{label},1"))
    assert flight.frames is None
    assert len(flight.sonar.range_m) == 1
