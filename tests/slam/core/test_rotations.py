"""Roll, pitch and yaw against scipy's rotations about single axes, and the round trip."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.core.rotations import roll_pitch_yaw_of, rotation_of, up_at
from slam.core.streams import AttitudeSeries

STAMPS_S = np.array([0.0, 1.0, 2.0])


def drawn(count: int = 500) -> np.ndarray:
    """(n, 3) of any attitude."""
    most = [np.pi, 0.999 * np.pi / 2, np.pi]
    return np.random.default_rng(0).uniform(-1, 1, (count, 3)) * most


def test_the_rotation_is_roll_first_then_pitch_then_yaw_about_the_axes_of_the_world():
    angles = drawn()
    roll, pitch, yaw = (
        Rotation.from_euler(axis, a[:, None]) for axis, a in zip("xyz", angles.T, strict=True)
    )
    np.testing.assert_allclose(rotation_of(angles), (yaw * pitch * roll).as_matrix(), atol=1e-14)


def test_angles_survive_the_round_trip():
    angles = drawn()
    np.testing.assert_allclose(roll_pitch_yaw_of(rotation_of(angles)), angles, atol=1e-12)
    turned = Rotation.random(500, rng=np.random.default_rng(1)).as_matrix()
    np.testing.assert_allclose(rotation_of(roll_pitch_yaw_of(turned)), turned, atol=1e-12)


@pytest.mark.parametrize("shape", [(), (1,), (7,), (2, 3), (0,)])
def test_rotations_are_vectorised(shape):
    angles = drawn(6).reshape(-1)[: 3 * int(np.prod(shape))] if 0 not in shape else np.zeros(0)
    angles = np.resize(angles, (*shape, 3)) if angles.size else np.zeros((*shape, 3))
    turned = rotation_of(angles)
    assert turned.shape == (*shape, 3, 3)
    np.testing.assert_allclose(roll_pitch_yaw_of(turned), angles, atol=1e-12)


def test_up_tilts_against_the_body_and_gaps_are_interpolated():
    rolls = AttitudeSeries(STAMPS_S, np.array([[0.0, 0.0, 3.0], [np.nan] * 3, [0.4, 0.0, -3.0]]))
    up = up_at(rolls, np.array([0.0, 1.0, 5.0]))
    expected = [[0.0, np.sin(a), np.cos(a)] for a in (0.0, 0.2, 0.4)]
    np.testing.assert_allclose(up, expected, atol=1e-15)


def test_up_without_an_attitude_is_that_of_a_level_body():
    unknown = AttitudeSeries(STAMPS_S, np.full((3, 3), np.nan))
    for attitude in (None, unknown):
        np.testing.assert_array_equal(up_at(attitude, STAMPS_S), [[0.0, 0.0, 1.0]] * 3)
