"""OpenDroneMap's geo.txt against angles and coordinates worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from frontend.camera import NADIR_B_T_C, Camera
from slam.core.geodesy import GeoOrigin
from slam.io.exports.formats import export_map
from tests.slam.io.exports.made_map import exported, made_map, pose

C, S = np.cos(np.radians(10)), np.sin(np.radians(10))


def columns(forward, left, up) -> np.ndarray:
    return np.column_stack([forward, left, up])


def rows(tmp_path, *poses, **changes) -> list[list[str]]:
    target = tmp_path / "geo.txt"
    export_map(exported(made_map(*poses, **changes)), "geo", target)
    first, *lines = target.read_text().splitlines()
    assert first == "EPSG:4326"
    target.unlink()
    return [line.split() for line in lines]


@pytest.mark.parametrize(
    ("R", "yaw_pitch_roll_deg"),
    [
        (columns((0, 1, 0), (-1, 0, 0), (0, 0, 1)), (0, 0, 0)),
        (columns((1, 0, 0), (0, 1, 0), (0, 0, 1)), (90, 0, 0)),
        (columns((-1, 0, 0), (0, -1, 0), (0, 0, 1)), (270, 0, 0)),
        (columns((0, C, S), (-1, 0, 0), (0, -S, C)), (0, 10, 0)),  # the nose is up
        (columns((0, 1, 0), (-C, 0, S), (S, 0, C)), (0, 0, 10)),  # the left wing is up
    ],
)
def test_angles_of_an_aircraft(R, yaw_pitch_roll_deg, tmp_path):
    (row,) = rows(tmp_path, pose(R=R))
    found = np.array(row[4:7], dtype=float)
    np.testing.assert_allclose((found - yaw_pitch_roll_deg + 180) % 360 - 180, 0, atol=1e-3)


def test_positions_and_accuracies(tmp_path):
    """1 m forward (north) and 2 m left give sqrt((1 + 4) / 2) for each horizontal axis; 3 m up."""
    (row,) = rows(tmp_path, pose((100.0, 0.0, 20.0)))
    assert row[0] == "P0.jpg"
    np.testing.assert_allclose(np.array(row[1:3], dtype=float), [0.00089831246, 0], atol=2e-10)
    assert float(row[3]) == pytest.approx(20.0008, abs=1e-4)
    np.testing.assert_allclose(np.array(row[7:], dtype=float), [1.5811, 3.0], atol=1e-4)


def test_odm_sees_the_camera_where_the_map_has_it(tmp_path):
    """Angles and axes as OpenDroneMap defines them: north-east-down, pictures with x right and y up."""
    rng = np.random.default_rng(3)
    tilted = Rotation.from_euler("ZYX", [100, 12, -7], degrees=True).as_matrix()
    b_T_c = NADIR_B_T_C.copy()
    b_T_c[:3, :3] = Rotation.from_rotvec(0.2 * rng.normal(size=3)).as_matrix() @ b_T_c[:3, :3]
    (row,) = rows(tmp_path, pose(R=tilted), camera=Camera((90.0, 90.0), (32, 24), (64, 48), b_T_c=b_T_c))
    y, p, r = np.radians(np.array(row[4:7], dtype=float))
    n_R_vehicle = (
        np.array([[np.cos(y), -np.sin(y), 0], [np.sin(y), np.cos(y), 0], [0, 0, 1]])
        @ np.array([[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]])
        @ np.array([[1, 0, 0], [0, np.cos(r), -np.sin(r)], [0, np.sin(r), np.cos(r)]])
    )
    vehicle_R_picture = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    right, down, ahead = (tilted @ b_T_c[:3, :3]).T
    expected = np.array([[v[1], v[0], -v[2]] for v in (right, -down, -ahead)]).T
    np.testing.assert_allclose(n_R_vehicle @ vehicle_R_picture, expected, atol=2e-6)


def test_yaw_counts_from_north_at_the_camera(tmp_path):
    """Meridians converge by sin(latitude) of the difference in longitude.

    East of the origin, the pole lies to the left of the origin's north: that north is a heading above 0.
    """
    east_m = 5000.0
    (row,) = rows(tmp_path, pose((east_m, 0.0, 0.0)), origin=GeoOrigin(60.0, 10.0, 0.0))
    convergence_deg = (float(row[1]) - 10) * np.sin(np.radians(60))
    assert convergence_deg > 0.07
    assert float(row[4]) == pytest.approx(convergence_deg, abs=2e-4)


def test_an_unknown_covariance_has_no_accuracy(tmp_path):
    (row,) = rows(tmp_path, pose(), covariances=np.full((1, 6, 6), np.nan))
    assert len(row) == 7


def test_names_with_spaces_are_left_out_and_told(tmp_path):
    estimate = made_map(pose(), pose(), frame_names=("my photo.jpg", "P1.jpg"))
    notes = export_map(exported(estimate), "geo", tmp_path / "geo.txt")
    assert [line.split()[0] for line in (tmp_path / "geo.txt").read_text().splitlines()[1:]] == ["P1.jpg"]
    assert any("my photo.jpg" in note for note in notes)


def test_without_an_altitude_a_line_ends_after_the_place(tmp_path):
    """Angles and accuracies are told by their place behind the altitude."""
    (row,) = rows(tmp_path, pose(), origin=GeoOrigin(0.0, 0.0, 0.0, altitude_known=False))
    assert row == ["P0.jpg", "0.0000000000", "0.0000000000"]


def test_pictures_of_several_flights_have_names_for_one_folder(tmp_path):
    """OpenDroneMap looks for the name of a file, without its folder."""
    estimate = made_map(pose(), pose(), frame_names=("a/P0.jpg", "b/P0.jpg"))
    (note,) = export_map(exported(estimate), "geo", tmp_path / "geo.txt")
    assert "from one folder" in note
    names = [line.split()[0] for line in (tmp_path / "geo.txt").read_text().splitlines()[1:]]
    assert names == ["a_P0.jpg", "b_P0.jpg"]
