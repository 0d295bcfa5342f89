"""The filter's state, and how it and its uncertainty move in time: kernels at compiled speed.

The state holds the paper's four (position, velocity, acceleration, attitude; equation 3), the body rate, and
what the instruments add: offsets, scales, errors that last. Errors are those of the nominal state: additive,
but for attitudes, whose error is a right perturbation in body axes, ``R = R_hat Exp(theta)``.

Acceleration and body rate are exponentially correlated (Singer 1970, "Estimating optimal tracking filter
performance for manned maneuvering targets"): readings determine them where there are some, and across a gap
they fade while the uncertainty of a vehicle that may do anything takes their place.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from backend.compiled import discard_stale

Array = NDArray[np.float64]

discard_stale(Path(__file__).parent.glob("*.py"))

P, V, A, TH, W, BG, BA, AT, RS, RO, VS, VB, BO, GO, CP, CT = (
    0, 3, 6, 9, 12, 15, 18, 21, 24, 25, 26, 28, 30, 31, 32, 35,
)  # fmt: skip
"""Where each part stands in the error: position, velocity, acceleration (world), attitude, body rate, gyro
and accelerometer offset, error of the vehicle's own attitude, scale and offset of the range, scale and
lasting error of the velocity, offset of the barometer, offset of the positions' height; a pose kept from
earlier."""
PLAIN, SIZE = 32, 38
"""Length of the error without and with the kept pose."""
XQ, XW, XC, XCQ, STATE = 9, 13, 33, 36, 40
"""In the nominal state attitudes are quaternions (w, x, y, z): attitude, body rate, kept position and
attitude, length. What lies between body rate and kept position stands one higher than in the error."""

(
    ACCEL_STD, ACCEL_TAU, RATE_STD, RATE_TAU, GYRO_WALK, BIAS_WALK, TILT_STD, TILT_TAU, YAW_WALK,
    FLOW_STD, FLOW_TAU, BARO_WALK, MOTION,
) = range(13)  # fmt: skip
"""Where each figure stands in the flat vector of the motion model."""


@njit(cache=True)
def rotation(q: Array) -> Array:
    """(3, 3) of a unit quaternion (w, x, y, z)."""
    w, x, y, z = q
    R = np.empty((3, 3))
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return R


@njit(cache=True)
def turned(q: Array, v: Array) -> Array:
    """Quaternion of ``R Exp(v)``, of unit length."""
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
    """``hat(v) @ u == cross(v, u)``."""
    out = np.zeros((3, 3))
    out[0, 1], out[0, 2], out[1, 2] = -v[2], v[1], -v[0]
    out[1, 0], out[2, 0], out[2, 1] = v[2], -v[1], v[0]
    return out


@njit(cache=True)
def left_jacobian(v: Array) -> Array:
    """(3, 3): ``Exp(v + dv) = Exp(left_jacobian(v) dv) Exp(v)`` for small dv."""
    angle, across = math.sqrt((v * v).sum()), hat(v)
    if angle < 1e-4:  # the closed form cancels
        return np.eye(3) + across / 2
    once, twice = (1 - math.cos(angle)) / angle**2, (angle - math.sin(angle)) / angle**3
    return np.eye(3) + once * across + twice * (across @ across)


@njit(cache=True)
def retract(x: Array, e: Array) -> Array:
    """The nominal state (STATE,) moved by an error (SIZE,) or (PLAIN,)."""
    out = x.copy()
    out[:XQ] += e[:TH]
    out[XQ:XW] = turned(x[XQ:XW], e[TH:W])
    out[XW:XC] += e[W:CP]
    if len(e) == SIZE:
        out[XC:XCQ] += e[CP:CT]
        out[XCQ:STATE] = turned(x[XCQ:STATE], e[CT:SIZE])
    return out


@njit(cache=True)
def rotation_vector(R: Array) -> Array:
    """(3,) of a rotation by less than half a turn."""
    out = np.empty(3)
    out[0], out[1], out[2] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    sine = math.sqrt((out * out).sum()) / 2
    angle = math.atan2(sine, (R[0, 0] + R[1, 1] + R[2, 2] - 1) / 2)
    return out * (0.5 + angle * angle / 12 if angle < 1e-4 else angle / (2 * max(sine, 1e-12)))


@njit(cache=True)
def difference(y: Array, x: Array, n: int) -> Array:
    """The error (n,) that takes the nominal state x to y."""
    out = np.empty(n)
    out[:TH] = y[:XQ] - x[:XQ]
    out[TH:W] = rotation_vector(np.ascontiguousarray(rotation(x[XQ:XW]).T) @ rotation(y[XQ:XW]))
    out[W:CP] = y[XW:XC] - x[XW:XC]
    if n == SIZE:
        out[CP:CT] = y[XC:XCQ] - x[XC:XCQ]
        kept = np.ascontiguousarray(rotation(x[XCQ:STATE]).T)
        out[CT:SIZE] = rotation_vector(kept @ rotation(y[XCQ:STATE]))
    return out


@njit(cache=True)
def correlated(dt: float, std: float, tau: float) -> tuple[Array, Array]:
    """An exponentially correlated signal s and its two integrals over dt.

    Gives the factors (of the double integral on s, of the integral on s, of s on s) and the covariance (3, 3)
    of (double integral, integral, s) that dt adds. Source: Singer 1970, equations 9 to 11.
    """
    b = dt / tau
    e = math.exp(-b)
    q = np.empty((3, 3))
    step = np.empty(3)
    if b < 0.02:  # the closed form cancels; of the series the leading terms are exact enough
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
    """Move state and covariance C by dt, in place; the transition's figures go to F (9, 3), for
    `pull_back`."""
    a, qa = correlated(dt, model[ACCEL_STD], model[ACCEL_TAU])
    w, qw = correlated(dt, model[RATE_STD], model[RATE_TAU])
    v = w[1] * x[XW : XW + 3]
    F[0, 0], F[0, 1], F[0, 2] = dt, a[0], a[1]
    F[1, 0], F[1, 1] = a[2], w[2]
    F[1, 2] = math.exp(-dt / model[TILT_TAU])
    F[2:5] = rotation(turned(np.array([1.0, 0.0, 0.0, 0.0]), -v))
    F[5:8] = w[1] * (np.eye(3) - 0.5 * hat(v))
    F[8, 0] = math.exp(-dt / model[FLOW_TAU])
    for k in range(3):
        x[k] += dt * x[V + k] + a[0] * x[A + k]
        x[V + k] += a[1] * x[A + k]
        x[A + k] *= a[2]
    x[XQ:XW] = turned(x[XQ:XW], v)
    x[XW : XW + 3] *= w[2]
    x[AT + 1 : AT + 3] *= F[1, 2]
    x[VB + 1 : VB + 3] *= F[8, 0]
    both_sides(C, F, False)
    for k in range(3):
        for i in range(3):
            for j in range(3):
                C[3 * i + k, 3 * j + k] += qa[i, j]
        C[TH + k, TH + k] += qw[1, 1]
        C[TH + k, W + k] += qw[1, 2]
        C[W + k, TH + k] += qw[1, 2]
        C[W + k, W + k] += qw[2, 2]
        C[BG + k, BG + k] += model[GYRO_WALK] ** 2 * dt
        C[BA + k, BA + k] += model[BIAS_WALK] ** 2 * dt
    for k in range(2):
        C[AT + k, AT + k] += model[TILT_STD] ** 2 * (1 - F[1, 2] ** 2)
        C[VB + k, VB + k] += model[FLOW_STD] ** 2 * (1 - F[8, 0] ** 2)
    C[AT + 2, AT + 2] += model[YAW_WALK] ** 2 * dt
    C[BO, BO] += model[BARO_WALK] ** 2 * dt


@njit(cache=True)
def push(v: Array, F: Array) -> None:
    """The transition times an error v (n,), in place: position takes from velocity and acceleration, and so
    on."""
    for k in range(3):
        v[P + k] += F[0, 0] * v[V + k] + F[0, 1] * v[A + k]
        v[V + k] += F[0, 2] * v[A + k]
        v[A + k] *= F[1, 0]
    t0, t1, t2, w0, w1, w2 = v[TH], v[TH + 1], v[TH + 2], v[W], v[W + 1], v[W + 2]
    for k in range(3):
        turn = F[2 + k, 0] * t0 + F[2 + k, 1] * t1 + F[2 + k, 2] * t2
        v[TH + k] = turn + F[5 + k, 0] * w0 + F[5 + k, 1] * w1 + F[5 + k, 2] * w2
        v[W + k] *= F[1, 1]
    for k in range(2):
        v[AT + k] *= F[1, 2]
        v[VB + k] *= F[8, 0]


@njit(cache=True)
def pull(v: Array, F: Array) -> None:
    """The transposed transition times v (n,), in place."""
    for k in range(3):
        v[A + k] = F[0, 1] * v[P + k] + F[0, 2] * v[V + k] + F[1, 0] * v[A + k]
        v[V + k] += F[0, 0] * v[P + k]
    t0, t1, t2 = v[TH], v[TH + 1], v[TH + 2]
    for k in range(3):
        v[W + k] = F[1, 1] * v[W + k] + F[5, k] * t0 + F[6, k] * t1 + F[7, k] * t2
    for k in range(3):
        v[TH + k] = F[2, k] * t0 + F[3, k] * t1 + F[4, k] * t2
    for k in range(2):
        v[AT + k] *= F[1, 2]
        v[VB + k] *= F[8, 0]


@njit(cache=True)
def both_sides(C: Array, F: Array, back: bool) -> None:
    """``F C F'`` (or, ``back``, ``F' C F``) of a symmetric C, in place; symmetric to the last bit."""
    n = len(C)
    for _ in range(2):
        for r in range(n):
            if back:
                pull(C[r], F)
            else:
                push(C[r], F)
        for r in range(n):
            for j in range(r):
                C[r, j], C[j, r] = C[j, r], C[r, j]
    for r in range(n):
        for j in range(r):
            C[r, j] = C[j, r] = (C[r, j] + C[j, r]) / 2
