"""Makers' angles to body axes, checked by where the picture's axes point."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from frontend.camera import NADIR_B_T_C
from slam.core.rotations import roll_pitch_yaw_of
from slam.io.gimbal import body_from_gimbal, body_from_mount, tilt_deg

EAST, NORTH, UP = np.eye(3)
angle = st.floats(-180, 180)


def picture_axes(w_R_b):
    """Right, top and viewing direction of the picture in the world."""
    w_R_c = w_R_b @ NADIR_B_T_C[:3, :3]
    return w_R_c[:, 0], -w_R_c[:, 1], w_R_c[:, 2]


@pytest.mark.parametrize(
    "body", [lambda yaw: body_from_gimbal(yaw, -90, 0), lambda yaw: body_from_mount(yaw, 0, 0)]
)
@pytest.mark.parametrize("yaw_deg", [0.0, 30.0, 90.0, -120.0, 180.0])
def test_straight_down_the_top_of_the_picture_points_along_yaw(body, yaw_deg):
    right, top, view = picture_axes(body(yaw_deg))
    clockwise = np.radians(yaw_deg)
    assert_allclose(view, -UP, atol=1e-12)
    assert_allclose(top, np.cos(clockwise) * NORTH + np.sin(clockwise) * EAST, atol=1e-12)
    assert_allclose(right, np.cos(clockwise) * EAST - np.sin(clockwise) * NORTH, atol=1e-12)
    roll, pitch, yaw = roll_pitch_yaw_of(body(yaw_deg))
    assert_allclose([roll, pitch], 0, atol=1e-9)
    assert_allclose(np.exp(1j * yaw), np.exp(1j * (np.pi / 2 - clockwise)), atol=1e-9)


@pytest.mark.parametrize(
    "body", [lambda d: body_from_gimbal(0, -90 + d, 0), lambda d: body_from_mount(0, d, 0)]
)
def test_pitch_above_nadir_tilts_the_view_forward(body):
    _, top, view = picture_axes(body(20.0))
    tilt = np.radians(20)
    assert_allclose(view, np.sin(tilt) * NORTH - np.cos(tilt) * UP, atol=1e-12)
    assert_allclose(top, np.cos(tilt) * NORTH + np.sin(tilt) * UP, atol=1e-12)
    assert tilt_deg(body(20.0)) == pytest.approx(20)
    # In the flight's axes nose up is negative pitch.
    assert_allclose(roll_pitch_yaw_of(body(20.0)), [0, -tilt, np.pi / 2], atol=1e-9)


def test_level_gimbal_looks_along_yaw_with_the_picture_upright():
    right, top, view = picture_axes(body_from_gimbal(90.0, 0.0, 0.0))
    assert_allclose([right, top, view], [-NORTH, UP, EAST], atol=1e-12)


def test_roll_to_the_right_looks_to_the_left():
    _, _, view = picture_axes(body_from_mount(0.0, 0.0, 10.0))
    assert_allclose(view, -np.sin(np.radians(10)) * EAST - np.cos(np.radians(10)) * UP, atol=1e-12)


def test_flipped_gimbal_angles_are_the_same_view():
    """DJI cameras near straight down may report the far side of the singularity."""
    assert_allclose(body_from_gimbal(30, -89, 0), body_from_gimbal(-150, -91, 180), atol=1e-9)


@given(angle, st.floats(-60, 60), angle, st.floats(-25, 25), st.floats(-25, 25))
def test_angles_are_recovered(yaw, off, spin, pitch, roll):
    for body in (body_from_gimbal(yaw, -90 + off, spin), body_from_mount(yaw, pitch, roll)):
        assert_allclose(body.T @ body, np.eye(3), atol=1e-12)
        assert np.linalg.det(body) == pytest.approx(1)
    r, p, y = roll_pitch_yaw_of(body)
    again = Rotation.from_euler("z", y) * Rotation.from_euler("y", p) * Rotation.from_euler("x", r)
    assert_allclose(again.as_matrix(), body, atol=1e-9)
