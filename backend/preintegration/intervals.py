"""Readings of gyro and accelerometer, integrated between successive keyframes by gtsam.

Source: Forster et al. 2017 (T-RO 33), section VI, for the preintegrated measurement and its covariance; gtsam
integrates in the tangent space of the initial state.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.errors import BackendError
from backend.measurements import GRAVITY_M_S2, Inertial, InertialNoise
from backend.preintegration.integrals import covered, dense, integrate
from backend.whitening import whitening

Array = NDArray[np.float64]

STATE_SIZE = 15
"""Rows of the error of an interval: rotation, position, velocity, bias of accelerometer and gyro (3 each)."""
ROTATION, POSITION, MOTION = slice(0, 3), slice(3, 6), slice(3, 9)
"""Rows that the gyro dominates, rows of the position, and rows that the accelerometer dominates."""
_LEAST_GAP_S = 0.05
"""Time without a reading that is no gap. Small vehicles turn at less than 10 Hz, so that a straight line
bridges a twentieth of a second."""
_STEP_S = 0.004
"""Least step of the integration. The readings of a faster IMU are averaged over it."""
_NO_NOISE = 1e-9
"""Density of an instrument whose noise is left out of a covariance."""


@dataclass(frozen=True)
class InertialInterval:
    """Readings between two successive keyframes, integrated."""

    i: int
    j: int
    factor: gtsam.CombinedImuFactor
    """Error by metric poses (keys 0, 2), velocities (1, 3) and biases (4, 5) of the IMU at both ends."""
    gyro_covariance: Array
    """(15, 15) covariance of the error by noise and random walk of the gyro."""
    accel_covariance: Array
    """(15, 15) the same of the accelerometer."""
    rates_rad_s: Array
    """(2, 3) body rates at both ends."""
    mean_rate_rad_s: Array
    """(3,)."""
    noise: InertialNoise
    """Nominal noise, which the covariances count."""

    def covariance(self, gyro_factor: float, accel_factor: float) -> Array:
        """Return the covariance (15, 15) of the error, for noise larger by these factors."""
        return gyro_factor**2 * self.gyro_covariance + accel_factor**2 * self.accel_covariance

    def whitening(self, gyro_factor: float, accel_factor: float) -> Array:
        """Return the matrix (15, 15) that whitens the error, for noise larger by these factors.

        Raises ``BackendError`` if the rates are too large for a covariance.
        """
        covariance = self.covariance(gyro_factor, accel_factor)
        try:
            return whitening(covariance)
        except np.linalg.LinAlgError as error:
            raise BackendError("the gyro turns too fast to be integrated: check its unit") from error


@dataclass(frozen=True)
class ImuBias:
    """Bias of accelerometer and gyro in body axes, (3,) each."""

    accel_m_s2: Array
    gyro_rad_s: Array


NO_BIAS = ImuBias(np.zeros(3), np.zeros(3))


def preintegrate(
    inertial: Inertial,
    stamps_s: Array,
    bias: ImuBias = NO_BIAS,
    cut: Collection[int] = (),
    of_body: bool = False,
) -> tuple[InertialInterval, ...]:
    """Integrate the readings between successive keyframes at increasing ``stamps_s`` (n,).

    Intervals that begin at a keyframe of ``cut`` are left out, and those with a gap or an invalid reading.
    ``bias`` is the point of linearisation: the effect of another one is exact to first order. The states are
    those of the IMU, or ``of_body``, where its nominal position counts and the force by a change of the rate
    of turn is neglected.
    """
    readings = inertial.readings
    known = covered(readings.stamps_s, stamps_s, _LEAST_GAP_S)
    known[list(cut)] = False
    known &= np.diff(np.searchsorted(inertial.invalid_s, stamps_s)) == 0
    both = np.hstack([readings.accel_m_s2, readings.gyro_rad_s])
    read_s, read = dense(readings.stamps_s, both, _LEAST_GAP_S)
    times_s = np.union1d(read_s, stamps_s)
    values = np.column_stack([np.interp(times_s, read_s, column) for column in read.T])
    integral = integrate(times_s, values)
    at = np.searchsorted(times_s, stamps_s)
    constant = gtsam.imuBias.ConstantBias(bias.accel_m_s2, bias.gyro_rad_s)
    noise = inertial.noise
    parts = [_parameters(noise, accel) for accel in (True, False)]
    for part in parts if of_body else ():
        part.setBodyPSensor(gtsam.Pose3(gtsam.Rot3(), inertial.b_p_imu_m))
    intervals = []
    for k in np.flatnonzero(known).tolist():
        node = _thinned(times_s, int(at[k]), int(at[k + 1]))
        steps_s = np.diff(times_s[node])
        means = np.diff(integral[node], axis=0) / steps_s[:, None]
        rates = values[[at[k], at[k + 1]], 3:] - bias.gyro_rad_s
        intervals.append(_interval(k, means, steps_s, constant, noise, parts, rates))
    return tuple(intervals)


def _thinned(times_s: Array, start: int, stop: int) -> NDArray[np.int64]:
    """Return indices of times from ``start`` to ``stop``, both included, at least a step apart."""
    inside = np.arange(start, stop)
    bins = np.floor((times_s[inside] - times_s[start]) / _STEP_S + 1e-6)
    return np.append(inside[np.unique(bins, return_index=True)[1]], stop)


def _parameters(noise: InertialNoise, accel: bool) -> gtsam.PreintegrationCombinedParams:
    """Return parameters with the noise of the gyro, and with or without that of the accelerometer."""
    parameters = gtsam.PreintegrationCombinedParams.MakeSharedU(GRAVITY_M_S2)
    parameters.setGyroscopeCovariance(noise.gyro_density**2 * np.eye(3))
    parameters.setBiasOmegaCovariance(noise.gyro_walk**2 * np.eye(3))
    parameters.setAccelerometerCovariance((noise.accel_density if accel else _NO_NOISE) ** 2 * np.eye(3))
    parameters.setBiasAccCovariance((noise.accel_walk if accel else _NO_NOISE) ** 2 * np.eye(3))
    parameters.setIntegrationCovariance(_NO_NOISE**2 * np.eye(3))
    return parameters


def _interval(
    i: int,
    means: Array,
    steps_s: Array,
    bias: gtsam.imuBias.ConstantBias,
    noise: InertialNoise,
    parts: list[gtsam.PreintegrationCombinedParams],
    rates: Array,
) -> InertialInterval:
    """Integrate mean readings (m, 6) over steps (m,) from keyframe ``i`` to the next one."""
    by_both, by_gyro = (gtsam.PreintegratedCombinedMeasurements(part, bias) for part in parts)
    for mean, step_s in zip(means, steps_s.tolist(), strict=True):
        by_gyro.integrateMeasurement(mean[:3], mean[3:], step_s)
        by_both.integrateMeasurement(mean[:3], mean[3:], step_s)
    return InertialInterval(
        i=i,
        j=i + 1,
        factor=gtsam.CombinedImuFactor(0, 1, 2, 3, 4, 5, by_both),
        gyro_covariance=by_gyro.preintMeasCov(),
        accel_covariance=by_both.preintMeasCov() - by_gyro.preintMeasCov(),
        rates_rad_s=rates,
        mean_rate_rad_s=steps_s @ means[:, 3:] / steps_s.sum() - bias.gyroscope(),
        noise=noise,
    )


def chains(intervals: tuple[InertialInterval, ...]) -> Iterator[list[InertialInterval]]:
    """Yield runs of intervals that follow each other without a break."""
    run: list[InertialInterval] = []
    for interval in intervals:
        if run and interval.i != run[-1].j:
            yield run
            run = []
        run.append(interval)
    if run:
        yield run
