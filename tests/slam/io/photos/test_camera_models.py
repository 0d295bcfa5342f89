"""Lenses of OpenSfM's and OpenDroneMap's files, against the projections that OpenSfM documents."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL.ExifTags import Base

from slam.io.photos.import_photos import import_photos
from tests.slam.io.photos.photo_files import fill, jpeg

SIZE = (96, 64)
KEY = "v2 acme mapper 1 5472 3648 brown 0.6666"
SIZED = {"width": 1368, "height": 912}
BROWN = SIZED | {
    "projection_type": "brown", "focal_x": 0.67, "focal_y": 0.668, "c_x": -0.0015, "c_y": 0.0047,
    "k1": -0.26, "k2": 0.1, "p1": 0.0007, "p2": 0.0003, "k3": -0.02,
}  # fmt: skip
RADIAL = SIZED | {"projection_type": "perspective", "focal": 0.7, "k1": -0.05, "k2": 0.01}
FISHEYE = SIZED | {"projection_type": "fisheye", "focal": 0.5, "k1": -0.03, "k2": 0.004}
DEWARP = {"DewarpData": "2020-01-01;70,70,0,0,-0.2,0.1,0,0,0"}


def imported(tmp_path, cameras, name="cameras.json", **of):
    text = cameras if isinstance(cameras, str) else json.dumps(cameras)
    files = {"a.jpg": jpeg(size=SIZE, **of), name: text.encode()}
    return import_photos(fill(tmp_path, files))


def documented(camera, points):
    """Return the pixels (n, 2) of directions x, y, 1 as OpenSfM projects them."""
    x, y = points.T
    if camera["projection_type"] == "fisheye":
        radius = np.hypot(x, y)
        angle = np.arctan(radius)
        factor = angle * (1 + camera["k1"] * angle**2 + camera["k2"] * angle**4) / radius
        x, y = x * factor, y * factor
    else:
        r2 = x**2 + y**2
        p1, p2 = camera.get("p1", 0), camera.get("p2", 0)
        radial = 1 + camera["k1"] * r2 + camera["k2"] * r2**2 + camera.get("k3", 0) * r2**3
        x, y = (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2),
            y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y**2),
        )
    fx = camera.get("focal_x", camera.get("focal"))
    fy = camera.get("focal_y", camera.get("focal"))
    n = np.column_stack([fx * x + camera.get("c_x", 0), fy * y + camera.get("c_y", 0)])
    return n * max(SIZE) + np.array(SIZE) / 2 - 0.5


@pytest.mark.parametrize("camera", [BROWN, RADIAL, FISHEYE])
@pytest.mark.parametrize("name", ["cameras.json", "camera_models.json"])
def test_a_point_lies_where_opensfm_projects_it(tmp_path, camera, name):
    flight = imported(tmp_path, {KEY: camera}, name)
    x, y = np.meshgrid(np.linspace(-0.6, 0.6, 7), np.linspace(-0.4, 0.4, 6))
    points = np.column_stack([x.ravel(), y.ravel()])
    lens = flight.camera
    ideal = np.column_stack([points * lens.focal_px + lens.center_px])
    np.testing.assert_allclose(lens.recorded(ideal), documented(camera, points), atol=2e-3)
    assert lens.focal_std_ratio > 0
    assert lens.radial_std > 0
    (line,) = (line for line in flight.warnings if "focal length" in line)
    assert f"from the calibration of the lens in {name} ({KEY})" in line
    assert not any("not read" in line for line in flight.warnings)


def test_photographs_that_were_scaled_have_the_same_lens(tmp_path):
    tags = {Base.ExifImageWidth: 2 * SIZE[0], Base.ExifImageHeight: 2 * SIZE[1]}
    whole = imported(tmp_path / "a", {KEY: BROWN}).camera
    scaled = imported(tmp_path / "b", {KEY: BROWN}, tags=tags).camera
    np.testing.assert_allclose([*scaled.focal_px, *scaled.center_px], [*whole.focal_px, *whole.center_px])
    assert scaled.distortion == whole.distortion


@pytest.mark.parametrize(
    ("cameras", "words"),
    [
        ({"v2 other drone 5472 3648 brown 0.6": BROWN}, "no calibrated lens of the Mapper 1"),
        ({KEY: BROWN | {"height": 1026}}, "no calibrated lens of the Mapper 1"),
        ({KEY: BROWN | {"projection_type": "spherical"}}, "no calibrated lens"),
        ({KEY: BROWN | {"focal_x": None}}, "no calibrated lens"),
        ({KEY: RADIAL | {"k1": 0.0, "k2": 0.0}}, "no calibrated lens"),
        ("[1, 2]", "holds no cameras of OpenSfM or OpenDroneMap"),
        ("{", "holds no cameras of OpenSfM or OpenDroneMap"),
    ],
)
def test_what_is_not_used_is_told(tmp_path, cameras, words):
    flight = imported(tmp_path, cameras)
    assert any(words in line and "cameras.json" in line for line in flight.warnings)
    assert not flight.camera.is_distorted


def test_a_nameless_camera_fits_any_body_and_the_fitting_one_is_taken(tmp_path):
    cameras = {
        "v2 other drone 1368 912 perspective 0.7": RADIAL,
        "v2 unknown unknown 1368 912 brown 0": BROWN,
    }
    assert imported(tmp_path, cameras).camera.distortion == (-0.26, 0.1, 0.0007, 0.0003, -0.02)


def test_the_maker_s_calibration_is_preferred(tmp_path):
    flight = imported(tmp_path, {KEY: BROWN}, drone=DEWARP)
    assert flight.camera.focal_px == (70.0, 70.0)
    assert any("the tags have a calibration of the lens" in line for line in flight.warnings)


def test_of_two_files_the_overrides_count_and_the_other_is_named(tmp_path):
    files = {"camera_models.json": {KEY: RADIAL}, "camera_models_overrides.json": {KEY: BROWN}}
    texts = {name: json.dumps(cameras).encode() for name, cameras in files.items()}
    flight = import_photos(fill(tmp_path, {"a.jpg": jpeg(size=SIZE)} | texts))
    assert flight.camera.distortion == (-0.26, 0.1, 0.0007, 0.0003, -0.02)
    line = "camera_models.json is not used: camera_models_overrides.json has a calibration of the lens"
    assert line in flight.warnings


def test_a_body_whose_tags_lack_the_focal_length_has_that_of_its_specification(tmp_path):
    """84 degrees across the diagonal by DJI, which is that of 24 mm on film."""
    flight = import_photos(fill(tmp_path, {"a.jpg": jpeg(size=SIZE, make="DJI", model="FC6310")}))
    half = np.hypot(*SIZE) / 2
    assert 2 * np.degrees(np.arctan(half / flight.camera.focal_px[0])) == pytest.approx(84, abs=0.2)
    assert any("by the specification of the DJI Phantom 4 Pro" in line for line in flight.warnings)
    assert flight.camera.focal_std_ratio == 0.03
