"""Expected readings against their definition, and their derivatives against differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from backend.ekf import motion as at
from backend.ekf import readings as kinds
from tests.backend.ekf.test_motion import retracted

BEAM, RANGE_AT, CAMERA_AT, ANTENNA_AT, ORIGIN_AT = (
    np.array([0.05, -0.1, -0.99]),
    np.array([0.1, 0.02, -0.05]),
    np.array([0.2, 0.1, 0.0]),
    np.array([1.2, -0.4, 0.3]),
    np.array([-0.3, 0.2, -0.1]),
)
MODEL = np.concatenate(
    [np.ones(at.BEAM), BEAM / np.linalg.norm(BEAM), RANGE_AT, CAMERA_AT, ANTENNA_AT, ORIGIN_AT]
)


def drawn_state(rng):
    x = rng.normal(0, 1, at.STATE)
    x[2], x[at.X_CLONE_POS + 2] = 1.5, 1.2
    for first in (at.X_ROT, at.X_CLONE_ROT):
        tilted = Rotation.from_euler("ZYX", rng.uniform([-3, -0.6, -0.6], [3, 0.6, 0.6]))
        x[first : first + 4] = tilted.as_quat(scalar_first=True)
    x[at.X_RANGE_SCALE] *= 0.1
    return x


def predicted(kind, x, value, H):
    z = np.empty(6)
    assert kinds.predict(kind, x, value, MODEL, z, H)
    return z


def residual(x, seen, H):
    out = np.empty(6)
    assert kinds.step_residual(x, seen, MODEL, out, H)
    return out


def differences(predict, x):
    """(6, SIZE) central differences along every error of the state."""
    columns = []
    for k in range(at.SIZE):
        e = np.zeros(at.SIZE)
        e[k] = 1e-6
        columns.append((predict(retracted(x, e)) - predict(retracted(x, -e))) / 2e-6)
    return np.column_stack(columns)


READINGS = [n for name, n in kinds.CHANNELS.items() if name != "pictures"]


@pytest.mark.parametrize("kind", READINGS)
@pytest.mark.parametrize("seed", range(5))
def test_derivatives(kind, seed):
    x, H = drawn_state(np.random.default_rng(seed)), np.empty((6, at.SIZE))
    z = predicted(kind, x, np.zeros(3), H)
    scratch = np.empty((6, at.SIZE))
    # Angles are read within half a turn of what was read: give them what is expected.
    expected = differences(lambda y: predicted(kind, y, z[:3], scratch), x)
    np.testing.assert_allclose(H, expected, atol=2e-6)


@pytest.mark.parametrize("seed", range(5))
def test_derivatives_of_a_step(seed):
    rng = np.random.default_rng(seed)
    x, H = drawn_state(rng), np.empty((6, at.SIZE))
    clone, now = (
        Rotation.from_quat(x[k : k + 4], scalar_first=True).as_matrix() for k in (at.X_CLONE_ROT, at.X_ROT)
    )
    height = x[at.X_CLONE_POS + 2] + (clone @ CAMERA_AT)[2]
    seen = np.eye(4)
    seen[:3, :3] = clone.T @ now
    seen[:3, 3] = (
        clone.T @ (x[:3] + now @ CAMERA_AT - x[at.X_CLONE_POS : at.X_CLONE_ROT]) - CAMERA_AT
    ) / height
    np.testing.assert_allclose(residual(x, seen, H), 0, atol=1e-12)
    scratch = np.empty((6, at.SIZE))
    np.testing.assert_allclose(H, -differences(lambda y: residual(y, seen, scratch), x), atol=2e-6)


def test_an_error_of_the_own_attitude_stays_in_the_world():
    """It turns the world under the vehicle: the same lean is roll or pitch, as the vehicle is headed."""
    lean = np.array([0.15, 0.0, 0.0])
    scratch = np.empty((6, at.SIZE))
    for yaw in (0.0, 1.0, 2.5):
        body = Rotation.from_euler("ZYX", [yaw, 0.2, -0.1])
        x = np.zeros(at.STATE)
        x[at.X_ROT : at.X_RATE], x[at.X_CLONE_ROT] = body.as_quat(scalar_first=True), 1.0
        x[at.X_ATTITUDE_ERROR : at.X_ATTITUDE_ERROR + 3] = [*lean[:2], 0.4]
        said = predicted(kinds.ATTITUDE, x, np.full(3, np.nan), scratch)
        own = Rotation.from_rotvec(lean) * Rotation.from_euler("z", 0.4) * body
        read = Rotation.from_euler("ZYX", said[:3][::-1])
        assert (own.inv() * read).magnitude() < 1e-12
