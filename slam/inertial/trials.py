"""Which instruments would make a flight's readings likely: noise, delays and lasting errors, tried on its
start.

A filter is run with each candidate. What speaks is how well the readings of attitude, range, velocity,
position and barometer, and steps seen in pictures, were foreseen, each from those before it: the likelihood
of the innovations. An error that is allowed and does not show costs likelihood, so that the plainest
instrument that explains the readings is found.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from backend.ekf.inputs import PictureStep, Readings, renumbered
from slam.inertial.filter_input import FIELDS, Adjusted, FilterInput, filter_input
from slam.inertial.instruments import InertialTrust
from slam.progress import Progress, silent

if TYPE_CHECKING:
    from backend.ekf.results import Track
    from slam.flight import Flight

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
"""For each instrument, what trust is in one without any error that lasts. Scales are not among it: likelihood
does not tell them."""


def suited(
    flight: Flight,
    trust: InertialTrust = InertialTrust(),
    progress: Progress = silent,
    stamps_s: Array = _NO_STAMPS,
    steps: tuple[PictureStep, ...] = (),
) -> FilterInput:
    """What the filter is given of a flight, after trials on its first two minutes; ``steps`` between pictures
    at ``stamps_s`` (n,) speak too.

    White noise is widened until innovations are as large as they should be; delays grow as long as that
    makes the readings more likely, and count if clearly; noise is widened anew; and each instrument whose
    maker names a credible noise, and which is more likely without lasting errors, is taken as made.
    Raises ``InputError``.
    """
    trial = _Trial(flight, progress, stamps_s, steps)
    found = _widened(trial, trust, Adjusted())
    best = trial.likelihood(trust, found)
    for name in _DELAYED:
        if getattr(trial.held, FIELDS[name]) is None:
            continue
        later, gained, worse = found, 0.0, 0
        for delay_s in _DELAYS_S:
            candidate = replace(found, delay_s={**found.delay_s, name: delay_s})
            likelihood = trial.likelihood(trust, candidate)
            if likelihood - best > gained:
                later, gained, worse = candidate, likelihood - best, 0
            elif (worse := worse + 1) == _GIVE_UP:
                break
        if gained > CLEARLY:
            found, best = later, best + gained
    found = _widened(trial, trust, Adjusted(delay_s=found.delay_s))
    best = trial.likelihood(trust, found)
    for figures in _credible(flight, trust):
        plain = replace(trust, **figures)
        likelihood = trial.likelihood(plain, found)
        if likelihood > best + CLEARLY:
            trust, best = plain, likelihood
    return filter_input(flight, trust, found)


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
        self, flight: Flight, progress: Progress, stamps_s: Array, steps: tuple[PictureStep, ...]
    ) -> None:
        self.flight, self.progress, self.done = flight, progress, 0
        self.stamps_s, self.steps = stamps_s, steps
        self.held: Readings = filter_input(flight).readings

    def run(self, trust: InertialTrust, adjusted: Adjusted) -> Track:
        from backend.ekf.track import track

        given = filter_input(self.flight, trust, adjusted)
        until_s = min(given.end_s, given.start_s + LONGEST_TRIAL_S)
        inside = (self.stamps_s >= given.start_s) & (self.stamps_s < until_s)
        steps = renumbered(self.steps, inside)
        readings = replace(given.readings.between(given.start_s, until_s), steps=steps)
        self.done += 1
        self.progress("instruments", self.done, 0)
        return track(readings, np.append(self.stamps_s[inside], until_s), given.start, given.model, rounds=0)

    def likelihood(self, trust: InertialTrust, adjusted: Adjusted) -> float:
        channels = self.run(trust, adjusted).channels
        return sum(channels[name].log_likelihood for name in _SPEAKING if name in channels)


def _widened(trial: _Trial, trust: InertialTrust, adjusted: Adjusted) -> Adjusted:
    wider: dict[str, float] = {}
    for _ in range(_ROUNDS):
        channels = trial.run(trust, replace(adjusted, wider=wider)).channels
        excess = {name: _excess(channels[name].nis) for name in _FORESEEN if name in channels}
        narrow = {name: factor for name, factor in excess.items() if factor > _WIDEN_FROM}
        if not narrow:
            break
        wider = {**wider, **{name: wider.get(name, 1.0) * factor for name, factor in narrow.items()}}
    return replace(adjusted, wider=wider)


def _excess(nis: Array) -> float:
    """How much larger than expected innovations are, the largest tenth left out."""
    known = nis[np.isfinite(nis)]
    if len(known) == 0:
        return 1.0
    return float(np.sqrt(np.max(np.quantile(known, _QUANTILES) / chi2.ppf(_QUANTILES, 1))))
