"""Gain of likelihood by one more parameter, on made scores."""

from __future__ import annotations

import numpy as np
import pytest

from backend.significance import STRONG_NATS
from slam.inertial.calibrated_gain import calibrated_gain

DELAYS_S = np.array([0.0, 0.02, 0.04, 0.07, 0.1, 0.15])
STD_S = 0.03


def profile(rng: np.random.Generator, true_s: float, scatter: float, weights: np.ndarray) -> np.ndarray:
    """Log likelihoods of parts with a parabola each; their scores scatter ``scatter`` times as far as their
    curvatures say. A part's share of all information is its weight."""
    curvature = weights / weights.sum() / STD_S**2
    score = curvature * true_s + scatter * np.sqrt(curvature) * rng.normal(size=len(weights))
    return np.asarray(DELAYS_S[:, None] * score - DELAYS_S[:, None] ** 2 / 2 * curvature)


def shares_beyond(scatter: float) -> tuple[float, float]:
    """Return how often chance gains more than strong evidence, calibrated and as the likelihood says."""
    rng = np.random.default_rng(0)
    flights = [profile(rng, 0.0, scatter, rng.uniform(0.5, 1.5, 20)) for _ in range(1000)]
    calibrated = np.mean([calibrated_gain(DELAYS_S, flight) > STRONG_NATS for flight in flights])
    stated = np.mean([flight.sum(axis=1).max() > STRONG_NATS for flight in flights])
    return float(calibrated), float(stated)


@pytest.mark.parametrize("scatter", [0.7, 1.0, 2.0])
def test_chance_gains_strong_evidence_seldom_whatever_the_noise(scatter: float) -> None:
    """Beyond 3 nats lies half of 1.4 % where the noise is right, as only delays above zero are tried."""
    assert shares_beyond(scatter)[0] < 0.014


def test_a_noise_that_is_twice_as_large_as_stated_feigns_evidence() -> None:
    assert shares_beyond(2.0)[1] > 0.08


@pytest.mark.parametrize("told_by", [1, 20])
def test_a_delay_counts_that_few_parts_of_the_flight_tell(told_by: int) -> None:
    weights = np.append(np.ones(told_by), np.full(20, 1e-3))
    assert calibrated_gain(DELAYS_S, profile(np.random.default_rng(1), 0.1, 1.0, weights)) > STRONG_NATS


def test_parts_without_readings_do_not_count() -> None:
    flight = profile(np.random.default_rng(2), 0.1, 1.0, np.ones(20))
    with_rest = np.hstack([flight, np.zeros((len(DELAYS_S), 50))])
    assert calibrated_gain(DELAYS_S, with_rest) == calibrated_gain(DELAYS_S, flight) > 0


def test_one_part_shows_no_scatter_and_nothing_gains_by_no_delay() -> None:
    assert calibrated_gain(DELAYS_S, np.arange(6.0)[:, None]) == 0.0
    assert calibrated_gain(DELAYS_S, -np.arange(1.0, 7.0)[:, None] * np.ones(20)) == 0.0
