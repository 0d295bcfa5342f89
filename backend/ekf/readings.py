"""Measurement models of the instruments: predicted reading and its Jacobian; numba kernels.

Every function fills in the predicted reading and its Jacobian H (6, n) by the error state. The caller forms
the innovation and skips missing components.
"""

from __future__ import annotations

import math

from backend.compilation import inner_kernel, kernel
from backend.ekf.motion import (
    ACC,
    ACCEL_BIAS,
    ATTITUDE_ERROR,
    BARO_ZERO,
    BEAM,
    CLONE_POS,
    CLONE_ROT,
    GPS_ZERO,
    GYRO_BIAS,
    LEVER_TO_ANTENNA,
    LEVER_TO_CAMERA,
    LEVER_TO_ORIGIN,
    LEVER_TO_RANGE,
    POS,
    RANGE_BIAS,
    RANGE_SCALE,
    RATE,
    ROT,
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
)
from backend.ekf.rotations import (
    Array,
    Matrix,
    Vector,
    added,
    apply,
    cross,
    dot,
    exponential,
    hat,
    left_jacobian,
    multiply,
    quaternion,
    rotation,
    rotation_vector,
    scaled,
    transpose,
    vector,
    write,
    write_row,
)

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


@kernel
def predict(kind: int, x: Array, value: Array, model: Array, z: Array, H: Array) -> bool:
    """Write the predicted reading of an instrument into z (6,); return whether it is valid in this state."""
    H[:] = 0.0
    z[:] = 0.0
    if kind == ACCEL:
        _add_states(x[ACC:], z, H[:, ACC:])
        _add_states(x[X_ACCEL_BIAS:], z, H[:, ACCEL_BIAS:])
    elif kind == ATTITUDE:
        return _attitude(x, value, z, H)
    elif kind == RANGE:
        return _range(x, model, z, H)
    elif kind == VELOCITY:
        return _heading_velocity(x, model, z, H)
    elif kind == BAROMETER:
        up, lever = rotation(quaternion(x[X_ROT:]))[2], vector(model[LEVER_TO_ORIGIN:])
        z[0] = x[2] + dot(up, lever) + x[X_BARO_ZERO]
        write_row(cross(lever, up), 1.0, H[0, ROT:])
        H[0, POS + 2] = H[0, BARO_ZERO] = 1.0
    elif kind == GYRO:
        _add_states(x[X_RATE:], z, H[:, RATE:])
        _add_states(x[X_GYRO_BIAS:], z, H[:, GYRO_BIAS:])
    elif kind == POSITION:
        _add_states(x[POS:], z, H[:, POS:])
        R, lever = rotation(quaternion(x[X_ROT:])), vector(model[LEVER_TO_ANTENNA:])
        offset = apply(R, lever)
        for k in range(3):
            z[k] += offset[k]
        write(multiply(R, hat(lever)), -1.0, H[:, ROT:])
        z[2] += x[X_GPS_ZERO]
        H[2, GPS_ZERO] = 1.0
    elif kind == REST:
        _add_states(x[VEL:], z, H[:, VEL:])
    elif kind == STILL:
        _add_states(x[X_RATE:], z, H[:, RATE:])
    return True


@inner_kernel
def _add_states(x: Array, z: Array, H: Array) -> None:
    """Add three entries of the state to a reading; x and H begin with them."""
    for k in range(3):
        z[k] += x[k]
        H[k, k] = 1.0


@inner_kernel
def angles(R: Matrix) -> Vector:
    """Return roll, pitch, yaw of ``R = Rz(yaw) Ry(pitch) Rx(roll)``."""
    pitch = math.asin(min(max(-R[2][0], -1.0), 1.0))
    return math.atan2(R[2][1], R[2][2]), pitch, math.atan2(R[1][0], R[0][0])


@inner_kernel
def angle_rates(R: Matrix) -> Matrix:
    """Return the derivatives of roll, pitch, yaw by a right perturbation of R."""
    cp = math.sqrt(R[2][1] * R[2][1] + R[2][2] * R[2][2])
    s, c, t = R[2][1] / cp, R[2][2] / cp, -R[2][0] / cp
    return (1.0, s * t, c * t), (0.0, c, -s), (0.0, s / cp, c / cp)


@inner_kernel
def _attitude(x: Array, value: Array, z: Array, H: Array) -> bool:
    """Predict roll, pitch, yaw of ``Exp(tilt error) Rz(yaw error) R``, yaw within half a turn of the reading.

    The error of an attitude that is integrated from body rates is constant in world axes, not in body axes.
    It is observable when the vehicle turns, and when a wrong tilt converts body rate to yaw rate. The axes
    are those of the vehicle's own world, so that its tilt error does not seem to tell its yaw error.
    """
    R = rotation(quaternion(x[X_ROT:]))
    if R[2][1] * R[2][1] + R[2][2] * R[2][2] < _MIN_COSINE * _MIN_COSINE:
        return False
    tilt = x[X_ATTITUDE_ERROR], x[X_ATTITUDE_ERROR + 1], 0.0
    tilted = rotation(exponential(tilt))
    own = multiply(tilted, multiply(rotation(exponential((0.0, 0.0, x[X_ATTITUDE_ERROR + 2]))), R))
    z[0], z[1], z[2] = angles(own)
    for k in (0, 2):
        if math.isfinite(value[k]):
            z[k] += 2 * math.pi * math.floor((value[k] - z[k]) / (2 * math.pi) + 0.5)
    rates = angle_rates(own)
    write(rates, 1.0, H[:, ROT:])
    by_world = multiply(rates, transpose(own))
    # The third column is that of the yaw error, which follows.
    write(multiply(by_world, left_jacobian(tilt)), 1.0, H[:, ATTITUDE_ERROR:])
    by_yaw = apply(by_world, (tilted[0][2], tilted[1][2], tilted[2][2]))
    H[0, ATTITUDE_ERROR + 2], H[1, ATTITUDE_ERROR + 2], H[2, ATTITUDE_ERROR + 2] = by_yaw
    return True


@inner_kernel
def _range(x: Array, model: Array, z: Array, H: Array) -> bool:
    """Predict the range along the beam from the sensor: ``scale * height / cosine + offset``.

    The model holds the beam's direction and the lever to the sensor in body axes.
    """
    beam, lever = vector(model[BEAM:]), vector(model[LEVER_TO_RANGE:])
    up = rotation(quaternion(x[X_ROT:]))[2]
    cosine, height = -dot(up, beam), x[2] + dot(up, lever)
    if cosine < _MIN_COSINE:
        return False
    slant, scale = height / cosine, 1 + x[X_RANGE_SCALE]
    z[0] = scale * slant + x[X_RANGE_BIAS]
    H[0, POS + 2] = scale / cosine
    # A turn lifts the end of the beam, as seen along the beam.
    write_row(cross(added(lever, scaled(slant, beam)), up), scale / cosine, H[0, ROT:])
    H[0, RANGE_SCALE], H[0, RANGE_BIAS] = slant, 1.0
    return True


@inner_kernel
def _heading_velocity(x: Array, model: Array, z: Array, H: Array) -> bool:
    """Predict horizontal velocity of the body's origin in yaw axes, forward and left, each with scale and
    correlated error."""
    R = rotation(quaternion(x[X_ROT:]))
    cosine = math.sqrt(R[0][0] * R[0][0] + R[1][0] * R[1][0])
    if cosine < _MIN_COSINE or R[2][1] * R[2][1] + R[2][2] * R[2][2] < _MIN_COSINE * _MIN_COSINE:
        return False
    c, s = R[0][0] / cosine, R[1][0] / cosine
    lever = vector(model[LEVER_TO_ORIGIN:])
    around = cross(vector(x[X_RATE:]), lever)
    v = added(vector(x[VEL:]), apply(R, around))
    forward, left = c * v[0] + s * v[1], -s * v[0] + c * v[1]
    yaw = angle_rates(R)[2]
    for k in range(2):
        along, turned_by = (forward, left) if k == 0 else (left, -forward)
        axis = (c, s, 0.0) if k == 0 else (-s, c, 0.0)
        b_axis, scale = apply(transpose(R), axis), 1 + x[X_VEL_SCALE + k]
        z[k] = scale * along + x[X_VEL_ERROR + k]
        write_row(axis, scale, H[k, VEL:])
        write_row(added(scaled(turned_by, yaw), cross(around, b_axis)), scale, H[k, ROT:])
        write_row(cross(lever, b_axis), scale, H[k, RATE:])
        H[k, VEL_SCALE + k], H[k, VEL_ERROR + k] = along, 1.0
    return True


@kernel
def step_residual(x: Array, seen: Array, model: Array, out: Array, H: Array) -> bool:
    """Write the residual (6,) of a visual step ``seen`` (4, 4), the pose relative to the cloned one.

    The step is that of body axes at the camera, whose position the model holds; its translation is in heights
    of the cloned camera above the floor. The residual, rotation first, is a right perturbation of the
    predicted step. Return False if the clone has no height.
    """
    H[:] = 0.0
    out[:] = 0.0
    lever = vector(model[LEVER_TO_CAMERA:])
    clone, now = rotation(quaternion(x[X_CLONE_ROT:])), rotation(quaternion(x[X_ROT:]))
    height = x[X_CLONE_POS + 2] + dot(clone[2], lever)
    if height < _MIN_HEIGHT_M:
        return False
    to_clone, to_now = transpose(clone), transpose(now)
    back = multiply(to_now, clone)
    way = added(added(vector(x[POS:]), scaled(-1.0, vector(x[X_CLONE_POS:]))), apply(now, lever))
    seen_from_body = apply(to_clone, way)
    moved = scaled(1 / height, added(seen_from_body, scaled(-1.0, lever)))
    turn = vector(seen[0]), vector(seen[1]), vector(seen[2])
    seen_moved = seen[0, 3], seen[1, 3], seen[2, 3]
    out[0], out[1], out[2] = rotation_vector(multiply(back, turn))
    out[3], out[4], out[5] = apply(back, added(seen_moved, scaled(-1.0, moved)))
    for k in range(3):
        H[k, ROT + k] = 1.0
    write(back, -1.0, H[:, CLONE_ROT:])
    write(to_now, 1 / height, H[3:, POS:])
    write(to_now, -1 / height, H[3:, CLONE_POS:])
    write(hat(lever), -1 / height, H[3:, ROT:])
    write(multiply(back, hat(seen_from_body)), 1 / height, H[3:, CLONE_ROT:])
    shorter, tipped = scaled(1 / height, apply(back, moved)), cross(clone[2], lever)
    for k in range(3):
        s = shorter[k]
        H[3 + k, CLONE_POS + 2] -= s
        for j in range(3):
            H[3 + k, CLONE_ROT + j] += s * tipped[j]
    return True
