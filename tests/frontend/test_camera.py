"""Camera: projection, its inverse, the floor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frontend.camera import Camera
from frontend.homography import transfer
from tests.frontend.floor_pairs import CAMERA, FISHEYE, FISHY, body, look, mounted

angle = st.floats(-0.4, 0.4)
TURNED = mounted((0.3, -0.2, 1.0), (0.1, 0.05, -0.04))


@settings(max_examples=40, deadline=None)
@given(
    yaw=st.floats(-3.1, 3.1), pitch=angle, roll=angle, floor_z=st.floats(-2, 2), height=st.floats(0.3, 400)
)
@pytest.mark.parametrize("camera", [CAMERA, TURNED])
def test_floor_homography_inverts_projection(
    camera: Camera, yaw: float, pitch: float, roll: float, floor_z: float, height: float
) -> None:
    w_T_b = body(3, -7, floor_z + height, yaw, pitch, roll)
    pixel = np.array([[30.0, 20], [160, 120], [100, 200]])
    w_p = transfer(camera.floor_H_image(w_T_b, floor_z), pixel)
    np.testing.assert_allclose(camera.floor_points(w_T_b, pixel, floor_z), w_p, atol=1e-7 * height)
    w_T_c = w_T_b @ camera.b_T_c
    c_p = (np.column_stack([w_p, np.full(3, floor_z)]) - w_T_c[:3, 3]) @ w_T_c[:3, :3]
    np.testing.assert_allclose(camera.project(c_p), pixel, atol=1e-6)


@pytest.mark.parametrize("camera", [CAMERA, FISHY, replace(FISHY, focal_px=(200.0, 200.0)), FISHEYE])
def test_undistortion_inverts_projection(camera: Camera) -> None:
    u, v = np.meshgrid(np.linspace(0, 319, 17), np.linspace(0, 239, 13))
    pixel = np.column_stack([u.ravel(), v.ravel()])
    back = camera.project(camera.rays(camera.undistort(pixel)) * 2.5)
    np.testing.assert_allclose(back, pixel, atol=1e-5)
    assert camera.undistort(np.empty((0, 2))).shape == (0, 2)


def test_distortion_is_opencvs_radial_and_tangential_polynomial() -> None:
    ray = np.array([[0.4, -0.3, 1.0]])
    k1, k2, p1, p2 = FISHY.distortion
    x, y, r2 = 0.4, -0.3, 0.25
    radial = 1 + k1 * r2 + k2 * r2**2
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    expected = np.array([[xd, yd]]) * FISHY.focal_px + FISHY.center_px
    np.testing.assert_allclose(FISHY.project(ray * 3), expected, atol=1e-9)


def test_the_distance_of_a_fisheyes_pixel_is_a_polynomial_of_the_angle() -> None:
    ray, angle = np.array([[0.4, -0.3, 1.0]]), np.arctan(0.5)
    radius = angle + 0.05 * angle**3 - 0.03 * angle**5 + 0.02 * angle**7 - 0.01 * angle**9
    expected = radius * np.array([[0.8, -0.6]]) * FISHEYE.focal_px + FISHEYE.center_px
    np.testing.assert_allclose(FISHEYE.project(ray * 3), expected, atol=1e-9)


@pytest.mark.parametrize("camera", [FISHY, FISHEYE])
def test_a_map_of_recorded_pixels_is_the_projection(camera: Camera) -> None:
    size = width, height = camera.size_px
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    pixel = np.column_stack([u.ravel(), v.ravel()]).astype(float)
    found = np.stack(camera.recorded_maps(camera.matrix, size), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(found, camera.recorded(pixel), atol=1e-3)


def test_recorded_pixels_are_those_that_undistortion_came_from() -> None:
    recorded = np.array([[10.0, 20], [160, 120], [300, 210]])
    np.testing.assert_allclose(FISHY.recorded(FISHY.undistort(recorded)), recorded, atol=1e-3)
    np.testing.assert_array_equal(CAMERA.recorded(recorded), recorded)


def test_points_behind_the_camera_and_rays_above_the_horizon_have_no_picture() -> None:
    assert np.isnan(CAMERA.project(np.array([[0.0, 0, -1], [0, 0, 0]]))).all()
    # Nose down by 80 degrees: the top of the picture looks over the horizon, the bottom at the floor.
    w_T_b = body(0, 0, 1, 0, np.radians(-80))
    floor = CAMERA.floor_points(w_T_b, np.array([[160.0, 0], [160, 239]]))
    assert np.isnan(floor[0]).all()
    assert np.isfinite(floor[1]).all()


def test_nadir_footprint_has_the_nose_at_the_top_and_the_size_of_the_field_of_view() -> None:
    camera = Camera((100.0, 100.0), (49.5, 39.5), (100, 80))
    top_left, top_right, bottom_right, bottom_left = camera.footprint(body(5, 6, 2.0), 0.0)
    np.testing.assert_allclose(top_left, [5 + 0.79, 6 + 0.99])
    np.testing.assert_allclose(top_right, [5 + 0.79, 6 - 0.99])
    np.testing.assert_allclose(bottom_right, [5 - 0.79, 6 - 0.99])
    np.testing.assert_allclose(bottom_left, [5 - 0.79, 6 + 0.99])
    assert np.linalg.norm(camera.footprint(body(5, 6, 2.0), 1.0)[0] - [5, 6]) == pytest.approx(
        np.linalg.norm(top_left - [5, 6]) / 2
    )


def test_footprint_of_a_distorted_camera_projects_onto_the_corner_pixels() -> None:
    w_T_b = body(1, 2, 0.8, 0.7, 0.1, -0.1)
    np.testing.assert_allclose(
        look(FISHY, w_T_b, FISHY.footprint(w_T_b)), FISHY.undistort(FISHY.corners_px), atol=1e-6
    )
