"""Noise of an IMU in flight, from what the pictures before showed.

Vibration, quantisation and late stamps add to the noise at rest. Where pictures join keyframes, the turn of
an interval differs from theirs by noise of the gyro. Over two successive intervals the velocity can be
eliminated: what is left of the displacements, less the noise of the pictures, is noise of the accelerometer.
Medians keep single wrong pictures out.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.measurements import GRAVITY_M_S2, RelativePose
from backend.preintegration.intervals import ROTATION, InertialInterval
from backend.preintegration.limits import MOST_SIGMAS
from backend.quantiles import chi_square_quantile

Array = NDArray[np.float64]

_LEAST = 10
"""Fewer residuals tell the noise too poorly: the median of ten is known to a third."""


class FlightNoise:
    """Residuals of the readings so far, and the noise that they show."""

    def __init__(self) -> None:
        self._turns: list[tuple[float, float, Array, float]] = []
        self._moves: list[tuple[float, float, Array, float]] = []
        self._last: tuple[InertialInterval, RelativePose] | None = None

    def add(self, interval: InertialInterval, edge: RelativePose, w_R_i: Array) -> None:
        """Add an interval and the relative pose of its keyframes by the pictures.

        ``w_R_i`` (3, 3) is the attitude at its beginning.
        """
        integrated, i_R_j = interval.factor.preintegratedMeasurements(), edge.i_T_j[:3, :3]
        off_rad = integrated.deltaRij().localCoordinates(gtsam.Rot3(i_R_j))
        noise = float(np.trace(interval.gyro_covariance[ROTATION, ROTATION]))
        by_pictures = float(np.trace(edge.covariance[:3, :3]))
        self._turns.append((noise, by_pictures, off_rad, integrated.deltaTij()))
        last, self._last = self._last, (interval, edge)
        if last is not None and last[1].j == edge.i:
            self._moves.append(self._moved(*last, interval, edge, w_R_i @ last[1].i_T_j[:3, :3].T))

    def _moved(
        self,
        before: InertialInterval,
        edge_before: RelativePose,
        interval: InertialInterval,
        edge: RelativePose,
        w_R_i: Array,
    ) -> tuple[float, float, Array, float]:
        """Return nominal variance, variance of the pictures, residual (3,) [m], and its derivative by a
        constant error of the accelerometer [s²].

        ``w_R_i`` (3, 3) is the attitude at the beginning of the interval ``before``.
        """
        first, second = (one.factor.preintegratedMeasurements() for one in (before, interval))
        a_s, b_s = first.deltaTij(), second.deltaTij()
        i_R_j, gravity = edge_before.i_T_j[:3, :3], w_R_i.T @ [0.0, 0.0, -GRAVITY_M_S2]
        velocity = (edge_before.i_T_j[:3, 3] - gravity * a_s**2 / 2 - first.deltaPij()) / a_s
        velocity = velocity + gravity * a_s + first.deltaVij()
        predicted = velocity * b_s + gravity * b_s**2 / 2 + i_R_j @ second.deltaPij()
        noise = interval.noise.accel_density**2 * b_s**2 * (a_s + b_s)
        ratio = (b_s / a_s) ** 2
        by_pictures = np.trace(edge.covariance[3:, 3:]) + ratio * np.trace(edge_before.covariance[3:, 3:])
        residual = i_R_j @ edge.i_T_j[:3, 3] - predicted
        return noise, float(by_pictures), residual, b_s * (a_s + b_s) / 2

    def factors(self) -> tuple[float, float] | None:
        """Return factors on the nominal noise of gyro and accelerometer, 1 or more.

        None if it is too early to tell, or if their noise, averaged over a second, is larger than an offset
        could be: then the readings are wrong.
        """
        if self._last is None or min(len(self._turns), len(self._moves)) < _LEAST:
            return None
        gyro, accel, nominal = _factor(self._turns), _factor(self._moves), self._last[0].noise
        is_right = gyro * nominal.gyro_density < MOST_SIGMAS * nominal.gyro_offset_rad_s
        is_right &= accel * nominal.accel_density < MOST_SIGMAS * nominal.accel_offset_m_s2
        return (gyro, accel) if is_right else None


def _factor(residuals: list[tuple[float, float, Array, float]]) -> float:
    """Return the factor on nominal noise from nominal variances, variances of the pictures, residuals (3,),
    and their derivatives by a constant error, which is estimated."""
    noise, by_pictures, off, by_constant = (np.array(column) for column in zip(*residuals, strict=True))
    off = off - np.median(off / by_constant[:, None], axis=0) * by_constant[:, None]
    # At this factor on a nominal variance, half of the residuals are below the median of chi-square.
    squares = (off**2).sum(axis=1) / (chi_square_quantile(0.5, 3) / 3)
    return float(np.sqrt(max(np.median((squares - by_pictures) / noise), 1.0)))
