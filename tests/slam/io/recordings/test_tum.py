"""Folders in the layout of the TUM RGB-D benchmark."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from slam.cli.source import kind_of
from slam.core.errors import InputError
from slam.io.flight_folder import read_flight, write_flight
from slam.io.recordings.assemble import flight_of
from slam.io.recordings.formats import open_recording

HALF = math.sqrt(0.5)
# A camera that looks straight down with its top to +x: half a turn about (1, -1, 0); x, y, z, w.
DOWN = (HALF, -HALF, 0.0, 0.0)


def folder(root: Path, truth: str, names: tuple[str, ...] = ("rgb/a.png", "rgb/b.png")) -> Path:
    (root / "rgb").mkdir(parents=True)
    for name in names:
        cv2.imwrite(str(root / name), np.full((48, 64, 3), 90, np.uint8))
    lines = [f"{1305031102.175304 + 0.1 * k:.6f} {name}" for k, name in enumerate(names)]
    (root / "rgb.txt").write_text(
        "# color images\n# file: x\n# timestamp filename\n" + "\n".join(lines) + "\n"
    )
    (root / "groundtruth.txt").write_text("# ground truth trajectory\n" + truth)
    return root


def read(path: Path):
    assert kind_of(path) == "recording"
    return flight_of(open_recording(path))


def test_the_pose_of_the_camera_becomes_that_of_the_body(tmp_path):
    """The camera looks straight down with its top along x, so the body is level and its yaw is 0."""
    row = " ".join(map(str, (1.5, 2.5, 3.5, *DOWN)))
    flight = read(folder(tmp_path / "a", f"1305031102.1753 {row}\n1305031102.2753 {row}\n"))
    assert flight.truth.w_T_b[0] == pytest.approx(
        np.array([[1, 0, 0, 1.5], [0, 1, 0, 2.5], [0, 0, 1, 3.5], [0, 0, 0, 1.0]]), abs=1e-9
    )
    assert flight.epoch_ns == 1_305_031_102_175_300_000, "stamps are not rounded to a float"
    assert flight.frames.stamps_s == pytest.approx([4e-6, 0.100004], abs=1e-9)
    assert flight.camera.focal_std_ratio > 0


def test_the_lens_of_the_benchmark(tmp_path):
    root = folder(tmp_path / "rgbd_dataset_freiburg2_desk", "")
    for name in ("a", "b"):
        cv2.imwrite(str(root / "rgb" / f"{name}.png"), np.zeros((480, 640, 3), np.uint8))
    camera = read(root).camera
    assert (camera.focal_px, camera.center_px) == ((520.9, 521.0), (325.1, 249.7))
    assert camera.distortion[4] == 0.9172


def test_an_import_keeps_pictures_and_their_names(tmp_path):
    root = folder(tmp_path / "a", "")
    write_flight(read(root), tmp_path / "flight")
    assert read_flight(tmp_path / "flight").frames.names == ("a.png", "b.png")
    assert (tmp_path / "flight/mav0/cam0/data/a.png").read_bytes() == (root / "rgb/a.png").read_bytes()


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("rgb.txt", "1.5\n", r"rgb\.txt, line 1: has a line without a picture"),
        ("rgb.txt", "soon rgb/a.png\n", r"rgb\.txt, line 1: has the stamp 'soon'"),
        ("rgb.txt", "1.5 ../../etc/passwd\n", "leads out of the folder"),
        ("rgb.txt", "# nothing\n", "lists no picture"),
        ("groundtruth.txt", "1.5 1 2 3\n", r"groundtruth\.txt, line 1: has a line without a pose"),
    ],
)
def test_a_damaged_list_is_one_line(tmp_path, name, text, message):
    root = folder(tmp_path / "a", "")
    (root / name).write_text(text)
    with pytest.raises(InputError, match=message):
        read(root)


def test_a_missing_picture_is_counted(tmp_path):
    root = folder(tmp_path / "a", "")
    (root / "rgb" / "b.png").unlink()
    frames = read(root).frames
    assert (frames[1].read(), frames.failures) == (None, {1: "missing"})
