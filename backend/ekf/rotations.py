"""Rotations in three dimensions: numba kernels.

Vectors, matrices and unit quaternions (w, x, y, z) are tuples of numbers, which stay in registers. Small
arrays take longer to allocate, and far longer to compile.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from backend.compilation import discard_stale, inner_kernel

Array = NDArray[np.float64]
Vector: TypeAlias = tuple[float, float, float]
Matrix: TypeAlias = tuple[Vector, Vector, Vector]
Quaternion: TypeAlias = tuple[float, float, float, float]

_EKF = Path(__file__).parent
discard_stale(
    [
        *_EKF.glob("*.py"),
        _EKF.parent / "measurements" / "__init__.py",
        _EKF.parent / "sparse_product.py",
    ]
)


@inner_kernel
def vector(array: Array) -> Vector:
    """Return the first three entries of an array."""
    return array[0], array[1], array[2]


@inner_kernel
def scaled(s: float, v: Vector) -> Vector:
    """Return the product of a number and a vector."""
    return s * v[0], s * v[1], s * v[2]


@inner_kernel
def added(a: Vector, b: Vector) -> Vector:
    """Return the sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inner_kernel
def dot(a: Vector, b: Vector) -> float:
    """Return the scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inner_kernel
def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product of two vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inner_kernel
def apply(A: Matrix, v: Vector) -> Vector:
    """Return the product of a matrix and a vector."""
    return dot(A[0], v), dot(A[1], v), dot(A[2], v)


@inner_kernel
def transpose(A: Matrix) -> Matrix:
    """Return the transpose of a matrix."""
    return (A[0][0], A[1][0], A[2][0]), (A[0][1], A[1][1], A[2][1]), (A[0][2], A[1][2], A[2][2])


@inner_kernel
def multiply(A: Matrix, B: Matrix) -> Matrix:
    """Return the product of two matrices."""
    columns = transpose(B)
    return apply(columns, A[0]), apply(columns, A[1]), apply(columns, A[2])


@inner_kernel
def hat(v: Vector) -> Matrix:
    """Return the matrix with ``hat(v) u == cross(v, u)``."""
    return (0.0, -v[2], v[1]), (v[2], 0.0, -v[0]), (-v[1], v[0], 0.0)


@inner_kernel
def write(A: Matrix, scale: float, block: Array) -> None:
    """Write ``scale`` times a matrix into the first rows and columns of an array."""
    a, b, c = A
    block[0, 0], block[0, 1], block[0, 2] = scale * a[0], scale * a[1], scale * a[2]
    block[1, 0], block[1, 1], block[1, 2] = scale * b[0], scale * b[1], scale * b[2]
    block[2, 0], block[2, 1], block[2, 2] = scale * c[0], scale * c[1], scale * c[2]


@inner_kernel
def write_row(v: Vector, scale: float, row: Array) -> None:
    """Write ``scale`` times a vector into the first entries of an array."""
    row[0], row[1], row[2] = scale * v[0], scale * v[1], scale * v[2]


@inner_kernel
def quaternion(array: Array) -> Quaternion:
    """Return the first four entries of an array."""
    return array[0], array[1], array[2], array[3]


@inner_kernel
def compose(p: Quaternion, q: Quaternion) -> Quaternion:
    """Return the product of two quaternions: the rotation q, then p."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


@inner_kernel
def exponential(v: Vector) -> Quaternion:
    """Return the quaternion of a rotation vector."""
    angle = math.sqrt(dot(v, v))
    s = math.sin(angle / 2) / angle if angle > 1e-8 else 0.5
    return math.cos(angle / 2), s * v[0], s * v[1], s * v[2]


@inner_kernel
def logarithm(q: Quaternion) -> Vector:
    """Return the rotation vector of a quaternion, at most half a turn."""
    v = q[1], q[2], q[3]
    s = math.sqrt(dot(v, v))
    factor = 2.0 * math.atan2(s, abs(q[0])) / s if s > 1e-8 else 2.0
    return scaled(factor if q[0] >= 0.0 else -factor, v)


@inner_kernel
def rotation(q: Quaternion) -> Matrix:
    """Return the rotation matrix of a unit quaternion."""
    w, x, y, z = q
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


@inner_kernel
def left_jacobian(v: Vector) -> Matrix:
    """Return the left Jacobian J of ``Exp(v)``: ``Exp(v + dv) = Exp(J dv) Exp(v)`` for small dv."""
    x, y, z = v
    square = dot(v, v)
    angle = math.sqrt(square)
    a, b = 0.5, 0.0
    if angle >= 1e-4:  # below, the closed form cancels
        a, b = (1.0 - math.cos(angle)) / square, (angle - math.sin(angle)) / (square * angle)
    return (
        (1.0 + b * (x * x - square), b * x * y - a * z, b * x * z + a * y),
        (b * x * y + a * z, 1.0 + b * (y * y - square), b * y * z - a * x),
        (b * x * z - a * y, b * y * z + a * x, 1.0 + b * (z * z - square)),
    )


@inner_kernel
def rotation_vector(R: Matrix) -> Vector:
    """Return the rotation vector of a matrix that rotates by less than half a turn."""
    v = R[2][1] - R[1][2], R[0][2] - R[2][0], R[1][0] - R[0][1]
    sine = math.sqrt(dot(v, v)) / 2
    angle = math.atan2(sine, (R[0][0] + R[1][1] + R[2][2] - 1) / 2)
    return scaled(0.5 + angle * angle / 12 if angle < 1e-4 else angle / (2 * max(sine, 1e-12)), v)


@inner_kernel
def rotate(x: Array, v: Vector, out: Array) -> None:
    """Write the unit quaternion of ``R Exp(v)`` into ``out``, where x holds that of R."""
    w, a, b, c = compose(quaternion(x), exponential(v))
    norm = math.sqrt(w * w + a * a + b * b + c * c)
    out[0], out[1], out[2], out[3] = w / norm, a / norm, b / norm, c / norm
