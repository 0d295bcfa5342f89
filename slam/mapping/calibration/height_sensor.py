"""Gain and zero of the height sensor: what a flight tells of them where it refutes what is stated.

A gain or zero that is stated as exact is held. Where it is wrong, the whole map is too large or too small.
Two heights show a zero, and another instrument that tells lengths shows both. Where the evidence of a wider
prior is very strong (`backend.bundle.range_evidence`), they become free parameters.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from backend.bundle.ground_below import LEAST_RANGES
from backend.bundle.problem import ScalePrior
from backend.bundle.range_evidence import RangeEvidence, RangePrior, range_evidence
from backend.significance import STRONG_NATS, VERY_STRONG_NATS
from backend.sparse_cholesky import SingularMatrixError
from slam.core.flight import Flight
from slam.core.streams import Sonar
from slam.mapping.calibration.antenna import FARTHEST
from slam.mapping.map import Map

_NOMINAL = RangePrior(Sonar.scale_std, Sonar.datum_std_m)
_UNMEASURED_ZERO_STD_M = 0.1
"""Standard deviation of the zero of a sensor whose place on the vehicle nobody has measured. Vehicles that
carry a camera are up to 0.6 m high, and the sensor is on them: three deviations are half of that."""


def range_prior(flight: Flight) -> RangePrior | None:
    """Return how well gain and zero of the height sensor are known; None without one."""
    return None if flight.sonar is None else RangePrior(flight.sonar.scale_std, flight.sonar.datum_std_m)


def with_range_prior(flight: Flight, prior: RangePrior | None) -> Flight:
    """Return the flight with gain and zero of its height sensor known as well as ``prior`` says."""
    if flight.sonar is None or prior is None:
        return flight
    sonar = replace(flight.sonar, scale_std=prior.gain_std, datum_std_m=prior.zero_std_m)
    return replace(flight, sonar=sonar)


def suspected_ranges(stated: RangePrior | None, map_: Map) -> RangePrior | None:
    """Return the widest prior that a map may need in the place of the ``stated`` one; None if it needs none.

    The evidence is extrapolated from the map with the stated one.
    """
    found = None if stated is None else _evidence(stated, map_)
    if stated is None or found is None or _best(found, stated) is None:
        return None
    return _widest(stated)


def ranges_by_evidence(stated: RangePrior, trial: Map) -> RangePrior | None:
    """Return the prior that the evidence of a ``trial`` prefers to the ``stated`` one; None where it is not
    very strong. The trial has the widest prior.

    An estimate that no sensor has is another instrument's error, such as an accelerometer in another unit.
    """
    found = _evidence(stated, trial)
    best = None if found is None else _best(found, stated)
    if found is None or best is None:
        return None
    if found.log_evidence(best) - found.log_evidence(stated) <= VERY_STRONG_NATS:
        return None
    off, _ = found.errors(best)
    is_plausible = (np.abs(off) <= FARTHEST * found.prior_std(best)).all()
    return best if is_plausible else None


def _evidence(stated: RangePrior, map_: Map) -> RangeEvidence | None:
    """Return what a map tells of gain and zero; None where it tells nothing, or no prior is wider."""
    if map_.bundle is None or stated == (widest := _widest(stated)):
        return None
    optimum = map_.bundle.optimum
    if len(optimum.problem.measurements.ranges) < LEAST_RANGES:
        return None
    try:
        return range_evidence(optimum, stated, widest, _other_lengths(map_))
    except SingularMatrixError:
        return None


def _other_lengths(map_: Map) -> ScalePrior | None:
    """Return lengths by the accelerometer, where the map was compared with them and does not use them."""
    if map_.inertial is None or map_.bundle is None:
        return None
    problem = map_.bundle.optimum.problem
    is_used = problem.scale_prior is not None or problem.inertial is not None
    return None if is_used else map_.inertial.lengths


def _widest(stated: RangePrior) -> RangePrior:
    return RangePrior(max(_gain_stds(stated)), max(_zero_stds(stated)))


def _gain_stds(stated: RangePrior) -> tuple[float, ...]:
    """Return the deviations of the gain that are tried, the stated one first."""
    wider = (_NOMINAL.gain_std,) if stated.gain_std < _NOMINAL.gain_std else ()
    return stated.gain_std, *wider


def _zero_stds(stated: RangePrior) -> tuple[float, ...]:
    """Return those of the zero."""
    wider = (_NOMINAL.zero_std_m, _UNMEASURED_ZERO_STD_M) if stated.zero_std_m < _NOMINAL.zero_std_m else ()
    return stated.zero_std_m, *wider


def _best(found: RangeEvidence, stated: RangePrior) -> RangePrior | None:
    """Return the prior with the most evidence; None if that of the stated one is hardly weaker.

    Both are free where gain alone and zero alone explain the flight about as well, since either may be wrong.
    Both are free as well where neither alone explains it.
    """
    gains, zeros = _gain_stds(stated), _zero_stds(stated)
    evidence = {
        (gain, zero): found.log_evidence(RangePrior(gain, zero)) for gain, zero in product(gains, zeros)
    }
    most = max(evidence.values())
    if most <= evidence[gains[0], zeros[0]] + STRONG_NATS:
        return None
    by_gain, by_zero = (
        max((evidence[one] for one in alone), default=-np.inf) > most - STRONG_NATS
        for alone in (
            [(gain, zeros[0]) for gain in gains[1:]],
            [(gains[0], zero) for zero in zeros[1:]],
        )
    )
    both = by_gain == by_zero
    gains = gains[1:] if (by_gain or both) and len(gains) > 1 else gains[:1]
    zeros = zeros[1:] if (by_zero or both) and len(zeros) > 1 else zeros[:1]
    return RangePrior(*max(product(gains, zeros), key=evidence.__getitem__))
