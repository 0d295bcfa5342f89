"""Intervals at rest: of zero velocity before take-off, and those that say nothing about errors in flight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_opening

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.core.streams import Imu

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_WINDOW_S, _LEAST_READINGS, _STEP_S = 0.25, 10, 0.05
_GYRO_STD_RAD_S, _ACCEL_STD_M_S2 = 0.01, 0.1
_SPEED_M_S = 0.05
_SURE, _LAGS = 5.0, (1, 8)
"""Standard deviations by which spreads and means may differ by chance, in half an hour of windows; and the
distances of the windows whose means are compared."""
_BEFORE_MOTION_S = 2.0
"""Time at rest with which a filter begins: there the velocity is known. It is twice the time of the first
readings (0.5 s) and two errors of the velocity (1 s)."""


def zero_velocity_times(flight: Flight) -> Array:
    """Return times (n,) at the start of the flight at which the vehicle is at rest; possibly none.

    It is at rest while the spread of gyro and accelerometer is small and no velocity is measured. That is on
    the floor with the motors off, because in the air both spreads are far larger.
    """
    imu = flight.imu
    if imu is None or len(imu.stamps_s) == 0:
        return np.zeros(0)
    _, still = _still_windows(imu)
    begin_s = float(imu.stamps_s[0])
    until_s = begin_s + _WINDOW_S * int(np.argmin(np.append(still, False)))
    if flight.velocity is not None:
        moving = (np.abs(flight.velocity.v_m_s) > _SPEED_M_S).any(axis=1)
        until_s = min(until_s, float(flight.velocity.stamps_s[moving].min(initial=np.inf)))
    return np.arange(begin_s, until_s, _STEP_S)


def still_times(flight: Flight) -> Array:
    """Return times (n,) of the whole flight at which gyro and accelerometer are as calm as on the floor."""
    imu = flight.imu
    if imu is None or len(imu.stamps_s) == 0:
        return np.zeros(0)
    begins_s, still = _still_windows(imu)
    return np.asarray(begins_s[still])


@dataclass(frozen=True)
class RestWindows:
    """Successive windows of a flight in which the vehicle is at rest or moves.

    At rest neither wind nor vibration nor acceleration disturbs an instrument.
    """

    begins_s: Array
    """(w,); empty without an IMU, where nothing is known to rest."""
    rests: Mask
    """(w,)."""

    @staticmethod
    def of(flight: Flight) -> RestWindows:
        """Find the windows, several together, in which gyro, accelerometer and velocity vary as their noise.

        Their spread is that of a calm sensor, or the nominal noise; means of neighbours are equal within it.
        """
        imu, velocity = flight.imu, flight.velocity
        if imu is None or len(imu.stamps_s) < 2:
            return RestWindows(np.zeros(0), np.zeros(0, dtype=bool))
        begins_s = _begins_s(imu)
        root_hz = 1 / np.sqrt(float(np.median(np.diff(np.unique(imu.stamps_s)))))
        rests = np.ones(len(begins_s), dtype=bool)
        for values, floor, density in (
            (imu.gyro_rad_s, _GYRO_STD_RAD_S, imu.gyro_noise_density),
            (imu.accel_m_s2, _ACCEL_STD_M_S2, imu.accel_noise_density),
        ):
            noise = density * root_hz
            count, mean, std = _window_moments(begins_s, imu.stamps_s, values)
            chance = _SURE / np.sqrt(2 * np.maximum(count, 1))
            rests &= (count >= _LEAST_READINGS) & (std.max(axis=1) < np.maximum(floor, noise * (1 + chance)))
            for lag in _LAGS:
                change = np.abs(mean[lag:] - mean[:-lag])
                # A mean that is unknown, beside a gap, shows no change.
                rests[lag:] &= ~(change > 2 * chance[lag:, None] * std[lag:]).any(axis=1)
        rests |= 2 * count < np.median(count)  # a gap is no motion
        if velocity is not None:
            inside = (velocity.stamps_s >= begins_s[0]) & np.isfinite(velocity.v_m_s).all(axis=1)
            count, mean, _ = _window_moments(begins_s, velocity.stamps_s[inside], velocity.v_m_s[inside])
            noise_m_s = max(velocity.noise_std_m_s) / np.sqrt(np.maximum(count, 1))
            rests &= ~(np.abs(mean).max(axis=1) > np.maximum(_SPEED_M_S, _SURE * noise_m_s))
        together = np.ones(round(_BEFORE_MOTION_S / _WINDOW_S), dtype=bool)
        return RestWindows(begins_s, np.asarray(binary_opening(rests, together)))

    @property
    def any_motion(self) -> bool:
        """Whether the vehicle moves at all; True without an IMU, where nothing is known."""
        return len(self.rests) == 0 or not self.rests.all()

    def moves_at(self, stamps_s: Array) -> Mask:
        """Return whether the vehicle moves at each time (n,); everywhere if it never does."""
        if not self.any_motion:
            return np.ones(len(stamps_s), dtype=bool)
        rest_s = self.begins_s[self.rests]
        k = np.searchsorted(rest_s, stamps_s, side="right") - 1
        moves = ~((k >= 0) & (stamps_s - np.append(rest_s, np.inf)[k] < _WINDOW_S))
        return np.asarray(moves if moves.any() else np.ones_like(moves), dtype=bool)

    def first_motion_s(self, start_s: float) -> float:
        """Return when the vehicle first moves after ``start_s``; that time itself if it never does."""
        moving_s = self.begins_s[~self.rests & (self.begins_s >= start_s)]
        return float(moving_s[0]) if len(moving_s) else start_s

    def liveliest_start_s(self, start_s: float, lasts_s: float) -> float:
        """Return the time from which the vehicle moves most within ``lasts_s``: ``start_s``, or shortly
        before the end of a rest."""
        after = np.flatnonzero(self.rests[:-1] & ~self.rests[1:]) + 1
        starts_s = np.append(start_s, self.begins_s[after] - _BEFORE_MOTION_S)
        starts_s = starts_s[starts_s >= start_s]
        moving_s = self.begins_s[~self.rests]
        windows = np.searchsorted(moving_s, starts_s + lasts_s) - np.searchsorted(moving_s, starts_s)
        return float(starts_s[np.argmax(windows)])


def _still_windows(imu: Imu) -> tuple[Array, Mask]:
    """Return the begins (w,) of successive windows, and in which of them gyro and accelerometer are calm."""
    begins_s = _begins_s(imu)
    count, _, gyro = _window_moments(begins_s, imu.stamps_s, imu.gyro_rad_s)
    _, _, accel = _window_moments(begins_s, imu.stamps_s, imu.accel_m_s2)
    calm = (gyro < _GYRO_STD_RAD_S).all(axis=1) & (accel < _ACCEL_STD_M_S2).all(axis=1)
    return begins_s, (count >= _LEAST_READINGS) & calm


def _begins_s(imu: Imu) -> Array:
    count = max(int(np.ceil((imu.stamps_s[-1] - imu.stamps_s[0]) / _WINDOW_S)), 1)
    return np.asarray(imu.stamps_s[0] + _WINDOW_S * np.arange(count))


def _window_moments(
    begins_s: Array, stamps_s: Array, values: Array
) -> tuple[NDArray[np.int64], Array, Array]:
    """Return number (w,), mean and standard deviation (w, d) of values (n, d) in each window; NaN in one
    without any."""
    window, count = np.searchsorted(begins_s[1:], stamps_s, side="right"), len(begins_s)
    with np.errstate(invalid="ignore", divide="ignore"):
        rows = np.bincount(window, minlength=count)
        mean = np.column_stack([np.bincount(window, v, count) / rows for v in values.T])
        squares = (values - mean[window]) ** 2
        std = np.sqrt(np.column_stack([np.bincount(window, v, count) / rows for v in squares.T]))
    return rows, mean, std
