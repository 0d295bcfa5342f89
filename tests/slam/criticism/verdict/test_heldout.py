"""Held-out gains: no reading counts on one side alone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from slam.criticism.kalman.filter import IGNORED, USED
from slam.criticism.kalman.innovations import Pass
from slam.criticism.verdict.heldout import _of_the_same_readings


@dataclass
class Sums:
    log_likelihood: np.ndarray
    flight: np.ndarray
    readings: tuple
    passes: tuple


@dataclass
class Look:
    sums: Sums


def look(run, pieces, shown=0.0):
    """A look at one flight whose stretches are its events in equal parts, pictures last."""
    bounds = np.linspace(0, len(run.status), pieces + 1).astype(int)
    nats = [run.nats[a:b].sum() for a, b in pairwise(bounds)]
    return Look(Sums(np.array([*nats, shown]), np.zeros(pieces + 1, dtype=int), (pieces,), (run,)))


def test_a_reading_that_one_belief_leaves_out_counts_in_neither():
    rng = np.random.default_rng(0)
    white, log_variance = rng.normal(size=(60, 6)), rng.normal(-5.0, 1.0, (60, 6))
    status = np.full((60, 6), USED)
    fewer = status.copy()
    fewer[10:20, 3:] = IGNORED
    missing = np.where(fewer == USED, white, np.nan), np.where(fewer == USED, log_variance, np.nan)
    states = np.zeros((60, 11))
    whole, part = Pass(white, log_variance, status, states), Pass(*missing, fewer, states)
    one, other = _of_the_same_readings(look(whole, 3, 7.0), look(part, 3, 5.0))
    np.testing.assert_allclose(one[:3], other[:3])
    assert (one[3], other[3]) == (7.0, 5.0)
