"""Folders in the layout of KITTI: times, the lens, and pictures without a time."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from slam.cli.source import open_flight
from slam.core.errors import InputError
from slam.core.progress import silent
from tests.slam.io.recordings.tables.made_table import lines_with

TIMES = "0.000000e+00\n1.000000e-01\n2.500000e-01\n"
CALIBRATION = "P0: 50 0 31.5 0 0 51 23.5 0 0 0 1 0\nP1: 50 0 31.5 -9 0 51 23.5 0 0 0 1 0\n"


def folder(path, times=TIMES, calibration=CALIBRATION):
    (path / "image_0").mkdir()
    for k in range(3):
        cv2.imwrite(str(path / "image_0" / f"{k:06d}.png"), np.full((48, 64), 10 * k, np.uint8))
    (path / "times.txt").write_text(times)
    (path / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    if calibration:
        (path / "calib.txt").write_text(calibration)
    return path


def test_times_and_the_lens_are_read(tmp_path):
    flight, kind = open_flight(folder(tmp_path), silent)
    assert kind == "recording"
    assert flight.frames.stamps_s == pytest.approx([0, 0.1, 0.25])
    assert flight.frames.load(2).max() == 20
    assert flight.camera.focal_px == (50, 51)
    assert flight.camera.center_px == (31.5, 23.5)
    assert [source.channel for source in flight.sources if not source.stream] == ["poses.txt"]


def test_pictures_without_a_time_and_a_lens_that_is_not_told_are_named(tmp_path):
    flight, _ = open_flight(folder(tmp_path, TIMES[:26], ""), silent)
    assert len(flight.frames) == 2
    assert lines_with(flight, ["image_0 has 3 pictures, times.txt 2 times: the first 2 are used"])
    assert lines_with(flight, ["focal length", "assumed"])


@pytest.mark.parametrize(
    ("times", "calibration", "why"),
    [
        ("0\nsoon\n", "", r"times.txt, line 2: has the time 'soon'"),
        (TIMES, "P0: 1 2 3\n", r"calib.txt, line 1: has no projection of 12 numbers for P0:"),
    ],
)
def test_damage_is_one_line(tmp_path, times, calibration, why):
    with pytest.raises(InputError, match=why):
        open_flight(folder(tmp_path, times, calibration), silent)
