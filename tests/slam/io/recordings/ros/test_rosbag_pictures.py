"""Pictures and cameras of ROS bags: colours, encodings, sizes and lenses."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from slam.io.recordings.formats import open_recording
from tests.slam.io.recordings.read_recording import read
from tests.slam.io.recordings.ros.made_bag import (
    ROS1,
    ROS2,
    Maker,
    a_flight,
    at,
    picture,
    png,
    ros1,
)

M, M2 = Maker(ROS1), Maker(ROS2)


def with_camera(path: Path, image) -> Path:
    return ros1(
        path, [("/cam/image_raw", at(0), image), ("/cam/camera_info", at(0), M.info(image.header, 5.0))]
    )


def test_pictures_are_the_same_in_any_order(tmp_path):
    flight = read(ros1(tmp_path / "a.bag", a_flight(M)))
    for k in (0, 1, 2, 4, 1, 1, 3, 0):
        assert np.array_equal(flight.frames[k].read(), picture(k)), k


@pytest.mark.parametrize(
    ("encoding", "stored"),
    [
        ("bgr8", lambda p: p),
        ("rgb8", lambda p: p[..., ::-1]),
        ("bgra8", lambda p: np.dstack([p, np.full(p.shape[:2], 7, np.uint8)])),
        ("rgba8", lambda p: np.dstack([p[..., ::-1], np.full(p.shape[:2], 7, np.uint8)])),
    ],
)
def test_colours_of_raw_pictures(tmp_path, encoding, stored):
    header = M.header(at(0), "cam")
    image = M.image(header, stored(picture(9)), encoding)
    path = with_camera(tmp_path / "a.bag", image)
    assert read(path).frames[0].read().reshape(-1, 3)[0].tolist() == [9, 109, 200], "blue, green, red"


def test_grey_bayer_and_sixteen_bit_pictures(tmp_path):
    header = M.header(at(0), "cam")
    red = np.zeros((4, 6), np.uint8)
    red[0::2, 0::2] = 200  # the red cells of RGGB
    deep = np.tile(np.array([0, 0, 77, 77, 77, 77], np.uint16), (4, 1))
    for encoding, pixels, middle in (
        ("mono8", np.full((4, 6), 77, np.uint8), 77),
        ("mono16", deep * 256 + 3, 77),
        ("mono16", deep * 16 + 3, 77),  # 12 bits in the lower ones of 16
        ("bayer_rggb8", red, [0, 0, 200]),
        ("bayer_rggb16", red.astype(np.uint16) * 4, [0, 0, 200]),  # 10 bits
    ):
        image = M.image(header, pixels, encoding)
        path = with_camera(tmp_path / f"{encoding}{pixels.max()}.bag", image)
        flight = read(path)
        assert flight.frames[0].read()[2, 2].tolist() == middle, encoding
        assert any("more than 8 bits" in line for line in flight.warnings) == (pixels.itemsize == 2)


def test_a_compressed_picture_without_a_format_is_known_by_its_bytes(tmp_path):
    header = M.header(at(0), "cam")
    messages = [
        ("/cam/image_raw/compressed", at(0), M.compressed(header, png(7), "")),
        ("/cam/camera_info", at(0), M.info(header, 5.0)),
    ]
    flight = read(ros1(tmp_path / "a.bag", messages))
    assert flight.frames.names[0].endswith(".png")
    assert flight.frames[0].read()[0, 0].tolist() == [7, 107, 200]


@pytest.mark.parametrize(
    ("size_px", "more", "focal_px", "center_px", "why"),
    [
        ((3, 2), {}, 2.5, (1.0, 0.5), "is for 6 x 4 px and is scaled to 3 x 2"),
        ((3, 2), {"binning_x": 2, "binning_y": 2}, 2.5, (1.0, 0.5), "region of interest or binning"),
        ((4, 2), {"roi": (1, 2, 4, 2)}, 5.0, (1.5, -0.5), "region of interest or binning"),
    ],
)
def test_the_lens_is_that_of_the_pictures_resolution(tmp_path, size_px, more, focal_px, center_px, why):
    header = M.header(at(0), "cam")
    info = M.info(header, 5.0)  # of 6 x 4 px, its principal point in the middle
    if "roi" in more:
        region = info.roi
        region.x_offset, region.y_offset, region.width, region.height = more["roi"]
    else:
        info.binning_x, info.binning_y = more.get("binning_x", 0), more.get("binning_y", 0)
    pixels = np.zeros((size_px[1], size_px[0], 3), np.uint8)
    messages = [("/cam/image_raw", at(0), M.image(header, pixels, "bgr8")), ("/cam/camera_info", at(0), info)]
    flight = read(ros1(tmp_path / "a.bag", messages))
    assert (flight.camera.size_px, flight.camera.focal_px[0]) == (size_px, focal_px)
    assert flight.camera.center_px == pytest.approx(center_px)
    assert flight.frames[0].read() is not None
    assert any(why in line for line in flight.warnings)


@pytest.mark.parametrize(
    ("info", "why"),
    [
        (None, "no CameraInfo beside the pictures"),
        ({"focal": 0.0}, "not calibrated"),
        ({"focal": 5.0, "model": "thin_prism", "d": (0.1,) * 4}, "lens model 'thin_prism'"),
    ],
)
def test_a_camera_without_a_known_lens_is_left_with_the_reason(tmp_path, info, why):
    header = M.header(at(0), "cam")
    messages = [
        ("/cam/image_raw", at(0), M.image(header, picture(1), "bgr8")),
        ("/imu", at(0), M.imu(header, (0.0,) * 3, (0.0, 0.0, 9.8))),
    ]
    if info is not None:
        messages.append(("/cam/camera_info", at(0), M.info(header, **info)))
    flight = read(ros1(tmp_path / "a.bag", messages))
    assert flight.camera is None
    assert why in flight.reason_not_read("cam0")
    assert flight.imu is not None


def test_pictures_of_an_unknown_encoding_are_left_with_the_reason(tmp_path):
    header = M.header(at(0), "cam")
    still = (0.0, 0.0, 0.0)
    path = ros1(
        tmp_path / "a.bag",
        [
            ("/cam/image_raw", at(0), M.image(header, np.zeros((4, 6), np.uint8), "foo8")),
            ("/cam/camera_info", at(0), M.info(header, 5.0)),
            ("/imu", at(0), M.imu(M.header(at(0), "base_link"), still, still)),
        ],
    )
    assert "encoding 'foo8' is not read: publish bgr8" in open_recording(path).unread["/cam/image_raw"]
    (source,) = [each for each in read(path).sources if each.channel == "/cam/image_raw"]
    assert "foo8" in str(source)


def test_a_picture_of_another_size_is_left_out(tmp_path):
    messages = a_flight(M)
    other = bytes(cv2.imencode(".png", np.zeros((8, 8, 3), np.uint8))[1])
    messages[5] = (messages[5][0], messages[5][1], M.compressed(M.header(at(1), "cam"), other, "png"))
    frames = read(ros1(tmp_path / "a.bag", messages)).frames
    assert frames[1].read() is None
    assert frames.failures == {1: "is 8 x 8 px, not 6 x 4"}
