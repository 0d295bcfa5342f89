"""A list of control points and the flight whose pictures it names."""

from __future__ import annotations

import numpy as np
import pytest

from frontend.camera import Camera
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.streams import Frames, Gps
from slam.io.gcp_list import read_gcp_list

NAMES = ("DJI_0010.JPG", "sub/DJI_0020.JPG", "DJI_0030.JPG")
UTM = ["WGS84 UTM 32N"]
ROWS = [
    "465005.0 5249995.0 402.5 100.5 200 DJI_0010.JPG north",
    "465005.0 5249995.0 402.5 300 210 dji_0020 north",
    "465025.0 5250010.0 401 10 20 DJI_0010.JPG south check",
]


def flight() -> Flight:
    camera = Camera((1000.0, 1000.0), (799.5, 649.5), (1600, 1300))
    gps = Gps(np.arange(3.0), np.full(3, 47.4028), np.full(3, 8.5362), np.full(3, 450.0))
    return Flight(
        "photos",
        camera=camera,
        frames=Frames(np.arange(3.0), NAMES, lambda _: None),
        gps=gps,
        all_keyframes=True,
    )


def read(tmp_path, lines, of=None):
    path = tmp_path / "gcp_list.txt"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return read_gcp_list(path, flight() if of is None else of)


def refused(tmp_path, lines, of=None) -> str:
    with pytest.raises(InputError) as error:
        read(tmp_path, lines, of)
    message = str(error.value)
    assert "\n" not in message
    assert "gcp_list.txt" in message
    return message
