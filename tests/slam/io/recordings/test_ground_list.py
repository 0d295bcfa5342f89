"""Lists of pictures and poses as those of the HD Ground database."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from slam.core.errors import InputError
from slam.io.recordings.assemble import flight_of
from slam.io.recordings.formats import open_recording

POSE = "0.999 -0.012 120.5 0.012 0.999 -33.25 0 0 1"


def listed(folder: Path, *lines: str) -> Path:
    (folder / "images").mkdir(exist_ok=True)
    for k in range(3):
        cv2.imwrite(str(folder / "images" / f"{k}.png"), np.full((4, 6, 3), 10 * k, np.uint8))
    path = folder / "train.txt"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_pictures_come_in_the_order_of_the_list_and_what_is_assumed_is_told(tmp_path):
    path = listed(tmp_path, "images/2.png", POSE, "images/0.png", f"* {POSE}", "images/1.png", POSE)
    flight = flight_of(open_recording(path))
    assert [int(frame.read()[0, 0, 0]) for frame in flight.frames] == [20, 0, 10]
    assert flight.frames.stamps_s.tolist() == [0.0, 1.0, 2.0]
    assert flight.truth is None, "the unit of the poses is not stated"
    for assumed in ("no times: one picture a second", "focal length", "looking straight down"):
        assert any(assumed in line for line in flight.warnings), assumed
    assert any(source.channel.startswith("poses") and not source.stream for source in flight.sources)


@pytest.mark.parametrize(
    ("lines", "why"),
    [
        (("images/0.png", POSE, "images/1.png", "1 0 0"), "no pose of nine numbers for images/1.png"),
        (("images/0.png", POSE, "../other.png", POSE), "leads out of the folder"),
        (("images/7.png", POSE), "lists no picture that can be read"),
    ],
)
def test_a_damaged_list_is_one_line(tmp_path, lines, why):
    with pytest.raises(InputError, match=why):
        flight_of(open_recording(listed(tmp_path, *lines)))
