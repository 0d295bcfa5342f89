"""Measurement models of the instruments: predicted reading and its Jacobian; numba kernels.

Every function fills the Jacobian H (6, n) by the error state and returns the predicted reading. The caller
forms the innovation and skips missing components.
"""

from __future__ import annotations

import math

import numpy as np

from backend.ekf.motion import (
    ACC,
    ACCEL_BIAS,
    ATTITUDE_ERROR,
    BARO_ZERO,
    CLONE_POS,
    CLONE_ROT,
    GPS_ZERO,
    GYRO_BIAS,
    MOTION,
    POS,
    RANGE_BIAS,
    RANGE_SCALE,
    RATE,
    ROT,
    STATE,
    VEL,
    VEL_ERROR,
    VEL_SCALE,
    X_ACCEL_BIAS,
    X_ATTITUDE_ERROR,
    X_BARO_ZERO,
    X_CLONE_POS,
    X_CLONE_ROT,
    X_GPS_ZERO,
    X_GYRO_BIAS,
    X_RANGE_BIAS,
    X_RANGE_SCALE,
    X_RATE,
    X_ROT,
    X_VEL_ERROR,
    X_VEL_SCALE,
    Array,
    hat,
    left_jacobian,
    rotated,
    rotation,
    rotation_vector,
)
from backend.measurements import GRAVITY_M_S2
from backend.numba_cache import njit

(PROPAGATE, GYRO, ACCEL, ATTITUDE, RANGE, VELOCITY, POSITION, BAROMETER, REST, STILL, STEP, OUTPUT, CLONE) = (
    range(13)
)
"""Kinds of events, in the order of processing at one instant: a mere propagation (a long gap takes short
steps), a reading, zero velocity and zero rotation, a visual step, the output of a pose, its cloning."""
CHANNELS = {
    "gyro": GYRO,
    "accelerometer": ACCEL,
    "attitude": ATTITUDE,
    "range": RANGE,
    "velocity": VELOCITY,
    "position": POSITION,
    "barometer": BAROMETER,
    "rest": REST,
    "still": STILL,
    "pictures": STEP,
}
"""Kinds of readings by name."""

_MIN_HEIGHT_M = 1e-3
_MIN_COSINE = 0.2
"""Smallest usable cosine of a beam or a pitch: beyond it the prediction is singular."""


@njit(cache=True)
def predict(kind: int, x: Array, value: Array, model: Array, H: Array) -> tuple[Array, bool]:
    """Return the predicted reading (6,) of an instrument, and whether it is valid in this state."""
    H[:] = 0.0
    z = np.zeros(6)
    valid = True
    if kind == GYRO:
        z[:3] = x[X_RATE : X_RATE + 3] + x[X_GYRO_BIAS : X_GYRO_BIAS + 3]
        for k in range(3):
            H[k, RATE + k] = H[k, GYRO_BIAS + k] = 1.0
    elif kind == ACCEL:
        _specific_force(x, z, H)
    elif kind == ATTITUDE:
        valid = _attitude(x, value, z, H)
    elif kind == RANGE:
        valid = _range(x, model, z, H)
    elif kind == VELOCITY:
        valid = _heading_velocity(x, z, H)
    elif kind == POSITION:
        for k in range(3):
            z[k] = x[k]
            H[k, POS + k] = 1.0
        z[2] += x[X_GPS_ZERO]
        H[2, GPS_ZERO] = 1.0
    elif kind == BAROMETER:
        z[0] = x[2] + x[X_BARO_ZERO]
        H[0, POS + 2] = H[0, BARO_ZERO] = 1.0
    elif kind == REST:
        for k in range(3):
            z[k] = x[VEL + k]
            H[k, VEL + k] = 1.0
    elif kind == STILL:
        for k in range(3):
            z[k] = x[X_RATE + k]
            H[k, RATE + k] = 1.0
    return z, valid


@njit(cache=True)
def _specific_force(x: Array, z: Array, H: Array) -> None:
    """Predict the specific force: ``R' (a + g) + offset``."""
    R = rotation(x[X_ROT:X_RATE])
    up = x[ACC : ACC + 3].copy()
    up[2] += GRAVITY_M_S2
    force = np.ascontiguousarray(R.T) @ up
    z[:3] = force + x[X_ACCEL_BIAS : X_ACCEL_BIAS + 3]
    H[:3, ACC : ACC + 3] = R.T
    H[:3, ROT : ROT + 3] = hat(force)
    for k in range(3):
        H[k, ACCEL_BIAS + k] = 1.0


@njit(cache=True)
def angles(R: Array) -> Array:
    """Return roll, pitch, yaw (3,) of ``R = Rz(yaw) Ry(pitch) Rx(roll)``."""
    out = np.empty(3)
    out[0] = math.atan2(R[2, 1], R[2, 2])
    out[1] = math.asin(min(max(-R[2, 0], -1.0), 1.0))
    out[2] = math.atan2(R[1, 0], R[0, 0])
    return out


@njit(cache=True)
def angle_rates(R: Array) -> Array:
    """Return the derivatives (3, 3) of roll, pitch, yaw by a right perturbation of R."""
    roll, pitch = math.atan2(R[2, 1], R[2, 2]), math.asin(min(max(-R[2, 0], -1.0), 1.0))
    s, c, cp = math.sin(roll), math.cos(roll), math.cos(pitch)
    t = math.sin(pitch) / cp
    out = np.zeros((3, 3))
    out[0, 0], out[0, 1], out[0, 2] = 1.0, s * t, c * t
    out[1, 1], out[1, 2] = c, -s
    out[2, 1], out[2, 2] = s / cp, c / cp
    return out


@njit(cache=True)
def _attitude(x: Array, value: Array, z: Array, H: Array) -> bool:
    """Predict roll, pitch, yaw of ``Rz(yaw error) Exp(tilt error) R``, yaw within half a turn of the reading.

    The error of an attitude that is integrated from body rates is constant in world axes, not in body axes.
    It is observable when the vehicle turns, and when a wrong tilt converts body rate to yaw rate.
    """
    R = rotation(x[X_ROT:X_RATE])
    if math.sqrt(R[2, 1] ** 2 + R[2, 2] ** 2) < _MIN_COSINE:
        return False
    tilt = np.array([x[X_ATTITUDE_ERROR], x[X_ATTITUDE_ERROR + 1], 0.0])
    own = rotation(rotated(np.array([1.0, 0.0, 0.0, 0.0]), tilt)) @ R
    z[:3] = angles(own)
    z[2] += x[X_ATTITUDE_ERROR + 2]
    for k in (0, 2):
        if math.isfinite(value[k]):
            z[k] += 2 * math.pi * round((value[k] - z[k]) / (2 * math.pi))
    rates = angle_rates(own)
    H[:3, ROT : ROT + 3] = rates
    by_tilt = rates @ np.ascontiguousarray(own.T) @ left_jacobian(tilt)
    H[:3, ATTITUDE_ERROR : ATTITUDE_ERROR + 2] = by_tilt[:, :2]
    H[2, ATTITUDE_ERROR + 2] = 1.0
    return True


@njit(cache=True)
def _range(x: Array, model: Array, z: Array, H: Array) -> bool:
    """Predict the range along the beam from the sensor: ``scale * height / cosine + offset``.

    The model holds the beam's direction and the sensor's position in body axes.
    """
    beam, lever = model[MOTION : MOTION + 3], model[MOTION + 3 : MOTION + 6]
    R = rotation(x[X_ROT:X_RATE])
    cosine = -(R[2] * beam).sum()
    height = x[2] + (R[2] * lever).sum()
    if cosine < _MIN_COSINE:
        return False
    slant, scale = height / cosine, 1 + x[X_RANGE_SCALE]
    z[0] = scale * slant + x[X_RANGE_BIAS]
    H[0, POS + 2] = scale / cosine
    d_height, d_cosine = -(R[2] @ hat(lever)), R[2] @ hat(beam)
    H[0, ROT : ROT + 3] = scale * (d_height - slant * d_cosine) / cosine
    H[0, RANGE_SCALE], H[0, RANGE_BIAS] = slant, 1.0
    return True


@njit(cache=True)
def _heading_velocity(x: Array, z: Array, H: Array) -> bool:
    """Predict horizontal velocity in yaw axes, forward and left, each with scale and correlated error."""
    R = rotation(x[X_ROT:X_RATE])
    cosine = math.sqrt(R[0, 0] ** 2 + R[1, 0] ** 2)
    if cosine < _MIN_COSINE or math.sqrt(R[2, 1] ** 2 + R[2, 2] ** 2) < _MIN_COSINE:
        return False
    c, s = R[0, 0] / cosine, R[1, 0] / cosine
    forward, left = c * x[VEL] + s * x[VEL + 1], -s * x[VEL] + c * x[VEL + 1]
    yaw = angle_rates(R)[2]
    for k in range(2):
        along, turned_by = (forward, left) if k == 0 else (left, -forward)
        scale = 1 + x[X_VEL_SCALE + k]
        z[k] = scale * along + x[X_VEL_ERROR + k]
        H[k, VEL] = scale * (c if k == 0 else -s)
        H[k, VEL + 1] = scale * (s if k == 0 else c)
        H[k, ROT : ROT + 3] = scale * turned_by * yaw
        H[k, VEL_SCALE + k], H[k, VEL_ERROR + k] = along, 1.0
    return True


@njit(cache=True)
def step_residual(x: Array, seen: Array, model: Array, H: Array) -> tuple[Array, bool]:
    """Return the residual of a visual step ``seen`` (4, 4), the pose relative to the cloned one.

    The step is that of body axes at the camera, whose position the model holds; its translation is in heights
    of the cloned camera above the floor. The residual (6,), rotation first, is a right perturbation of the
    predicted step. The second result is False if the clone has no height.
    """
    H[:] = 0.0
    out = np.zeros(6)
    lever = model[MOTION + 6 : MOTION + 9]
    clone, now = rotation(x[X_CLONE_ROT:STATE]), rotation(x[X_ROT:X_RATE])
    height = x[X_CLONE_POS + 2] + (clone[2] * lever).sum()
    if height < _MIN_HEIGHT_M:
        return out, False
    to_kept = np.ascontiguousarray(clone.T)
    turn = to_kept @ now
    back = np.ascontiguousarray(turn.T)
    seen_from_body = to_kept @ (x[:3] - x[X_CLONE_POS:X_CLONE_ROT] + now @ lever)
    moved = (seen_from_body - lever) / height
    out[:3] = rotation_vector(back @ np.ascontiguousarray(seen[:3, :3]))
    out[3:] = back @ (seen[:3, 3] - moved)
    H[:3, ROT : ROT + 3] = np.eye(3)
    H[:3, CLONE_ROT : CLONE_ROT + 3] = -back
    to_now = np.ascontiguousarray(now.T) / height
    H[3:, POS : POS + 3] = to_now
    H[3:, CLONE_POS : CLONE_POS + 3] = -to_now
    H[3:, ROT : ROT + 3] = -hat(lever) / height
    H[3:, CLONE_ROT : CLONE_ROT + 3] = back @ hat(seen_from_body) / height
    shorter = back @ moved / height
    tipped = clone[2] @ hat(lever)
    for k in range(3):
        H[3 + k, CLONE_POS + 2] -= shorter[k]
        H[3 + k, CLONE_ROT : CLONE_ROT + 3] += shorter[k] * tipped
    return out, True
