"""State of the filter, and its propagation in time with covariance: numba kernels.

The state holds the paper's four (position, velocity, acceleration, attitude; equation 3), the body rate, and
instrument errors: offsets, scales, correlated errors. The error state is additive, except for attitudes,
whose error is a right perturbation in body axes, ``R = R_hat Exp(theta)``.

Acceleration and body rate are exponentially correlated (Singer 1970, "Estimating optimal tracking filter
performance for manned maneuvering targets"): readings determine them, and across a gap they
decay to zero while their variance returns to the stationary one.
"""

from __future__ import annotations

import math
from itertools import accumulate
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.numba_cache import discard_stale, njit

Array = NDArray[np.float64]

_EKF = Path(__file__).parent
discard_stale([*_EKF.glob("*.py"), _EKF.parent / "measurements.py"])

(
    POS, VEL, ACC, ROT, RATE, GYRO_BIAS, ACCEL_BIAS, ATTITUDE_ERROR, RANGE_SCALE, RANGE_BIAS, VEL_SCALE,
    VEL_ERROR, BARO_ZERO, GPS_ZERO, CLONE_POS, CLONE_ROT, SIZE,
) = accumulate((0, 3, 3, 3, 3, 3, 3, 3, 3, 1, 1, 2, 2, 1, 1, 3, 3))  # fmt: skip
"""Index of each part of the error state: position, velocity, acceleration (world), attitude, body rate, gyro
and accelerometer offset, error of the reported attitude, scale and offset of the range, scale and correlated
error of the velocity, zero of the barometer, zero of the positions' height; the cloned pose; the dimension.
Each number is the width of the part before it."""
SIZE_WITHOUT_CLONE = CLONE_POS
"""Dimension of the error state without the cloned pose."""
(
    X_ROT, X_RATE, X_GYRO_BIAS, X_ACCEL_BIAS, X_ATTITUDE_ERROR, X_RANGE_SCALE, X_RANGE_BIAS, X_VEL_SCALE,
    X_VEL_ERROR, X_BARO_ZERO, X_GPS_ZERO, X_CLONE_POS, X_CLONE_ROT, STATE,
) = accumulate((9, 4, 3, 3, 3, 3, 1, 1, 2, 2, 1, 1, 3, 4))  # fmt: skip
"""Indices in the nominal state, likewise, where attitudes are quaternions (w, x, y, z), and its length;
position, velocity and acceleration have the same indices as in the error state."""

(
    ACCEL_STD, ACCEL_TAU, RATE_STD, RATE_TAU, GYRO_WALK, BIAS_WALK, TILT_STD, TILT_TAU, YAW_WALK,
    FLOW_STD, FLOW_TAU, BARO_WALK, MOTION,
) = range(13)  # fmt: skip
"""Index of each parameter in the flat vector of the motion model."""


@njit(cache=True)
def rotation(q: Array) -> Array:
    """Return the rotation matrix (3, 3) of a unit quaternion (w, x, y, z)."""
    w, x, y, z = q
    R = np.empty((3, 3))
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return R


@njit(cache=True)
def rotated(q: Array, v: Array) -> Array:
    """Return the unit quaternion of ``R Exp(v)``."""
    angle = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    s = math.sin(angle / 2) / angle if angle > 1e-8 else 0.5
    a, (b, c, d) = math.cos(angle / 2), v * s
    w, x, y, z = q
    out = np.empty(4)
    out[0] = w * a - x * b - y * c - z * d
    out[1] = w * b + x * a + y * d - z * c
    out[2] = w * c - x * d + y * a + z * b
    out[3] = w * d + x * c - y * b + z * a
    return out / math.sqrt((out * out).sum())


@njit(cache=True)
def hat(v: Array) -> Array:
    """Return the matrix with ``hat(v) @ u == cross(v, u)``."""
    out = np.zeros((3, 3))
    out[0, 1], out[0, 2], out[1, 2] = -v[2], v[1], -v[0]
    out[1, 0], out[2, 0], out[2, 1] = v[2], -v[1], v[0]
    return out


@njit(cache=True)
def left_jacobian(v: Array) -> Array:
    """Return the left Jacobian (3, 3): ``Exp(v + dv) = Exp(left_jacobian(v) dv) Exp(v)`` for small dv."""
    angle, across = math.sqrt((v * v).sum()), hat(v)
    if angle < 1e-4:  # the closed form cancels
        return np.eye(3) + across / 2
    once, twice = (1 - math.cos(angle)) / angle**2, (angle - math.sin(angle)) / angle**3
    return np.eye(3) + once * across + twice * (across @ across)


@njit(cache=True)
def retract(x: Array, e: Array) -> Array:
    """Return the nominal state (STATE,) moved by an error (SIZE,) or (PLAIN,)."""
    out = x.copy()
    out[:X_ROT] += e[:ROT]
    out[X_ROT:X_RATE] = rotated(x[X_ROT:X_RATE], e[ROT:RATE])
    out[X_RATE:X_CLONE_POS] += e[RATE:CLONE_POS]
    if len(e) == SIZE:
        out[X_CLONE_POS:X_CLONE_ROT] += e[CLONE_POS:CLONE_ROT]
        out[X_CLONE_ROT:STATE] = rotated(x[X_CLONE_ROT:STATE], e[CLONE_ROT:SIZE])
    return out


@njit(cache=True)
def rotation_vector(R: Array) -> Array:
    """Return the rotation vector (3,) of a rotation by less than half a turn."""
    out = np.empty(3)
    out[0], out[1], out[2] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    sine = math.sqrt((out * out).sum()) / 2
    angle = math.atan2(sine, (R[0, 0] + R[1, 1] + R[2, 2] - 1) / 2)
    return out * (0.5 + angle * angle / 12 if angle < 1e-4 else angle / (2 * max(sine, 1e-12)))


@njit(cache=True)
def difference(y: Array, x: Array, n: int) -> Array:
    """Return the error (n,) that moves the nominal state x to y."""
    out = np.empty(n)
    out[:ROT] = y[:X_ROT] - x[:X_ROT]
    back = np.ascontiguousarray(rotation(x[X_ROT:X_RATE]).T)
    out[ROT:RATE] = rotation_vector(back @ rotation(y[X_ROT:X_RATE]))
    out[RATE:CLONE_POS] = y[X_RATE:X_CLONE_POS] - x[X_RATE:X_CLONE_POS]
    if n == SIZE:
        out[CLONE_POS:CLONE_ROT] = y[X_CLONE_POS:X_CLONE_ROT] - x[X_CLONE_POS:X_CLONE_ROT]
        clone = np.ascontiguousarray(rotation(x[X_CLONE_ROT:STATE]).T)
        out[CLONE_ROT:SIZE] = rotation_vector(clone @ rotation(y[X_CLONE_ROT:STATE]))
    return out


@njit(cache=True)
def integrate_correlated(dt: float, std: float, tau: float) -> tuple[Array, Array]:
    """Propagate an exponentially correlated signal s and its two integrals over dt.

    Return the transition factors from s to (double integral, integral, s), and the covariance (3, 3) of
    these three that dt adds. Source: Singer 1970, equations 9 to 11.
    """
    b = dt / tau
    e = math.exp(-b)
    q = np.empty((3, 3))
    step = np.empty(3)
    if b < 0.02:  # the closed form cancels; the leading terms of the series are accurate enough
        step[0], step[1] = dt * dt / 2 * (1 - b / 3), dt * (1 - b / 2)
        density = 2 * std * std / tau
        q[0, 0], q[0, 1], q[0, 2] = dt**5 / 20, dt**4 / 8, dt**3 / 6
        q[1, 1], q[1, 2], q[2, 2] = dt**3 / 3, dt * dt / 2, dt
        q *= density
    else:
        step[0], step[1] = tau * tau * (b - 1 + e), tau * (1 - e)
        ee = e * e
        q[0, 0] = tau**4 * (1 - ee + 2 * b + 2 * b**3 / 3 - 2 * b * b - 4 * b * e)
        q[0, 1] = tau**3 * (ee + 1 - 2 * e + 2 * b * e - 2 * b + b * b)
        q[0, 2] = tau**2 * (1 - ee - 2 * b * e)
        q[1, 1] = tau**2 * (4 * e - 3 - ee + 2 * b)
        q[1, 2] = tau * (ee + 1 - 2 * e)
        q[2, 2] = 1 - ee
        q *= std * std
    q[1, 0], q[2, 0], q[2, 1] = q[0, 1], q[0, 2], q[1, 2]
    step[2] = e
    return step, q


@njit(cache=True)
def propagate(x: Array, C: Array, dt: float, model: Array, F: Array) -> None:
    """Propagate state and covariance C by dt, in place; F (9, 3) receives the transition's coefficients."""
    a, qa = integrate_correlated(dt, model[ACCEL_STD], model[ACCEL_TAU])
    w, qw = integrate_correlated(dt, model[RATE_STD], model[RATE_TAU])
    v = w[1] * x[X_RATE : X_RATE + 3]
    F[0, 0], F[0, 1], F[0, 2] = dt, a[0], a[1]
    F[1, 0], F[1, 1] = a[2], w[2]
    F[1, 2] = math.exp(-dt / model[TILT_TAU])
    F[2:5] = rotation(rotated(np.array([1.0, 0.0, 0.0, 0.0]), -v))
    F[5:8] = w[1] * (np.eye(3) - 0.5 * hat(v))
    F[8, 0] = math.exp(-dt / model[FLOW_TAU])
    for k in range(3):
        x[k] += dt * x[VEL + k] + a[0] * x[ACC + k]
        x[VEL + k] += a[1] * x[ACC + k]
        x[ACC + k] *= a[2]
    x[X_ROT:X_RATE] = rotated(x[X_ROT:X_RATE], v)
    x[X_RATE : X_RATE + 3] *= w[2]
    x[X_ATTITUDE_ERROR : X_ATTITUDE_ERROR + 2] *= F[1, 2]
    x[X_VEL_ERROR : X_VEL_ERROR + 2] *= F[8, 0]
    transform_covariance(C, F, False)
    for k in range(3):
        for i in range(3):
            for j in range(3):
                C[3 * i + k, 3 * j + k] += qa[i, j]
        C[ROT + k, ROT + k] += qw[1, 1]
        C[ROT + k, RATE + k] += qw[1, 2]
        C[RATE + k, ROT + k] += qw[1, 2]
        C[RATE + k, RATE + k] += qw[2, 2]
        C[GYRO_BIAS + k, GYRO_BIAS + k] += model[GYRO_WALK] ** 2 * dt
        C[ACCEL_BIAS + k, ACCEL_BIAS + k] += model[BIAS_WALK] ** 2 * dt
    for k in range(2):
        C[ATTITUDE_ERROR + k, ATTITUDE_ERROR + k] += model[TILT_STD] ** 2 * (1 - F[1, 2] ** 2)
        C[VEL_ERROR + k, VEL_ERROR + k] += model[FLOW_STD] ** 2 * (1 - F[8, 0] ** 2)
    C[ATTITUDE_ERROR + 2, ATTITUDE_ERROR + 2] += model[YAW_WALK] ** 2 * dt
    C[BARO_ZERO, BARO_ZERO] += model[BARO_WALK] ** 2 * dt


@njit(cache=True)
def apply_transition(v: Array, F: Array) -> None:
    """Multiply an error v (n,) by the transition matrix, in place."""
    for k in range(3):
        v[POS + k] += F[0, 0] * v[VEL + k] + F[0, 1] * v[ACC + k]
        v[VEL + k] += F[0, 2] * v[ACC + k]
        v[ACC + k] *= F[1, 0]
    t0, t1, t2, w0, w1, w2 = v[ROT], v[ROT + 1], v[ROT + 2], v[RATE], v[RATE + 1], v[RATE + 2]
    for k in range(3):
        turn = F[2 + k, 0] * t0 + F[2 + k, 1] * t1 + F[2 + k, 2] * t2
        v[ROT + k] = turn + F[5 + k, 0] * w0 + F[5 + k, 1] * w1 + F[5 + k, 2] * w2
        v[RATE + k] *= F[1, 1]
    for k in range(2):
        v[ATTITUDE_ERROR + k] *= F[1, 2]
        v[VEL_ERROR + k] *= F[8, 0]


@njit(cache=True)
def apply_transposed_transition(v: Array, F: Array) -> None:
    """Multiply v (n,) by the transposed transition matrix, in place."""
    for k in range(3):
        v[ACC + k] = F[0, 1] * v[POS + k] + F[0, 2] * v[VEL + k] + F[1, 0] * v[ACC + k]
        v[VEL + k] += F[0, 0] * v[POS + k]
    t0, t1, t2 = v[ROT], v[ROT + 1], v[ROT + 2]
    for k in range(3):
        v[RATE + k] = F[1, 1] * v[RATE + k] + F[5, k] * t0 + F[6, k] * t1 + F[7, k] * t2
    for k in range(3):
        v[ROT + k] = F[2, k] * t0 + F[3, k] * t1 + F[4, k] * t2
    for k in range(2):
        v[ATTITUDE_ERROR + k] *= F[1, 2]
        v[VEL_ERROR + k] *= F[8, 0]


@njit(cache=True)
def transform_covariance(C: Array, F: Array, back: bool) -> None:
    """Replace a symmetric C by ``F C F'`` (``F' C F`` if ``back``); the result is exactly symmetric."""
    n = len(C)
    for _ in range(2):
        for r in range(n):
            if back:
                apply_transposed_transition(C[r], F)
            else:
                apply_transition(C[r], F)
        for r in range(n):
            for j in range(r):
                C[r, j], C[j, r] = C[j, r], C[r, j]
    for r in range(n):
        for j in range(r):
            C[r, j] = C[j, r] = (C[r, j] + C[j, r]) / 2
