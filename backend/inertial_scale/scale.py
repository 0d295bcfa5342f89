"""Metric scale of a visual path, known up to scale from the pictures, from the accelerometer.

This is an errors-in-variables problem. The double integral of specific force has white noise integrated
twice. The poses have white noise and a random walk that neighbouring poses share, because they are registered
to the same keyframe over the same uneven floor. Least squares with either side exact would bias the scale
down or up; this is total least squares over both. The random walk must be modelled: attributed to the force,
it would make the path look exact. Position and tilt errors of a pose are almost fully correlated (a tilt
error displaces the camera by the height times that), so their joint covariance is used: otherwise a lever arm
as long as the height would explain both, and most of the path. The levels of all noises are
maximum-likelihood estimates. The poses are stamped by the clock of the readings
(`backend.clocks.picture_clock`).

Source: Fuller 1987, Measurement Error Models, section 2.3, for regressors that err together; Harville 1977
(JASA 72) for the likelihood of the noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from backend.inertial_scale.accelerometer_lag import AccelerometerLag, accelerometer_lag
from backend.inertial_scale.regression_rows import (
    MIN_POSES,
    MIN_SEGMENTS,
    MIN_SPACING_S,
    PRIOR,
    SEGMENT_S,
    SIZE,
    PathAndReadings,
    RegressionRows,
    find_segments,
    regressor_covariance,
)
from backend.measurements import InertialReadings
from backend.triple import triple

Array = NDArray[np.float64]

_FORCE_NOISE, _POSE_NOISE, _RANDOM_WALK_NOISE = 0.02, 4.0, 1.0
"""Initial noise: of the force, m/s²/sqrt(Hz); white noise and random walk (per root second) of the poses, as
factors on their nominal noise. Large initial pose noise avoids the local optimum in which poses count as
exact and the scale is too small."""
_MIN_SIGNIFICANCE = 5.0
"""Smallest ratio of the scale to its standard deviation."""
_MAX_OFFSET_M_S2 = 3.0
"""A larger offset means that the accelerometer has wrong signs or units."""
_ROUNDS = 3
_MAX_SCALE_RATIO = 10.0
"""Largest ratio of the scale to its initial guess."""
_LEAST_RATIO = 1 / _MAX_SCALE_RATIO
"""Smallest one."""
_ACROSS, _SLOPE = np.array([1, 2]), np.array([SIZE - 2, SIZE - 1])
"""Offset across the body's z, and slope of the floor: at one heading they are the same."""
_LEAST_HZ, _RATE_SLACK = 20.0, 1.05
"""Fewest readings a second, less what clocks and rounded stamps are off. Small vehicles turn at up to 10 Hz:
slower readings take such turns for slower ones, and lengths are 15 % and more too short."""


@dataclass(frozen=True)
class FloorSlope:
    """Specific force at rest along x and y of the floor over gravity."""

    rad: tuple[float, float]
    std_rad: float
    """Along either axis, the larger of both."""


UNKNOWN_SLOPE = FloorSlope((0.0, 0.0), float("inf"))


@dataclass(frozen=True)
class InertialScale:
    """Estimate of the scale and the accelerometer's parameters."""

    scale: float
    """Ratio of true lengths to those of the path."""
    scale_std: float
    """Standard deviation from noise alone, without gain errors."""
    offset_m_s2: tuple[float, float, float]
    """Offset of the accelerometer in body axes."""
    offset_std_m_s2: tuple[float, float, float]
    arm_m: tuple[float, float, float]
    """Lever arm from the body's origin to the accelerometer, in body axes."""
    arm_std_m: tuple[float, float, float]
    gain_slopes: tuple[float, float, float]
    """d log(scale) / d log(gain) for the accelerometer's gain along each body axis. The rotors' thrust is
    almost constant along one axis, where a gain error acts like an offset; the scale then comes from the
    rotation of that force. They add up to 1 for a vehicle that accelerates without tilting."""
    level_floor_offset_m_s2: tuple[float, float, float]
    """Offset if the floor is level: how the accelerometer leans against the floor, whichever of them is off.
    At one heading, an offset and a slope are the same."""
    level_floor_offset_std_m_s2: tuple[float, float, float]
    slope: FloorSlope = UNKNOWN_SLOPE
    slope_without_offset: FloorSlope = UNKNOWN_SLOPE
    """Slope if the accelerometer has no offset across the body's z."""
    sampling_std: float = 0.0
    """Relative standard deviation of the scale by motion that the readings are too slow for: a third of what
    half as many change. The mean over a step loses an error that grows with the square of the step."""
    lag: AccelerometerLag | None = None
    """Delay of the accelerometer behind the gyro, taken out if it is believed; None if not determined."""

    def log_std(self, gain_std: float) -> float:
        """Return the relative standard deviation of the scale; gain errors ``gain_std`` may be correlated."""
        gain_sensitivity = gain_std * float(np.abs(self.gain_slopes).sum())
        noise = np.hypot(self.scale_std / self.scale, self.sampling_std)
        return float(np.hypot(noise, gain_sensitivity))


@dataclass(frozen=True)
class NoScale:
    """The accelerometer does not determine the scale."""

    reason: str
    """Reason, in words."""


_TOO_LITTLE_MOTION = NoScale("the flight hardly accelerates, so that its displacement is lost in the noise")
_INCONSISTENT = NoScale(
    "its readings do not fit the path from the pictures (its signs, unit, T_BS or clock may be wrong)"
)


def inertial_scale(
    stamps_s: Array,
    w_T_c: Array,
    readings: InertialReadings,
    covariance: Array,
    b_p_c_m: Array = np.zeros(3),
) -> InertialScale | NoScale:
    """Estimate the scale of a camera's path (n, 4, 4) over a horizontal floor at z = 0.

    The path has the axes of the body, and its unit is unknown. The camera's place on the body ``b_p_c_m``
    (3,) is told in metres, on which the scale does not act. ``stamps_s`` (n,), sorted, are on the clock of
    the readings.

    ``covariance`` (6, 6), rotation first, right perturbation, is that of the independent error of a pose;
    only its shape matters, its size is estimated. Returns `NoScale` if path and readings overlap too
    little, if the readings are too slow, or if the accelerometer does not determine the scale.
    """
    rate_hz = 1 / float(np.median(np.diff(readings.stamps_s)))
    if rate_hz * _RATE_SLACK < _LEAST_HZ:
        return NoScale(f"it has {rate_hz:.3g} readings a second, and {_LEAST_HZ:g} are needed")
    apart = np.unique(np.floor((stamps_s - stamps_s[:1]) / MIN_SPACING_S), return_index=True)[1]
    stamps_s, w_T_c = stamps_s[apart], w_T_c[apart]
    segments = find_segments(stamps_s, readings.stamps_s)
    if len(segments) < MIN_SEGMENTS:
        return NoScale(
            f"{MIN_SEGMENTS} segments of {SEGMENT_S[0]:g} to {SEGMENT_S[1]:g} s with {MIN_POSES} "
            f"pictures each are needed and {len(segments)} found: fly longer, or with more pictures a second"
        )
    expected = np.concatenate([np.zeros(4), -b_p_c_m, np.zeros(2)])
    noises = regressor_covariance(covariance)
    path = PathAndReadings(stamps_s, w_T_c, readings, segments, noises, expected)
    start = np.log([_FORCE_NOISE, _POSE_NOISE, _RANDOM_WALK_NOISE])
    parameters, noise = _fit(path.rows(), start)
    lag = accelerometer_lag(path, partial(_total_least_squares, noise=noise, start=parameters), noise)
    taken_out_s = lag.lag_s if lag is not None and lag.believed else 0.0
    rows = path.rows(taken_out_s)
    if taken_out_s:
        parameters, noise = _fit(rows, noise)
    found = _result(rows, path.gain_sensitivity(taken_out_s), parameters, noise, lag)
    if isinstance(found, NoScale):
        return found
    halved = _total_least_squares(path.at_half_rate().rows(taken_out_s), noise, parameters)[0]
    return replace(found, sampling_std=float(abs(np.log(max(halved / found.scale, _LEAST_RATIO))) / 3))


def _fit(rows: RegressionRows, noise: Array) -> tuple[Array, Array]:
    """Return parameters (9,) and noise (3,) from initial noise."""
    parameters = _initial_parameters(rows, noise)
    for _ in range(_ROUNDS):
        parameters = _total_least_squares(rows, noise, parameters)
        noise = _maximum_likelihood_noise(rows, parameters, noise)
    return _total_least_squares(rows, noise, parameters), noise


def _initial_parameters(rows: RegressionRows, noise: Array) -> Array:
    """Return initial parameters (9,): the best of many scales."""
    tried = [
        rows.fit_at_scale(scale, noise)
        for scale in np.geomspace(1 / _MAX_SCALE_RATIO, _MAX_SCALE_RATIO, 49).tolist()
    ]
    return min(tried, key=lambda parameters: float(np.sum(rows.whitened(parameters, noise) ** 2)))


def _total_least_squares(rows: RegressionRows, noise: Array, start: Array) -> Array:
    """Estimate scale, offset, arm and slope (9,) by total least squares."""
    from scipy.optimize import least_squares  # a long import, for this alone

    residuals, jacobian = partial(rows.whitened, noise=noise), partial(rows.jacobian, noise=noise)
    return np.asarray(least_squares(residuals, start, jacobian, x_scale="jac").x)


def _maximum_likelihood_noise(rows: RegressionRows, parameters: Array, start: Array) -> Array:
    from scipy.optimize import minimize  # a long import, for this alone

    def cost(noise: Array) -> float:
        return float(np.sum(rows.whitened(parameters, noise) ** 2)) + rows.log_determinant(parameters, noise)

    first = start + np.vstack([np.zeros(3), np.eye(3)])
    found = minimize(
        cost, start, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.1, "initial_simplex": first}
    )
    return np.asarray(found.x)


def _result(
    rows: RegressionRows,
    gain_sensitivity: Array,
    parameters: Array,
    noise: Array,
    lag: AccelerometerLag | None,
) -> InertialScale | NoScale:
    scale, offset, arm = float(parameters[0]), parameters[1:4], parameters[4:7] - rows.expected[4:7]
    residuals, w = rows.residuals(parameters), rows.weight(parameters, noise)
    spread = rows.pose_variance(noise)[:, None, None, None] * rows.regressor_noise
    information = np.einsum("rak,ra,ral->kl", rows.regressors, w, rows.regressors, optimize=True) + PRIOR
    # Pose noise looks like displacement, too; if chance explains all of it, there was too little motion.
    information -= np.einsum("ra,rakl->kl", w, spread)
    chance = float(np.sqrt(2 * np.sum((w * spread[:, :, 0, 0]) ** 2)))
    if information[0, 0] <= _MIN_SIGNIFICANCE * chance or np.linalg.eigvalsh(information)[0] <= 0:
        return _TOO_LITTLE_MOTION
    score = np.einsum("ra,ra,rak->rk", w, residuals, rows.regressors)
    score += np.einsum("ra,rak->rk", (w * residuals) ** 2, spread @ parameters)
    count = int(rows.segment.max()) + 1
    by_segment = np.zeros((count, SIZE))
    np.add.at(by_segment, rows.segment, score)
    inverse = np.linalg.inv(information)
    # Segments may differ by more than the white noise implies: cluster-robust covariance.
    among = by_segment.T @ by_segment * count / (count - 1)
    std = _standard_deviations(inverse, among)
    over_level, over_level_std = _without(_SLOPE, parameters, information, among)
    no_offset, no_offset_std = _without(_ACROSS, parameters, information, among)
    gain_effect = inverse[0] @ np.einsum(
        "rak,ra,rag->kg", rows.regressors, w, gain_sensitivity, optimize=True
    )
    if np.linalg.norm(offset) > _MAX_OFFSET_M_S2:
        return _INCONSISTENT
    if not scale > _MIN_SIGNIFICANCE * std[0]:
        return _TOO_LITTLE_MOTION
    return InertialScale(
        scale=scale,
        scale_std=float(std[0]),
        offset_m_s2=triple(offset),
        offset_std_m_s2=triple(std[1:4]),
        arm_m=triple(arm),
        arm_std_m=triple(std[4:7]),
        gain_slopes=triple(gain_effect / scale),
        level_floor_offset_m_s2=triple(over_level[1:4]),
        level_floor_offset_std_m_s2=triple(over_level_std[1:4]),
        slope=_slope(parameters, std),
        slope_without_offset=_slope(no_offset, no_offset_std),
        lag=lag,
    )


def _without(
    zero: NDArray[np.int64], parameters: Array, information: Array, among: Array
) -> tuple[Array, Array]:
    """Return the parameters (9,) and their standard deviations where those numbered ``zero`` are known to
    be 0."""
    free = np.setdiff1d(np.arange(SIZE), zero)
    within: Array = information[np.ix_(free, free)]
    inverse: Array = np.asarray(np.linalg.inv(within))
    found, std = np.zeros(SIZE), np.zeros(SIZE)
    found[free] = parameters[free] + inverse @ information[np.ix_(free, zero)] @ parameters[zero]
    std[free] = _standard_deviations(inverse, among[np.ix_(free, free)])
    return found, std


def _slope(parameters: Array, std: Array) -> FloorSlope:
    x, y = parameters[_SLOPE].tolist()
    return FloorSlope((x, y), float(std[_SLOPE].max()))


def _standard_deviations(inverse: Array, among: Array) -> Array:
    """Return those by the inverse of the information, or by the scores ``among`` segments if larger."""
    return np.sqrt(np.maximum(np.diag(inverse), np.diag(inverse @ among @ inverse)))
