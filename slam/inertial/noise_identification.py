"""Identification of noise, delays and AR(1) errors of the instruments by maximum likelihood.

The filter runs with each candidate over the two minutes with most motion. Its score is the likelihood of its
innovations in motion: attitude, range, velocity, position, barometer and visual steps; for a delay, of all
readings. A modelled error that is absent lowers the likelihood, so the simplest sufficient model wins.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from backend.ekf.inputs import READINGS, Readings, VisualStep, renumber_steps
from backend.quantiles import chi_square_quantile
from backend.significance import STRONG_NATS
from slam.core.progress import Progress, silent
from slam.inertial.calibrated_gain import calibrated_gain
from slam.inertial.filter_input import Adjustments, FilterInput, filter_input
from slam.inertial.instruments import InertialTrust
from slam.inertial.start_heading import find_start_heading
from slam.inertial.start_height import find_picture_start
from slam.inertial.zero_velocity import RestWindows

if TYPE_CHECKING:
    from backend.ekf.results import InstrumentInnovations, Track
    from slam.core.flight import Flight

Array = NDArray[np.float64]

MAX_DURATION_S = 120.0
_TINY = 1e-9
_PREDICTED = ("attitude", "range", "velocity", "position", "barometer")
_SCORED = (*_PREDICTED, "pictures")
_DELAYED = ("attitude", "range", "velocity", "position")
_DELAYS_S = (0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4)
_ROUNDING_S = 1e-6
"""More than a stamp changes by rounding when a delay is taken out and added again: seconds since 1970 have
steps of 2.4e-7 s."""
_PART_S = 1.0
"""Length of the parts of a flight whose scatter calibrates the gain of a delay. In 150 simulated flights,
parts of 0.5 s and of 2 s show the same scatter within 20 %. For delays of 0.1 s and more of the attitude and
the velocity it differs by 35 to 70 %."""
_GIVE_UP = 2
"""Number of successive candidates without gain after which the search stops; one may be chance."""
_QUANTILES = (0.5, 0.9)
_ROUNDS, _MIN_EXCESS = 5, 1.15
_WINDOWS_S = (0.0, 0.2, 0.5, 1.0)
"""Windows over which innovations are summed. An AR(1) error is small against white noise in one reading, but
does not average out."""
_WINDOW_ROUNDS = 2
"""Number of rounds. With an erroneous prediction, more of them inflate the noise of good readings without
bound: by 27 in five rounds, after which a correct velocity has no weight."""
_LEAST_SUMS = 10
_INERTIAL = ("gyro", "accelerometer")
_NOISE_FACTORS = (2.0, 4.0, 8.0, 16.0, 32.0)
"""Candidate factors on the noise at rest, because of vibration and inexact scales and lever arms."""
_NO_STAMPS = np.zeros(0)

IDEAL: dict[str, dict[str, float]] = {
    "gyro and accelerometer": {
        "gyro_offset_rad_s": _TINY,
        "gyro_walk_rad_s2": 0.0,
        "accel_offset_m_s2": _TINY,
        "accel_walk_m_s3": 0.0,
    },
    "attitude": {"tilt_error_rad": 0.0, "yaw_walk_rad": 0.0},
    "velocity": {"velocity_error_m_s": 0.0},
}
"""Instrument -> its parameters without biases and AR(1) errors. Scales are absent, because the likelihood
does not determine them."""


def identify_noise(
    flight: Flight,
    trust: InertialTrust = InertialTrust(),
    progress: Progress = silent,
    stamps_s: Array = _NO_STAMPS,
    steps: tuple[VisualStep, ...] = (),
) -> FilterInput:
    """Return the filter's input for a flight, with noise identified on the two minutes with most motion.

    ``steps`` between pictures at ``stamps_s`` (n,) count in the likelihood too. Raises ``InputError``.

    White noise is inflated until innovations are consistent (NIS). Delays are increased while the likelihood
    increases, and kept if the gain is significant. The noise is then inflated again from its nominal value.
    Without a range the height at the first picture is found before all else, and without a yaw the heading.
    Both hold at the start of the flight, and the two minutes then begin there.
    Sums of innovations that are still too large show an error that is correlated in time. It belongs to the
    instrument, or to gyro and accelerometer, which predict its readings. Each is inflated as if it were the
    only cause. Finally, an instrument with a credible nominal noise loses its AR(1) errors if that increases
    the likelihood; time at rest cannot show that.
    """
    first = Adjustments(
        start=find_picture_start(flight, trust, stamps_s, steps, MAX_DURATION_S),
        heading=find_start_heading(flight, trust, MAX_DURATION_S),
    )
    trial = _Trial(flight, progress, stamps_s, steps, first.start is None and first.heading is None)
    found = _inflated(trial, trust, first)
    for name in _DELAYED:
        found = _with_delay(trial, trust, found, name)
    found = _inflated(trial, trust, replace(found, noise_factor={}))
    correlated = _inflated_over(trial, trust, found, _WINDOWS_S, _WINDOW_ROUNDS, trial.spread)
    for name in _INERTIAL:
        found = _with_noise(trial, trust, found, name)
    found = replace(found, noise_factor={**found.noise_factor, **correlated.noise_factor})
    best = trial.likelihood(trust, found)
    candidates = _ideal_candidates(flight, trust) if trial.rest.any_motion else []
    for parameters in candidates:
        ideal = replace(trust, **parameters)
        likelihood = trial.likelihood(ideal, found)
        if likelihood > best + STRONG_NATS:
            trust, best = ideal, likelihood
    return filter_input(flight, trust, found)


def _with_delay(trial: _Trial, trust: InertialTrust, found: Adjustments, name: str) -> Adjustments:
    """Return ``found`` with the most likely delay of one channel, if its gain is significant."""
    if getattr(trial.nominal, READINGS[name]) is None:
        return found

    def delayed(delay_s: float) -> Adjustments:
        return replace(found, delay_s={**found.delay_s, name: delay_s})

    delays_s = (0.0, *_DELAYS_S)
    parts = _tried(lambda delay_s: trial.likelihoods_at_any_delay(trust, delayed(delay_s)), delays_s)
    if calibrated_gain(np.array(delays_s[: len(parts)]), parts) <= STRONG_NATS:
        return found
    return delayed(delays_s[int(np.argmax(parts.sum(axis=1)))])


def _with_noise(trial: _Trial, trust: InertialTrust, found: Adjustments, name: str) -> Adjustments:
    """Return ``found`` with the most likely noise of one channel, if its gain is significant."""
    if getattr(trial.nominal, READINGS[name]) is None:
        return found

    def noisier(factor: float) -> Adjustments:
        return replace(found, noise_factor={**found.noise_factor, name: factor})

    factors = (1.0, *_NOISE_FACTORS)
    likelihoods = _tried(lambda factor: np.array([trial.likelihood(trust, noisier(factor))]), factors)[:, 0]
    best = int(np.argmax(likelihoods))
    return noisier(factors[best]) if likelihoods[best] - likelihoods[0] > STRONG_NATS else found


def _tried(likelihoods_of: Callable[[float], Array], candidates: tuple[float, ...]) -> Array:
    """Return the likelihoods (n, p) of the first n candidates, until ``_GIVE_UP`` in a row gain nothing."""
    tried = [likelihoods_of(candidates[0])]
    most, worse = float(tried[0].sum()), 0
    for candidate in candidates[1:]:
        tried.append(likelihoods_of(candidate))
        worse = 0 if tried[-1].sum() > most else worse + 1
        most = max(most, float(tried[-1].sum()))
        if worse == _GIVE_UP:
            break
    return np.array(tried)


def _ideal_candidates(flight: Flight, trust: InertialTrust) -> list[dict[str, float]]:
    """Return ideal parameters of the instruments whose nominal noise is at least the floor for their kind."""
    attitude, velocity = flight.attitude, flight.velocity
    claims = {
        "gyro and accelerometer": True,
        "attitude": attitude is not None and min(attitude.noise_std_rad) >= trust.attitude_floor_rad,
        "velocity": velocity is not None and min(velocity.noise_std_m_s) >= trust.velocity_floor_m_s,
    }
    return [IDEAL[name] for name, credible in claims.items() if credible]


class _Trial:
    """Runs of the filter over a part of one flight, with candidate parameters.

    ``starts_anywhere``: whether the part may begin where the vehicle moves most, not only at the start.
    """

    def __init__(
        self,
        flight: Flight,
        progress: Progress,
        stamps_s: Array,
        steps: tuple[VisualStep, ...],
        starts_anywhere: bool,
    ) -> None:
        self.flight, self.progress, self.done = flight, progress, 0
        self.stamps_s, self.steps, self.rest = stamps_s, steps, RestWindows.of(flight)
        whole = filter_input(flight)
        self.nominal: Readings = whole.readings
        self.from_s = -np.inf
        if starts_anywhere:
            self.from_s = self.rest.liveliest_start_s(whole.start_s, MAX_DURATION_S)

    def inputs(self, trust: InertialTrust, adjustments: Adjustments) -> FilterInput:
        return filter_input(self.flight, trust, adjustments, self.from_s)

    def run(self, inputs: FilterInput) -> Track:
        from backend.ekf.track import track

        start_s, until_s = _limits_s(inputs)
        inside = (self.stamps_s >= start_s) & (self.stamps_s < until_s)
        steps = renumber_steps(self.steps, inside)
        readings = replace(inputs.readings.between(start_s, until_s), steps=steps)
        self.done += 1
        self.progress("instruments", self.done, 0)
        return track(
            readings, np.append(self.stamps_s[inside], until_s), inputs.start, inputs.model, rounds=0
        )

    def spread(self, name: str) -> float:
        """Return the standard deviation of a channel's readings over their noise, an upper limit of any
        error."""
        series = getattr(self.nominal, READINGS[name])
        return float(np.nanmax(np.nanstd(series.values, axis=0) / series.std))

    def excess(self, channel: InstrumentInnovations, over_s: tuple[float, ...]) -> float:
        """Return the factor by which summed innovations in motion exceed their standard deviation, at the
        worst window.

        It is computed from quantiles, so that the largest tenth does not count.
        """
        moves = self.rest.moves_at(channel.stamps_s)
        return max(_excess_of(_sums(channel, moves, window_s)) for window_s in over_s)

    def likelihood(self, trust: InertialTrust, adjustments: Adjustments) -> float:
        channels = self.run(self.inputs(trust, adjustments)).channels
        return sum(
            float(channel.log_likelihoods[self.rest.moves_at(channel.stamps_s)].sum())
            for name, channel in channels.items()
            if name in _SCORED
        )

    def likelihoods_at_any_delay(self, trust: InertialTrust, adjustments: Adjustments) -> Array:
        """Return the likelihoods (p,) of parts of the flight, of readings that no delay moves out of the
        filter's time.

        Otherwise a delay would gain or lose likelihood only because it leaves readings out. Those of gyro and
        accelerometer count too: a delay puts readings in another order, in which a part of the same evidence
        passes from one instrument to the other. Without them, that alone changed the sum by up to 13 nats.
        """
        inputs = self.inputs(trust, adjustments)
        start_s, until_s = _limits_s(inputs)
        first_s, last_s = start_s + max(_DELAYS_S) + _ROUNDING_S, until_s - _ROUNDING_S
        total = np.zeros(max(1, int(np.ceil((last_s - first_s) / _PART_S))))
        for name, channel in self.run(inputs).channels.items():
            read_s = channel.stamps_s + adjustments.delay_s.get(name, 0.0)
            kept = self.rest.moves_at(read_s) & (read_s > first_s) & (read_s < last_s)
            part = ((read_s[kept] - first_s) / _PART_S).astype(np.int64)
            np.add.at(total, part, channel.log_likelihoods[kept])
        return total


def _limits_s(inputs: FilterInput) -> tuple[float, float]:
    """Return start and end of the time over which candidates are compared."""
    return inputs.start_s, min(inputs.end_s, inputs.start_s + MAX_DURATION_S)


def _inflated(trial: _Trial, trust: InertialTrust, adjustments: Adjustments) -> Adjustments:
    """Inflate white noise until single innovations are consistent."""
    return _inflated_over(trial, trust, adjustments, (0.0,), _ROUNDS, lambda _: np.inf)


def _inflated_over(
    trial: _Trial,
    trust: InertialTrust,
    adjustments: Adjustments,
    over_s: tuple[float, ...],
    rounds: int,
    most: Callable[[str], float],
) -> Adjustments:
    """Inflate white noise until innovations, summed over windows of each length ``over_s``, are consistent.

    The factor of a channel is at most ``most``, unless it was larger before.
    """
    noise_factor = dict(adjustments.noise_factor)
    for _ in range(rounds):
        inputs = trial.inputs(trust, replace(adjustments, noise_factor=noise_factor))
        channels = trial.run(inputs).channels
        before = dict(noise_factor)
        for name in _PREDICTED:
            if name in channels and (excess := trial.excess(channels[name], over_s)) > _MIN_EXCESS:
                now = noise_factor.get(name, 1.0)
                noise_factor[name] = max(now, min(now * excess, most(name)))
        if noise_factor == before:
            break
    return replace(adjustments, noise_factor=noise_factor)


def _sums(channel: InstrumentInnovations, counts: NDArray[np.bool_], window_s: float) -> Array:
    """Return sums (n,) of the whitened innovations of each component over windows of ``window_s``.

    They are divided by the root of their number. White innovations give unit variance. Only readings that
    ``counts`` (m,) marks are summed.
    """
    known = np.isfinite(channel.innovation) & counts[:, None]
    white = np.where(known, channel.innovation / channel.std, 0.0)
    if window_s == 0.0:
        return np.asarray(white[known])
    block = np.floor((channel.stamps_s - channel.stamps_s[0]) / window_s).astype(np.int64)
    total, count = np.zeros((2, int(block[-1]) + 1, white.shape[1]))
    np.add.at(total, block, white)
    np.add.at(count, block, known)
    return np.asarray(total[count > 0] / np.sqrt(count[count > 0]))


def _excess_of(white: Array) -> float:
    if len(white) < _LEAST_SUMS:
        return 1.0
    expected = [chi_square_quantile(probability, 1) for probability in _QUANTILES]
    return float(np.sqrt(np.max(np.quantile(white**2, _QUANTILES) / expected)))
