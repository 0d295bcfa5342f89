"""Model selection for the instruments: noise, delays and AR(1) errors that make a flight's start most likely.

The filter is run with each candidate, and scored by the likelihood of its innovations: of attitude, range,
velocity, position, barometer and steps seen in pictures. An error that is allowed for but absent lowers the
likelihood, so that the simplest model that explains the readings wins.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from backend.ekf.inputs import Readings, VisualStep, renumber_steps
from slam.core.progress import Progress, silent
from slam.inertial.filter_input import FIELDS, Adjustments, FilterInput, filter_input
from slam.inertial.instruments import InertialTrust

if TYPE_CHECKING:
    from backend.ekf.results import InstrumentInnovations, Track
    from slam.core.flight import Flight

Array = NDArray[np.float64]

LONGEST_TRIAL_S = 120.0
CLEARLY = 3.0
"""Nats by which a candidate must be more likely."""
_TINY = 1e-9
_FORESEEN = ("attitude", "range", "velocity", "position", "barometer")
_SPEAKING = (*_FORESEEN, "pictures")
_DELAYED = ("attitude", "range", "velocity", "position")
_DELAYS_S = (0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4)
_GIVE_UP = 2
"""Delays in a row that are no better: one may be so by chance."""
_QUANTILES = (0.5, 0.9)
_ROUNDS, _WIDEN_FROM = 5, 1.15
_SUMMED_S = (0.0, 0.2, 0.5, 1.0)
"""Windows over which innovations are summed: an AR(1) error is small beside white noise in one reading, but
does not average out."""
_ROUNDS_SUMMED = 2
"""No more rounds: where the prediction is at fault, good readings have their noise inflated without bound (27
times in five rounds, after which a correct velocity has no weight)."""
_LEAST_SUMS = 10
_INERTIAL = ("gyro", "accelerometer")
_NOISIER = (2.0, 4.0, 8.0, 16.0, 32.0)
"""Factors tried on the noise at rest: motors shake the IMU, and its scale and lever arm are not exact."""
_NO_STAMPS = np.zeros(0)

AS_MADE: dict[str, dict[str, float]] = {
    "gyro and accelerometer": {
        "gyro_offset_rad_s": _TINY,
        "gyro_walk_rad_s2": 0.0,
        "accel_offset_m_s2": _TINY,
        "accel_walk_m_s3": 0.0,
    },
    "attitude": {"tilt_error_rad": 0.0, "yaw_walk_rad": 0.0},
    "velocity": {"velocity_error_m_s": 0.0},
}
"""For each instrument, the settings of one without biases and AR(1) errors. Scales are left out: likelihood
does not tell them."""


def identify_noise(
    flight: Flight,
    trust: InertialTrust = InertialTrust(),
    progress: Progress = silent,
    stamps_s: Array = _NO_STAMPS,
    steps: tuple[VisualStep, ...] = (),
) -> FilterInput:
    """The filter's input for a flight, after trials on its first two minutes.

    ``steps`` between pictures at ``stamps_s`` (n,) count in the likelihood too.

    White noise is inflated until innovations are consistent (NIS); delays are raised while that raises the
    likelihood, and kept if clearly; noise is inflated again from the start. Where sums of innovations are
    still too large, some error is correlated in time: the instrument's own, or that of gyro and
    accelerometer, which predict its readings. Each is inflated as if it alone were the cause. Last, an
    instrument whose maker claims a credible noise drops its AR(1) errors where that raises the likelihood.
    Raises ``InputError``.
    """
    trial = _Trial(flight, progress, stamps_s, steps)
    found = _widened(trial, trust, Adjustments())
    for name in _DELAYED:
        found = _climbed(trial, trust, found, name, "delay_s", _DELAYS_S)
    found = _widened(trial, trust, Adjustments(delay_s=found.delay_s))
    lasting = _widened_over(trial, trust, found, _SUMMED_S, _ROUNDS_SUMMED, trial.spread)
    for name in _INERTIAL:
        found = _climbed(trial, trust, found, name, "noise_factor", _NOISIER)
    found = replace(found, noise_factor={**found.noise_factor, **lasting.noise_factor})
    best = trial.likelihood(trust, found)
    for figures in _credible(flight, trust):
        plain = replace(trust, **figures)
        likelihood = trial.likelihood(plain, found)
        if likelihood > best + CLEARLY:
            trust, best = plain, likelihood
    return filter_input(flight, trust, found)


def _climbed(
    trial: _Trial,
    trust: InertialTrust,
    found: Adjustments,
    name: str,
    kind: Literal["delay_s", "noise_factor"],
    ladder: tuple[float, ...],
) -> Adjustments:
    """``found`` with the figure of one channel that makes the readings most likely, if clearly."""
    if getattr(trial.held, FIELDS[name]) is None:
        return found
    before, reached, gained, worse = trial.likelihood(trust, found), found, 0.0, 0
    for figure in ladder:
        candidate = replace(found, **{kind: {**getattr(found, kind), name: figure}})
        likelihood = trial.likelihood(trust, candidate)
        if likelihood - before > gained:
            reached, gained, worse = candidate, likelihood - before, 0
        elif (worse := worse + 1) == _GIVE_UP:
            break
    return reached if gained > CLEARLY else found


def _credible(flight: Flight, trust: InertialTrust) -> list[dict[str, float]]:
    """Figures as made, of instruments whose makers claim no less noise than any such instrument has."""
    attitude, velocity = flight.attitude, flight.velocity
    claims = {
        "gyro and accelerometer": True,
        "attitude": attitude is not None and min(attitude.noise_std_rad) >= trust.attitude_floor_rad,
        "velocity": velocity is not None and min(velocity.noise_std_m_s) >= trust.velocity_floor_m_s,
    }
    return [AS_MADE[name] for name, credible in claims.items() if credible]


class _Trial:
    """Runs of the filter over the start of one flight."""

    def __init__(
        self, flight: Flight, progress: Progress, stamps_s: Array, steps: tuple[VisualStep, ...]
    ) -> None:
        self.flight, self.progress, self.done = flight, progress, 0
        self.stamps_s, self.steps = stamps_s, steps
        self.held: Readings = filter_input(flight).readings

    def run(self, trust: InertialTrust, adjustments: Adjustments) -> Track:
        from backend.ekf.track import track

        inputs = filter_input(self.flight, trust, adjustments)
        until_s = min(inputs.end_s, inputs.start_s + LONGEST_TRIAL_S)
        inside = (self.stamps_s >= inputs.start_s) & (self.stamps_s < until_s)
        steps = renumber_steps(self.steps, inside)
        readings = replace(inputs.readings.between(inputs.start_s, until_s), steps=steps)
        self.done += 1
        self.progress("instruments", self.done, 0)
        return track(
            readings, np.append(self.stamps_s[inside], until_s), inputs.start, inputs.model, rounds=0
        )

    def spread(self, name: str) -> float:
        """All that the readings of a channel vary, in units of their noise: no error of theirs is larger."""
        held = getattr(self.held, FIELDS[name])
        return float(np.nanmax(np.nanstd(held.values, axis=0) / held.std))

    def likelihood(self, trust: InertialTrust, adjustments: Adjustments) -> float:
        channels = self.run(trust, adjustments).channels
        return sum(channels[name].log_likelihood for name in _SPEAKING if name in channels)


def _widened(trial: _Trial, trust: InertialTrust, adjustments: Adjustments) -> Adjustments:
    """White noise inflated until single innovations are consistent."""
    return _widened_over(trial, trust, adjustments, (0.0,), _ROUNDS, lambda _: np.inf)


def _widened_over(
    trial: _Trial,
    trust: InertialTrust,
    adjustments: Adjustments,
    over_s: tuple[float, ...],
    rounds: int,
    most: Callable[[str], float],
) -> Adjustments:
    """White noise inflated until innovations, summed over windows of each length ``over_s``, are consistent.

    At most by the factor ``most`` of a channel, unless it was larger before.
    """
    noise_factor = dict(adjustments.noise_factor)
    for _ in range(rounds):
        channels = trial.run(trust, replace(adjustments, noise_factor=noise_factor)).channels
        before = dict(noise_factor)
        for name in _FORESEEN:
            if name in channels and (excess := _excess(channels[name], over_s)) > _WIDEN_FROM:
                now = noise_factor.get(name, 1.0)
                noise_factor[name] = max(now, min(now * excess, most(name)))
        if noise_factor == before:
            break
    return replace(adjustments, noise_factor=noise_factor)


def _excess(channel: InstrumentInnovations, over_s: tuple[float, ...]) -> float:
    """Factor by which summed innovations exceed their standard deviation, over the worst window length; by
    quantiles, so that the largest tenth does not count."""
    return max(_excess_of(_sums(channel, lasting_s)) for lasting_s in over_s)


def _sums(channel: InstrumentInnovations, lasting_s: float) -> Array:
    """(n,) sums of the whitened innovations of each component over windows of ``lasting_s``, divided by the
    root of their number: of unit variance where innovations are white."""
    known = np.isfinite(channel.innovation)
    white = np.where(known, channel.innovation / channel.std, 0.0)
    if lasting_s == 0.0:
        return np.asarray(white[known])
    block = np.floor((channel.stamps_s - channel.stamps_s[0]) / lasting_s).astype(np.int64)
    total, count = np.zeros((2, int(block[-1]) + 1, white.shape[1]))
    np.add.at(total, block, white)
    np.add.at(count, block, known)
    return np.asarray(total[count > 0] / np.sqrt(count[count > 0]))


def _excess_of(white: Array) -> float:
    if len(white) < _LEAST_SUMS:
        return 1.0
    return float(np.sqrt(np.max(np.quantile(white**2, _QUANTILES) / chi2.ppf(_QUANTILES, 1))))
