"""The lens of a video by model and mode, with values worked out by hand."""

from __future__ import annotations

import math
import os
import struct
from pathlib import Path

import numpy as np
import pytest

from slam.io.recordings.assemble import flight_of
from slam.io.recordings.formats import open_recording
from slam.io.recordings.video.model_lens import lens_of_model
from tests.slam.io.recordings.video.made_video import box, video
from tests.slam.io.recordings.video.test_gpmf import block, nested

SIZE = (1600, 1200)
"""Its corners are 1000 px from the centre."""
SAMPLES = Path(os.environ.get("SLAM_DATA", "")) / "recordings" / "gopro"


def text(kind: bytes, content: bytes) -> bytes:
    return box(kind, struct.pack(">HH", len(content), 0) + content)


def gopro(view_deg: float, mode: bytes) -> bytes:
    name = b"HERO9 Black"
    keys = (
        block(b"MINF", b"c", 1, len(name), name),
        block(b"VFOV", b"c", 1, 1, mode),
        block(b"ZFOV", b"f", 4, 1, struct.pack(">f", view_deg)),
    )
    return box(b"GPMF", nested(b"DEVC", *keys))


@pytest.mark.parametrize(
    ("model", "film_mm"), [(b"FC220", 26), (b"FC3411", 22), (b"fc6310S", 24), (b"Anafi 1.6", 26)]
)
def test_the_focal_length_is_that_of_the_makers_specification(model, film_mm):
    found = lens_of_model(text(b"\xa9mdl", model), SIZE)
    assert found.focal_px == pytest.approx(film_mm / 36 * 1600)
    assert f"{film_mm} mm on 35 mm film by the specification of the" in found.remark


@pytest.mark.parametrize("model", [b"FC2204", b"FC350Z"])
def test_a_zoom_has_not_the_lens_of_a_model_whose_name_begins_its_own(model):
    """Mavic 2 Zoom and Zenmuse Z3, beside FC220 (Mavic Pro) and FC350 (Zenmuse X3)."""
    assert lens_of_model(text(b"\xa9mdl", model), SIZE) is None


def test_an_unknown_model_or_a_damaged_header_gives_none():
    assert lens_of_model(text(b"\xa9mdl", b"FC9999"), SIZE) is None
    assert lens_of_model(b"", SIZE) is None
    assert lens_of_model(struct.pack(">I4s", 3, b"\xa9mdl"), SIZE) is None
    assert lens_of_model(gopro(120.0, b"W")[:-9], SIZE) is None
    assert lens_of_model(gopro(120.0, b"S"), SIZE) is None, "stretched unevenly"
    assert lens_of_model(gopro(math.nan, b"L"), SIZE) is None


def test_a_linear_view_is_a_pinhole():
    """90 degrees from corner to corner: the corner is as far as the focal length."""
    found = lens_of_model(gopro(90.0, b"L"), SIZE)
    assert found.focal_px == pytest.approx(1000)
    assert not any(found.distortion)


def test_a_wide_view_is_equidistant():
    """120 degrees from corner to corner: a ray at 30 degrees is half as far from the centre."""
    found = lens_of_model(gopro(120.0, b"W"), SIZE)
    k1, k2, _, _, k3 = found.distortion
    for degrees, expected_px in ((60, 1000), (30, 500), (15, 250)):
        r = np.tan(np.radians(degrees))
        recorded_px = found.focal_px * r * (1 + k1 * r**2 + k2 * r**4 + k3 * r**6)
        assert recorded_px == pytest.approx(expected_px, abs=10)


def test_the_model_of_a_file_is_read_and_told(tmp_path):
    path = video(tmp_path / "a.mp4")
    content = path.read_bytes()
    at = content.index(b"moov") - 4
    assert int.from_bytes(content[at : at + 4], "big") == len(content) - at, "the index is at the end"
    index = content[at + 8 :].replace(b"udta", b"skip") + box(b"udta", text(b"\xa9mdl", b"FC220"))
    path.write_bytes(content[:at] + box(b"moov", index))
    flight = flight_of(open_recording(path))
    assert flight.camera.focal_px[0] == pytest.approx(26 / 36 * 64)
    assert any("by the specification of the DJI Mavic Pro" in line for line in flight.warnings)


@pytest.mark.skipif("SLAM_DATA" not in os.environ, reason="SLAM_DATA is not set")
def test_a_recorded_video_states_its_view():
    """137.04 degrees over 974.4 px: 407 px for each radian."""
    flight = flight_of(open_recording(SAMPLES / "max-heromode.mp4"))
    assert any("137 degrees of view of the GoPro Max's own record (mode W)" in x for x in flight.warnings)
    k1, k2, _, _, k3 = flight.camera.distortion
    r = np.tan(np.radians(30))
    recorded_px = flight.camera.focal_px[0] * r * (1 + k1 * r**2 + k2 * r**4 + k3 * r**6)
    assert recorded_px == pytest.approx(407 * np.radians(30), rel=0.03)
