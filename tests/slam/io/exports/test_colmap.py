"""COLMAP's text model: numbers worked out by hand, and pycolmap as an oracle."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from frontend.camera import NADIR_B_T_C, Camera
from slam.core.errors import InputError
from slam.io.exports.colmap import camera_model
from slam.io.exports.formats import export_map
from tests.slam.io.exports.made_map import NORTH, exported, made_map, pose

HALF = np.sqrt(0.5)


def camera(**changes) -> Camera:
    fields = {"focal_px": (100.0, 100.0), "center_px": (31.5, 23.5), "size_px": (64, 48)}
    return Camera(**{**fields, **changes})


def lines(path) -> list[str]:
    return [line for line in path.read_text().splitlines() if not line.startswith("#")]


def test_the_pose_goes_from_the_world_to_the_camera(tmp_path):
    """A camera at (1, 2, 10) looks down with the top of its picture to the north, or to the east.

    To the north, its axes are x east, y south, z down: half a turn about x, (0, 1, 0, 0), with the
    translation -R (1, 2, 10) = (-1, 2, 10). To the east they are x south, y west, z down, so that the
    world's (x, y, z) becomes (-y, -x, -z): half a turn about (1, -1, 0), with the translation (2, 1, 10).
    """
    at = (1.0, 2.0, 10.0)
    export_map(exported(made_map(pose(at, NORTH), pose(at, np.eye(3)))), "colmap", tmp_path / "model")
    assert lines(tmp_path / "model" / "cameras.txt") == ["1 SIMPLE_PINHOLE 64 48 100 32 24"]
    images = lines(tmp_path / "model" / "images.txt")
    assert [len(images), images[1], images[3]] == [4, "", ""]
    for line, number, q, t in (
        (images[0], 1, (0, 1, 0, 0), (-1, 2, 10)),
        (images[2], 2, (0, HALF, -HALF, 0), (2, 1, 10)),
    ):
        words = line.split()
        assert [words[0], *words[8:]] == [str(number), "1", f"P{number - 1}.jpg"]
        found = np.array(words[1:8], dtype=float)
        # A quaternion and its negative are one rotation.
        np.testing.assert_allclose(np.outer(found[:4], found[:4]), np.outer(q, q), atol=1e-9)
        np.testing.assert_allclose(found[4:], t, atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "model", "params"),
    [
        ({}, "SIMPLE_PINHOLE", (100, 32, 24)),
        ({"focal_px": (100.0, 101.0)}, "PINHOLE", (100, 101, 32, 24)),
        ({"distortion": (0.1, 0.0, 0.0, 0.0)}, "SIMPLE_RADIAL", (100, 32, 24, 0.1)),
        ({"distortion": (0.1, 0.02, 0.0, 0.0, 0.0)}, "RADIAL", (100, 32, 24, 0.1, 0.02)),
        ({"distortion": (0.0, 0.0, 0.003, 0.0)}, "OPENCV", (100, 100, 32, 24, 0, 0, 0.003, 0)),
        (
            {"focal_px": (100.0, 101.0), "distortion": (0.1, 0.0, 0.0, 0.0)},
            "OPENCV",
            (100, 101, 32, 24, 0.1, 0, 0, 0),
        ),
        (
            {"distortion": (0.1, 0.02, 0.003, 0.004, 0.05)},
            "FULL_OPENCV",
            (100, 100, 32, 24, 0.1, 0.02, 0.003, 0.004, 0.05, 0, 0, 0),
        ),
        (
            {"distortion": (0.1, 0.02, 0.003, 0.004), "lens": "equidistant"},
            "OPENCV_FISHEYE",
            (100, 100, 32, 24, 0.1, 0.02, 0.003, 0.004),
        ),
    ],
)
def test_the_lens_is_the_smallest_model(changes, model, params, tmp_path):
    lens = camera(**changes)
    assert camera_model(lens) == (model, pytest.approx(params))
    pycolmap = pytest.importorskip("pycolmap")
    export_map(exported(made_map(pose(), camera=lens)), "colmap", tmp_path / "model")
    read = pycolmap.Reconstruction()
    read.read_text(str(tmp_path / "model"))
    theirs = read.cameras[1]
    assert theirs.model.name == model
    points = np.array([[0.1, 0.2, 1.0], [-0.25, 0.15, 1.0], [0.0, 0.0, 1.0]])
    # The pixel of COLMAP at 0.5 is the pixel at 0.
    np.testing.assert_allclose(theirs.img_from_cam(points) - 0.5, lens.project(points), atol=1e-6)


def test_pycolmap_sees_points_of_the_world_where_the_map_does(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    rng = np.random.default_rng(5)
    tilted = [Rotation.from_euler("ZYX", [40 * k, 8, -5], degrees=True).as_matrix() for k in range(4)]
    b_T_c = NADIR_B_T_C.copy()
    b_T_c[:3, :3] = Rotation.from_rotvec([0.1, -0.05, 0.2]).as_matrix() @ b_T_c[:3, :3]
    b_T_c[:3, 3] = (0.1, 0.02, -0.05)
    lens = camera(distortion=(-0.1, 0.02, 0.001, 0.002), b_T_c=b_T_c)
    poses = [pose(rng.normal(size=3) + (0, 0, 10), R) for R in tilted]
    export_map(exported(made_map(*poses, camera=lens)), "colmap", tmp_path / "model")
    read = pycolmap.Reconstruction()
    read.read_text(str(tmp_path / "model"))
    assert sorted(image.name for image in read.images.values()) == [f"P{k}.jpg" for k in range(4)]
    for image in read.images.values():
        w_T_c = poses[int(image.name[1])] @ b_T_c
        for point in rng.normal(size=(5, 3)) * (1, 1, 0.2):
            c_p = w_T_c[:3, :3].T @ (point - w_T_c[:3, 3])
            expected = lens.project(c_p[None])[0]
            np.testing.assert_allclose(image.project_point(point) - 0.5, expected, atol=1e-6)


def test_names_with_spaces_are_left_out_and_told(tmp_path):
    estimate = made_map(pose(), pose(), frame_names=("a b.jpg", "c.jpg"))
    (note,) = export_map(exported(estimate), "colmap", tmp_path / "model")
    assert "a b.jpg" in note
    assert [line.split()[-1] for line in lines(tmp_path / "model" / "images.txt") if line] == ["c.jpg"]


def test_pictures_that_all_have_a_space_are_refused(tmp_path):
    with pytest.raises(InputError, match="every picture has a space"):
        export_map(exported(made_map(pose(), frame_names=("a b.jpg",))), "colmap", tmp_path / "model")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_holds_something_is_refused(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        export_map(exported(made_map(pose())), "colmap", tmp_path / "mine")
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["notes.txt"]
