"""Heights of a barometer in the graph: changes of height, times a gain, over an unknown level.

A pressure altitude assumes the temperature of the standard atmosphere, so that all its changes are wrong by
one share; and its zero is that of another place and weather. Both are variables. Slow changes of the pressure
are autocorrelated noise (`backend.bundle.noise`), as they are for ranges.
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.bundle.factors import LOG_SCALE, WORLD
from backend.bundle.world import WorldTransform
from backend.measurements import BarometerHeight

Array = NDArray[np.float64]

HEIGHTS = gtsam.symbol("h", 0)
"""Key of the variable (2,) of gain and zero [m]."""
GAIN, ZERO = 0, 1
GAIN_STD = 0.04
"""Relative standard deviation of the gain. Heights are proportional to the absolute temperature of the air,
for which the standard atmosphere has 288 K at sea level: 12 K colder or warmer."""
_UNKNOWN_M = 1e4
"""Standard deviation of the zero: no barometer reads more."""


def height_factor(
    pose_key: int, height_m: float, model: gtsam.noiseModel.Base, b_T_c: Array
) -> gtsam.CustomFactor:
    """Return the factor of a height: gain z + zero - height, with z of the body in the world."""

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        camera, (gain, zero) = values.atPose3(pose_key), values.atVector(HEIGHTS)
        transform = WorldTransform.of(values, b_T_c)
        body = transform.body_pose(camera)
        if jacobians is not None:
            by_both = gain * body.rotation().matrix()[2:] @ transform.jacobian(camera)[3:]
            jacobians[0], jacobians[1] = by_both[:, :6], by_both[:, 6:]
            jacobians[2] = np.array([[body.z(), 1.0]])
        return np.array([gain * body.z() + zero - height_m])

    return gtsam.CustomFactor(model, [pose_key, WORLD, HEIGHTS], error)


def heights_prior(start: gtsam.Values) -> gtsam.PriorFactorVector:
    """Return the prior on gain and zero."""
    model = gtsam.noiseModel.Diagonal.Sigmas(np.array([GAIN_STD, _UNKNOWN_M]))
    return gtsam.PriorFactorVector(HEIGHTS, np.array([1.0, start.atVector(HEIGHTS)[ZERO]]), model)


def read_and_mapped(heights: Sequence[BarometerHeight], w_T_b: Array) -> tuple[Array, Array]:
    """Return the heights in metres that were read, and those of metric poses (n, 4, 4) there, both (h,)."""
    read = np.array([height.height_m for height in heights])
    return read, w_T_b[[height.k for height in heights], 2, 3]


def height_gain(read: Array, z: Array) -> float:
    """Return the slope of heights (h,) that were read over those of the poses ``z`` (h,); 0 for equal ones.

    It is that of least squares, as if all noise were in the readings.
    """
    off = z - z.mean()
    return float(off @ (read - read.mean())) / max(float(off @ off), 1e-12)


def start_heights(
    heights: tuple[BarometerHeight, ...], w_T_b: Array, world: Array, tells_scale: bool
) -> tuple[Array, Array]:
    """Return the initial world variable (14,), and gain and zero (2,), from metric poses (n, 4, 4).

    If the heights alone tell the scale (``tells_scale``), the world gets theirs.
    """
    world = world.copy()
    read, z = read_and_mapped(heights, w_T_b)
    ratio = 1.0
    if tells_scale and len(heights) > 1:
        # The poses' changes of height have hardly any noise beside those of the barometer.
        slope = height_gain(read, z)
        ratio = slope if slope > 0 else 1.0
        world[LOG_SCALE] += np.log(ratio)
    return world, np.array([1.0, float(np.median(read - ratio * z))])


def height_residuals(heights: tuple[BarometerHeight, ...], w_T_b: Array, gain_zero: Array) -> Array:
    """Return heights by metric poses (n, 4, 4) less those that were read, (h,)."""
    read, z = read_and_mapped(heights, w_T_b)
    return np.asarray(gain_zero[GAIN] * z + gain_zero[ZERO] - read)
