"""State of the filter, and its propagation in time with covariance: numba kernels.

The state holds the paper's four (position, velocity, acceleration, attitude; equation 3), the body rate, and
instrument errors: offsets, scales, correlated errors. The error state is additive, except for attitudes,
whose error is a right perturbation in body axes, ``R = R_hat Exp(theta)``.

Position, velocity and acceleration are those of the IMU: there alone the specific force needs no angular
acceleration, which nothing measures.

Position and velocity have axes of the world. The acceleration is kept as the specific force in body axes,
which the accelerometer reads. No reading but a position or a yaw tells the heading. With an acceleration in
axes of the world, its process noise would seem to tell it: the linearised smoother takes the noise that it
has found as fixed in the world while the path turns, and each reading of the IMU adds information that does
not exist (Huang, Mourikis and Roumeliotis 2010, "Observability-based rules for designing consistent EKF SLAM
estimators").

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
    added,
    apply,
    compose,
    exponential,
    hat,
    left_jacobian,
    logarithm,
    multiply,
    quaternion,
    rotate,
    rotation,
    scaled,
    transpose,
    vector,
    write,
)
from backend.measurements import GRAVITY_M_S2
from backend.sparse_product import multiply_sparse

(
    POS, VEL, ACC, ROT, RATE, ATTITUDE_ERROR, VEL_ERROR, GYRO_BIAS, ACCEL_BIAS, RANGE_SCALE, RANGE_BIAS,
    VEL_SCALE, BARO_ZERO, GPS_ZERO, CLONE_POS, CLONE_ROT, SIZE,
) = accumulate((0, 3, 3, 3, 3, 3, 3, 2, 3, 3, 1, 1, 2, 1, 1, 3, 3))  # fmt: skip
"""Index of each part of the error state: position, velocity (world), specific force, attitude, rate (body),
error of the reported attitude, correlated error of the velocity, gyro and accelerometer offset, scale and
offset of the range, scale of the velocity, zero of the barometer, zero of the positions' height; the cloned
pose; the dimension. Each number is the width of the part before it."""
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
def propagate(x: Array, C: Array, dt: float, model: Array, point: Array, F: Array, work: Array) -> None:
    """Propagate state and covariance C (n, n) by dt, in place; F receives the transition of the moving part.

    ``point`` (STATE,) is the state about which errors are linearised afterwards; empty: the propagated one.
    F is (MOVING, MOVING), ``work`` a buffer (MOVING, n).
    """
    a, qa = integrate_correlated(dt, model[ACCEL_STD], model[ACCEL_TAU])
    w, qw = integrate_correlated(dt, model[RATE_STD], model[RATE_TAU])
    tilt, flow = math.exp(-dt / model[TILT_TAU]), math.exp(-dt / model[FLOW_TAU])
    turn, force, R = scaled(w[1], vector(x[X_RATE:])), vector(x[ACC:]), rotation(quaternion(x[X_ROT:]))
    w_a, by_turn = added(apply(R, force), (0.0, 0.0, -GRAVITY_M_S2)), multiply(R, hat(force))
    back, by_rate = rotation(exponential(scaled(-1.0, turn))), left_jacobian(scaled(-1.0, turn))
    turned = scaled(a[2], apply(back, force))
    rotate(x[X_ROT:], turn, x[X_ROT:])
    ahead = rotation(quaternion(x[X_ROT:]))
    to_point = transpose(rotation(quaternion(point[X_ROT:]))) if len(point) > 0 else transpose(ahead)
    # The acceleration fades, and leaves the specific force of gravity.
    faded = scaled((1 - a[2]) * GRAVITY_M_S2, ahead[2])
    F[:] = 0.0
    F[ATTITUDE_ERROR + 2, ATTITUDE_ERROR + 2] = 1.0
    for k in range(2):
        F[ATTITUDE_ERROR + k, ATTITUDE_ERROR + k], F[VEL_ERROR + k, VEL_ERROR + k] = tilt, flow
        x[X_ATTITUDE_ERROR + k] *= tilt
        x[X_VEL_ERROR + k] *= flow
    for k in range(3):
        F[POS + k, POS + k], F[POS + k, VEL + k] = 1.0, dt
        F[VEL + k, VEL + k], F[RATE + k, RATE + k] = 1.0, w[2]
        x[POS + k] += dt * x[VEL + k] + a[0] * w_a[k]
        x[VEL + k] += a[1] * w_a[k]
        x[ACC + k] = turned[k] + faded[k]
        x[X_RATE + k] *= w[2]
    write(R, a[0], F[POS:, ACC:])
    write(by_turn, -a[0], F[POS:, ROT:])
    write(R, a[1], F[VEL:, ACC:])
    write(by_turn, -a[1], F[VEL:, ROT:])
    write(back, a[2], F[ACC:, ACC:])
    write(multiply(hat(faded), back), 1.0, F[ACC:, ROT:])
    write(multiply(hat(added(turned, faded)), by_rate), w[1], F[ACC:, RATE:])
    # A turn of the whole path about the vertical stays one: it is no error of a single step.
    write(multiply(to_point, R), 1.0, F[ROT:, ROT:])
    write(multiply(multiply(to_point, ahead), by_rate), w[1], F[ROT:, RATE:])
    transform_covariance(F, C, work)
    _add_noise(C, dt, qa, qw, ahead, model)
    for k in range(2):
        C[ATTITUDE_ERROR + k, ATTITUDE_ERROR + k] += model[TILT_STD] * model[TILT_STD] * (1 - tilt * tilt)
        C[VEL_ERROR + k, VEL_ERROR + k] += model[FLOW_STD] * model[FLOW_STD] * (1 - flow * flow)


@inner_kernel
def _add_noise(C: Array, dt: float, qa: Matrix, qw: Matrix, R: Matrix, model: Array) -> None:
    """Add what dt adds to the covariance of motion, biases and random walks; R is the attitude after it."""
    _add_symmetric(C, POS, ACC, qa[0][2], R)
    _add_symmetric(C, VEL, ACC, qa[1][2], R)
    for k in range(3):
        C[POS + k, POS + k] += qa[0][0]
        C[VEL + k, VEL + k] += qa[1][1]
        C[ACC + k, ACC + k] += qa[2][2]
        C[POS + k, VEL + k] += qa[0][1]
        C[VEL + k, POS + k] += qa[0][1]
        C[ROT + k, ROT + k] += qw[1][1]
        C[ROT + k, RATE + k] += qw[1][2]
        C[RATE + k, ROT + k] += qw[1][2]
        C[RATE + k, RATE + k] += qw[2][2]
        C[GYRO_BIAS + k, GYRO_BIAS + k] += model[GYRO_WALK] * model[GYRO_WALK] * dt
        C[ACCEL_BIAS + k, ACCEL_BIAS + k] += model[BIAS_WALK] * model[BIAS_WALK] * dt
    C[ATTITUDE_ERROR + 2, ATTITUDE_ERROR + 2] += model[YAW_WALK] * model[YAW_WALK] * dt
    C[BARO_ZERO, BARO_ZERO] += model[BARO_WALK] * model[BARO_WALK] * dt


@inner_kernel
def _add_symmetric(C: Array, i: int, j: int, scale: float, A: Matrix) -> None:
    """Add a matrix (3, 3) times a scale to the covariance of the entries from i and those from j on."""
    for r in range(3):
        for c in range(3):
            C[i + r, j + c] += scale * A[r][c]
            C[j + c, i + r] += scale * A[r][c]


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
