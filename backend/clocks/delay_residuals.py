"""Turns of the pictures against turns of the gyro, for every delay of the pictures' clock.

Between two pictures the vehicle turns by what the gyro measured between the moments of their exposure. A
delay moves these moments. The difference of the two turns is a vector of three components, which has the
gyro's bias times the duration, white noise of both pictures, and the gyro's random walk. Unlike displacements
from the accelerometer, turns need neither scale nor gravity, lever arm or a second integral.

Source: Li and Mourikis 2014 (IJRR 33), section 3, for the model of the delay; Harville 1977 (JASA 72) for the
likelihood of the noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky_banded, lapack
from scipy.spatial.transform import Rotation

from backend import quaternions
from backend.clocks.sampling import sampling_std_s
from backend.measurements import InertialReadings

Array = NDArray[np.float64]

GRID_STEP_S = 0.01
"""Step of the delays: a vehicle turns at less than 10 Hz, so that the likelihood is smooth at this step."""
LONGEST_DELAY_S = 2.0
"""Longest delay that is looked for besides a step of the clock: encoders and networks hold pictures back for
a second or so."""
_SHARE = 0.25
"""Largest share of the flight that the search may leave out at each end."""
_SPACING_S, _MOST_TURNS = 0.05, 1500
"""Smallest spacing of pictures, and the largest number of turns; longer flights are sampled more coarsely."""
_AT_ONCE = 10_000
"""Rotations in a block: its arrays stay in the cache of a core. Blocks of 100,000 take 1.4 times as long."""
_MAX_GAP_S = 0.1
"""Longest gap in the gyro's readings within a turn."""
_LONGEST_TURN_S = 2.0
"""Over longer turns the gyro's bias and gain matter more than its noise."""
_COARSE = 4
"""Every so many delays are tried to find out what kind of noise there is."""
_RATIOS = np.geomspace(1e-2, 1e3, 11)
"""Tried ratios of the gyro's random walk over a turn to the white noise of a picture, as variances."""


@dataclass(frozen=True)
class DelayResiduals:
    """Differences between the changes of a motion by two streams, for each change and each delay.

    Changes are turns in radians by default, or changes of velocity in m/s. The second stream is the gyro, or
    the IMU.
    """

    delays_s: Array
    """(g,) tried delays, evenly spaced."""
    begin_s: Array
    """(n,) stamps of the first stream at which the changes begin."""
    end_s: Array
    """(n,)."""
    change: Array
    """(n, c) changes by the first stream along each axis."""
    difference: Array
    """(n, g, c) these less the changes by the second stream."""
    sampling_std_s: float = 0.0
    """Standard deviation of an error of all delays alike, from the sampling of the gyro."""

    def part(self, turns: slice | NDArray[np.int64]) -> DelayResiduals:
        """Return the residuals of some changes, in the order of time."""
        rows = (self.begin_s, self.end_s, self.change, self.difference)
        begin_s, end_s, change, difference = (values[turns] for values in rows)
        return replace(self, begin_s=begin_s, end_s=end_s, change=change, difference=difference)

    def whitened(self, ratio: float, axes: slice = slice(None)) -> tuple[Array, float]:
        """Return residuals (a, n, g) of some axes, white up to their size and without the gyro's bias.

        Beside them is the logarithm of the determinant of the covariance that was divided out.

        ``ratio``: variance of the random walk over a turn, over that of a picture's white noise.
        """
        lasts_s = self.end_s - self.begin_s
        joined = self.begin_s[1:] == self.end_s[:-1]
        band = np.zeros((2, len(lasts_s)))
        band[0] = 2.0 + ratio * lasts_s / np.median(lasts_s)
        band[1, :-1] = np.where(joined, -1.0, 0.0)
        factor = cholesky_banded(band, lower=True)
        difference = np.moveaxis(self.difference[:, :, axes], -1, 1)
        values = np.column_stack([difference.reshape(len(lasts_s), -1), lasts_s])
        white = lapack.dtbtrs(factor, values, uplo="L")[0]
        white, lasting = white[:, :-1], white[:, -1]
        white -= np.outer(lasting @ white / (lasting @ lasting), lasting).T  # in LAPACK's order
        log_determinant = 2.0 * float(np.log(factor[0]).sum())
        return np.moveaxis(white.reshape(difference.shape), 1, 0), log_determinant

    @cached_property
    def squares(self) -> Array:
        """Squares (c, n, g) of the white residuals of each axis, turn and delay."""
        return self.squares_with(self.ratios)

    @cached_property
    def ratios(self) -> tuple[float, ...]:
        """For each axis, whether its noise is white or a random walk, as ``ratio`` of ``whitened``; estimated
        at the best delay."""
        n, tried = len(self.begin_s), []
        coarse = replace(self, difference=self.difference[:, ::_COARSE])
        for ratio in _RATIOS.tolist():
            white, log_determinant = coarse.whitened(ratio)
            tried.append(n * np.log(mean_square(white**2)) + log_determinant)
        costs = np.array(tried)
        best = int(np.argmin(costs.min(axis=0).sum(axis=0)))
        return tuple(_RATIOS[costs[:, :, best].argmin(axis=0)].tolist())

    def squares_with(self, ratios: tuple[float, ...]) -> Array:
        """Return the squares (c, n, g) of the residuals with the kind of noise of each axis given."""
        squares = np.empty((len(ratios), *self.difference.shape[:2]))
        for axis, ratio in enumerate(ratios):
            np.square(self.whitened(ratio, slice(axis, axis + 1))[0][0], out=squares[axis])
        return squares


def delay_residuals(
    stamps_s: Array,
    w_R_b: Array,
    chain: NDArray[np.int64],
    readings: InertialReadings,
    longest_delay_s: float | None = None,
    step_s: float = GRID_STEP_S,
) -> DelayResiduals | None:
    """Compare attitudes (n, 3, 3) at stamps (n,), sorted, with a gyro; None where the two do not overlap.

    Turns within one ``chain`` (n,) of attitudes are known, turns between two are not. Without
    ``longest_delay_s``, delays up to ``LONGEST_DELAY_S`` and a step over the longest pause are tried.
    """
    if len(stamps_s) < 2:
        return None
    if longest_delay_s is None:
        longest_delay_s = LONGEST_DELAY_S + float(np.diff(stamps_s).max())
    lasts_s, rows = float(stamps_s[-1] - stamps_s[0]), thinned(stamps_s)
    steps = int(min(longest_delay_s, _SHARE * lasts_s) / step_s)
    delays_s = np.arange(-steps, steps + 1, dtype=np.float64) * step_s
    return residuals_at(delays_s, stamps_s[rows], w_R_b[rows], chain[rows], readings)


def thinned(stamps_s: Array) -> NDArray[np.int64]:
    """Return the rows of stamps (n,), sorted, that are so far apart and so few as the search needs them."""
    if len(stamps_s) == 0:
        return np.zeros(0, dtype=np.int64)
    covered_s = float(np.minimum(np.diff(stamps_s), _LONGEST_TURN_S).sum())
    spacing_s = max(_SPACING_S, covered_s / _MOST_TURNS)
    return np.unique(np.floor((stamps_s - stamps_s[0]) / spacing_s), return_index=True)[1]


def readings_between(readings: InertialReadings, begin_s: float, end_s: float) -> InertialReadings:
    """Return the readings from ``begin_s`` to ``end_s``, with the next one on each side."""
    first = max(int(np.searchsorted(readings.stamps_s, begin_s, side="right")) - 1, 0)
    rows = slice(first, int(np.searchsorted(readings.stamps_s, end_s)) + 1)
    return replace(
        readings,
        stamps_s=readings.stamps_s[rows],
        gyro_rad_s=readings.gyro_rad_s[rows],
        accel_m_s2=readings.accel_m_s2[rows],
    )


def residuals_at(
    delays_s: Array, stamps_s: Array, w_R_b: Array, chain: NDArray[np.int64], readings: InertialReadings
) -> DelayResiduals | None:
    """Compare successive attitudes (n, 3, 3) with a gyro at the delays (g,), which are evenly spaced.

    Only turns are kept that the gyro covers at every delay; None where there is none.
    """
    kept = _covered(stamps_s, readings.stamps_s, delays_s) & (chain[1:] == chain[:-1])
    if not kept.any():
        return None
    first, last = np.flatnonzero(kept), np.flatnonzero(kept) + 1
    attitude = Rotation.from_matrix(w_R_b).as_quat()
    turned = quaternions.product(quaternions.inverse(attitude[first]), attitude[last])
    by_gyro = _GyroAttitude.of(readings)
    ends = np.union1d(first, last)
    begins_at, ends_at = np.searchsorted(ends, first), np.searchsorted(ends, last)
    difference_rad = np.empty((len(first), len(delays_s), 3))
    for some in np.array_split(np.arange(len(delays_s)), len(stamps_s) * len(delays_s) // _AT_ONCE + 1):
        at = by_gyro.at(stamps_s[ends, None] - delays_s[some])
        back_by_gyro = quaternions.product(quaternions.inverse(at[ends_at]), at[begins_at])
        difference = quaternions.product(back_by_gyro, turned[:, None])
        difference_rad[:, some] = quaternions.rotation_vectors(difference)
    turn_rad = quaternions.rotation_vectors(turned)
    begin_s, end_s = stamps_s[first], stamps_s[last]
    sampling = sampling_std_s(readings, float(np.median(end_s - begin_s)))
    return DelayResiduals(delays_s, begin_s, end_s, turn_rad, difference_rad, sampling)


def gyro_attitudes(readings: InertialReadings, stamps_s: Array) -> Array:
    """Return the attitudes (n, 3, 3) by the gyro alone at stamps (n,), relative to its first reading."""
    return np.asarray(Rotation.from_quat(_GyroAttitude.of(readings).at(stamps_s)).as_matrix())


def turn_costs(squares: Array) -> Array:
    """Return the log-likelihood (n, g) of each turn at each delay, times -2, from squares (c, n, g).

    The size of the noise of each axis is estimated at each delay.
    """
    costs = np.zeros(squares.shape[1:])
    for of_axis in squares:  # one by one: all at once would take three times the memory of the squares
        variance = mean_square(of_axis)
        costs += of_axis / variance + np.log(variance)
    return costs


def mean_square(squares: Array) -> Array:
    """Return the mean (..., g) of squares (..., n, g); readings without noise have rounding errors."""
    return np.asarray(np.maximum(squares.mean(axis=-2), 1e-24))


def _covered(stamps_s: Array, imu_s: Array, delays_s: Array) -> NDArray[np.bool_]:
    """Return (n - 1,) whether the gyro has no gap between two successive pictures, whatever the delay."""
    gap = np.diff(imu_s) > _MAX_GAP_S
    begin_s, end_s = stamps_s[:-1] - delays_s[-1], stamps_s[1:] - delays_s[0]
    whole = np.searchsorted(imu_s[1:][gap], begin_s) == np.searchsorted(imu_s[:-1][gap], end_s)
    inside = (begin_s >= imu_s[0]) & (end_s <= imu_s[-1])
    return np.asarray(whole & inside & (np.diff(stamps_s) <= _LONGEST_TURN_S + delays_s[-1]))


@dataclass(frozen=True)
class _GyroAttitude:
    """Attitude by the gyro relative to its first reading."""

    stamps_s: Array
    rate_rad_s: Array
    """(k - 1, 3) mean rate between two readings."""
    attitude: Array
    """(k, 4) quaternions."""

    @staticmethod
    def of(readings: InertialReadings) -> _GyroAttitude:
        rate = 0.5 * (readings.gyro_rad_s[1:] + readings.gyro_rad_s[:-1])
        turns = Rotation.from_rotvec(rate * np.diff(readings.stamps_s)[:, None]).as_quat()
        return _GyroAttitude(readings.stamps_s, rate, quaternions.composed(turns))

    def at(self, at_s: Array) -> Array:
        """Return the quaternions (..., 4) at stamps (...)."""
        piece = np.clip(np.searchsorted(self.stamps_s, at_s, side="right") - 1, 0, len(self.rate_rad_s) - 1)
        since_s = at_s - self.stamps_s[piece]
        turns = Rotation.from_rotvec((self.rate_rad_s[piece] * since_s[..., None]).reshape(-1, 3))
        return quaternions.product(self.attitude[piece], turns.as_quat().reshape(*at_s.shape, 4))
