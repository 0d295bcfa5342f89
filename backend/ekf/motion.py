"""State of the filter, and its propagation in time with covariance: numba kernels.

The state holds the paper's four (position, velocity, acceleration, attitude; equation 3), the body rate, and
instrument errors: offsets, scales, correlated errors. The error state is additive, except for attitudes,
whose error is a right perturbation in body axes, ``R = R_hat Exp(theta)``.

Position, velocity and acceleration are those of the IMU: there alone the specific force needs no angular
acceleration, which nothing measures.

Acceleration and body rate are exponentially correlated (Singer 1970, "Estimating optimal tracking filter
performance for manned maneuvering targets"): readings determine them, and across a gap they
decay to zero while their variance returns to the stationary one.
"""

from __future__ import annotations

import math
from itertools import accumulate

from backend.compilation import inner_kernel, kernel
from backend.ekf.rotations import (
    Array,
    Matrix,
    Vector,
    compose,
    exponential,
    hat,
    logarithm,
    quaternion,
    rotate,
    rotation,
    scaled,
    vector,
    write,
)
from backend.sparse_product import multiply_sparse

(
    POS, VEL, ACC, ROT, RATE, ATTITUDE_ERROR, VEL_ERROR, GYRO_BIAS, ACCEL_BIAS, RANGE_SCALE, RANGE_BIAS,
    VEL_SCALE, BARO_ZERO, GPS_ZERO, CLONE_POS, CLONE_ROT, SIZE,
) = accumulate((0, 3, 3, 3, 3, 3, 3, 2, 3, 3, 1, 1, 2, 1, 1, 3, 3))  # fmt: skip
"""Index of each part of the error state: position, velocity, acceleration (world), attitude, body rate, error
of the reported attitude, correlated error of the velocity, gyro and accelerometer offset, scale and offset of
the range, scale of the velocity, zero of the barometer, zero of the positions' height; the cloned pose; the
dimension. Each number is the width of the part before it."""
MOVING = GYRO_BIAS
"""Number of the entries, from the first on, that change from moment to moment; the others are constants and
random walks."""
SIZE_WITHOUT_CLONE = CLONE_POS
"""Dimension of the error state without the cloned pose."""
(
    X_ROT, X_RATE, X_ATTITUDE_ERROR, X_VEL_ERROR, X_GYRO_BIAS, X_ACCEL_BIAS, X_RANGE_SCALE, X_RANGE_BIAS,
    X_VEL_SCALE, X_BARO_ZERO, X_GPS_ZERO, X_CLONE_POS, X_CLONE_ROT, STATE,
) = accumulate((9, 4, 3, 3, 2, 3, 3, 1, 1, 2, 1, 1, 3, 4))  # fmt: skip
"""Indices in the nominal state, likewise, where attitudes are quaternions (w, x, y, z), and its length;
position, velocity and acceleration have the same indices as in the error state."""

(
    ACCEL_STD, ACCEL_TAU, RATE_STD, RATE_TAU, GYRO_WALK, BIAS_WALK, TILT_STD, TILT_TAU, YAW_WALK,
    FLOW_STD, FLOW_TAU, BARO_WALK, BEAM,
) = range(13)  # fmt: skip
"""Index of each parameter in the flat vector of the model; the direction of the beam follows the motion."""
LEVERS = BEAM + 3
LEVER_TO_RANGE, LEVER_TO_CAMERA, LEVER_TO_ANTENNA, LEVER_TO_ORIGIN = range(LEVERS, LEVERS + 12, 3)
"""Indices of the levers from the IMU, in body axes."""


@kernel
def retract(x: Array, e: Array, out: Array) -> None:
    """Write the nominal state x (STATE,), moved by an error e (n,), into ``out``, which may be x itself."""
    for k in range(ROT):
        out[k] = x[k] + e[k]
    rotate(x[X_ROT:], vector(e[ROT:]), out[X_ROT:])
    for k in range(CLONE_POS - RATE):
        out[X_RATE + k] = x[X_RATE + k] + e[RATE + k]
    if len(e) == SIZE:
        for k in range(3):
            out[X_CLONE_POS + k] = x[X_CLONE_POS + k] + e[CLONE_POS + k]
        rotate(x[X_CLONE_ROT:], vector(e[CLONE_ROT:]), out[X_CLONE_ROT:])
    else:
        for k in range(X_CLONE_POS, STATE):
            out[k] = x[k]


@inner_kernel
def relinearize(x: Array, e: Array, point: Array) -> None:
    """Make ``point`` (STATE,) the nominal state x; the mean e (n,) of the error makes up for it."""
    for k in range(ROT):
        e[k] += x[k] - point[k]
    _add_turn(e[ROT:], x[X_ROT:], point[X_ROT:])
    for k in range(CLONE_POS - RATE):
        e[RATE + k] += x[X_RATE + k] - point[X_RATE + k]
    if len(e) == SIZE:
        for k in range(3):
            e[CLONE_POS + k] += x[X_CLONE_POS + k] - point[X_CLONE_POS + k]
        _add_turn(e[CLONE_ROT:], x[X_CLONE_ROT:], point[X_CLONE_ROT:])
    for k in range(STATE):
        x[k] = point[k]


@inner_kernel
def _add_turn(e: Array, x: Array, point: Array) -> None:
    """Add to e the rotation vector from the attitude ``point`` to the attitude x, both quaternions."""
    w, a, b, c = quaternion(point)
    turn = logarithm(compose((w, -a, -b, -c), quaternion(x)))
    e[0], e[1], e[2] = e[0] + turn[0], e[1] + turn[1], e[2] + turn[2]


@kernel
def integrate_correlated(dt: float, std: float, tau: float) -> tuple[Vector, Matrix]:
    """Propagate an exponentially correlated signal s and its two integrals over dt.

    Return the transition factors from s to (double integral, integral, s), and the covariance (3, 3) of
    these three that dt adds. Source: Singer 1970, equations 9 to 11.
    """
    b = dt / tau
    e = math.exp(-b)
    if b < 0.02:  # the closed form cancels; the leading terms of the series are accurate enough
        density = 2 * std * std / tau
        dd = dt * dt
        step = dd / 2 * (1 - b / 3), dt * (1 - b / 2), e
        q00, q01, q02 = dd * dd * dt / 20, dd * dd / 8, dd * dt / 6
        q11, q12, q22 = dd * dt / 3, dd / 2, dt
    else:
        density = std * std
        ee, bb, t2 = e * e, b * b, tau * tau
        step = t2 * (b - 1 + e), tau * (1 - e), e
        q00 = t2 * t2 * (1 - ee + 2 * b + 2 * bb * b / 3 - 2 * bb - 4 * b * e)
        q01 = t2 * tau * (ee + 1 - 2 * e + 2 * b * e - 2 * b + bb)
        q02, q11 = t2 * (1 - ee - 2 * b * e), t2 * (4 * e - 3 - ee + 2 * b)
        q12, q22 = tau * (ee + 1 - 2 * e), 1 - ee
    upper = scaled(density, (q00, q01, q02))
    return step, (upper, scaled(density, (q01, q11, q12)), scaled(density, (q02, q12, q22)))


@kernel
def propagate(x: Array, C: Array, dt: float, model: Array, F: Array, work: Array) -> None:
    """Propagate state and covariance C (n, n) by dt, in place; F receives the transition of the moving part.

    F is (MOVING, MOVING), ``work`` a buffer (MOVING, n).
    """
    a, qa = integrate_correlated(dt, model[ACCEL_STD], model[ACCEL_TAU])
    w, qw = integrate_correlated(dt, model[RATE_STD], model[RATE_TAU])
    tilt, flow = math.exp(-dt / model[TILT_TAU]), math.exp(-dt / model[FLOW_TAU])
    v = scaled(w[1], vector(x[X_RATE:]))
    F[:] = 0.0
    F[ATTITUDE_ERROR + 2, ATTITUDE_ERROR + 2] = 1.0
    for k in range(2):
        F[ATTITUDE_ERROR + k, ATTITUDE_ERROR + k], F[VEL_ERROR + k, VEL_ERROR + k] = tilt, flow
        x[X_ATTITUDE_ERROR + k] *= tilt
        x[X_VEL_ERROR + k] *= flow
    for k in range(3):
        F[POS + k, POS + k], F[POS + k, VEL + k], F[POS + k, ACC + k] = 1.0, dt, a[0]
        F[VEL + k, VEL + k], F[VEL + k, ACC + k] = 1.0, a[1]
        F[ACC + k, ACC + k], F[RATE + k, RATE + k] = a[2], w[2]
        x[POS + k] += dt * x[VEL + k] + a[0] * x[ACC + k]
        x[VEL + k] += a[1] * x[ACC + k]
        x[ACC + k] *= a[2]
        x[X_RATE + k] *= w[2]
    write(rotation(exponential(scaled(-1.0, v))), 1.0, F[ROT:, ROT:])
    write(hat(v), -0.5 * w[1], F[ROT:, RATE:])
    for k in range(3):
        F[ROT + k, RATE + k] += w[1]
    rotate(x[X_ROT:], v, x[X_ROT:])
    transform_covariance(F, C, work)
    for k in range(3):
        _add_chain(C, qa, POS + k, VEL + k, ACC + k)
        C[ROT + k, ROT + k] += qw[1][1]
        C[ROT + k, RATE + k] += qw[1][2]
        C[RATE + k, ROT + k] += qw[1][2]
        C[RATE + k, RATE + k] += qw[2][2]
        C[GYRO_BIAS + k, GYRO_BIAS + k] += model[GYRO_WALK] * model[GYRO_WALK] * dt
        C[ACCEL_BIAS + k, ACCEL_BIAS + k] += model[BIAS_WALK] * model[BIAS_WALK] * dt
    for k in range(2):
        C[ATTITUDE_ERROR + k, ATTITUDE_ERROR + k] += model[TILT_STD] * model[TILT_STD] * (1 - tilt * tilt)
        C[VEL_ERROR + k, VEL_ERROR + k] += model[FLOW_STD] * model[FLOW_STD] * (1 - flow * flow)
    C[ATTITUDE_ERROR + 2, ATTITUDE_ERROR + 2] += model[YAW_WALK] * model[YAW_WALK] * dt
    C[BARO_ZERO, BARO_ZERO] += model[BARO_WALK] * model[BARO_WALK] * dt


@inner_kernel
def _add_chain(C: Array, q: Matrix, i: int, j: int, k: int) -> None:
    """Add the covariance of a signal's two integrals and itself, which are the entries i, j and k."""
    C[i, i] += q[0][0]
    C[j, j] += q[1][1]
    C[k, k] += q[2][2]
    C[i, j], C[j, i] = C[i, j] + q[0][1], C[j, i] + q[0][1]
    C[i, k], C[k, i] = C[i, k] + q[0][2], C[k, i] + q[0][2]
    C[j, k], C[k, j] = C[j, k] + q[1][2], C[k, j] + q[1][2]


@kernel
def apply_transition(F: Array, v: Array, work: Array) -> None:
    """Multiply an error v (n,) by the transition F (MOVING, MOVING), in place; ``work`` is (1, n)."""
    for i in range(MOVING):
        total = 0.0
        for k in range(MOVING):
            total += F[i, k] * v[k]
        work[0, i] = total
    for i in range(MOVING):
        v[i] = work[0, i]


@kernel
def transform_covariance(F: Array, C: Array, work: Array) -> None:
    """Replace a symmetric C (n, n) by ``F C F'``, where F (MOVING, MOVING) is the identity beyond.

    The result is exactly symmetric. ``work`` is a buffer (MOVING, n).
    """
    n = len(C)
    for columns in (n, MOVING):
        multiply_sparse(F, C, MOVING, columns, work)
        for i in range(MOVING):
            for j in range(columns):
                C[j, i] = work[i, j]
    for i in range(MOVING):
        for j in range(i):
            C[j, i] = C[i, j]
        for j in range(MOVING, n):
            C[i, j] = C[j, i]
