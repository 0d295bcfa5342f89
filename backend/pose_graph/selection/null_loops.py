"""Probability that a false loop agrees by chance, measured on loops that are false by construction.

A loop that is uniform over the map's volume agrees with a prediction in proportion to the volume of the
prediction's ellipsoid. Real false loops are not uniform: poses lie on a surface, in corridors, at four
headings, and false loops report distances as short as true ones. On sphere2500 they agree a hundred times as
often. Null loops show how often: each has one loop's first end, another's second end and a third one's
measurement. Source: target and decoy of Elias and Gygi 2007 (Nature Methods).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.chi_square import chi_square_gate
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.prediction import (
    log_prior_volume,
    log_volume,
    squared_mahalanobis,
    whitened_covariance,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

_NULL_LOOP_COUNT = 5000
_BINS = np.linspace(-40.0, 0.0, 81)
_GRID = np.meshgrid(
    (0.0, 3e-4, 1e-3), np.arange(0.0, 8.1), np.arange(1.0, 0.05, -0.1), _BINS[:-1] + 0.25, indexing="ij"
)
"""Grid of: share of null loops that are true by accident; offset; slope; log probability if uniform."""


@dataclass(frozen=True)
class PassProbability:
    """Log probability that a false loop passes the gate: linear in that of a loop uniform over the map."""

    offset: float
    slope: float

    def of(self, log_pass_probability: Array) -> Array:
        """Return (k,) log probabilities, never below those of a loop uniform over the map."""
        return np.minimum(
            np.maximum(log_pass_probability, self.offset + self.slope * log_pass_probability), 0.0
        )


@dataclass(frozen=True)
class NullLoops:
    """Loops that are false by construction."""

    problem: Problem
    """Problem whose edges are the null loops."""

    @staticmethod
    def of(problem: Problem, loops: Index, place: Index) -> NullLoops:
        """Draw null loops from some loops; ``place`` (k,) labels the two places of each."""
        return NullLoops(_draw_null_loops(problem, loops, place))

    def chance(self, w_T: Array, samples: Array, scale: float) -> PassProbability:
        """Estimate how often they agree with a solution and its posterior samples."""
        problem, gate = self.problem, chi_square_gate(self.problem.dof)
        # The noise of the accepted edges is scaled too, and with it the spread of the prediction.
        covariance = np.eye(problem.dof) + whitened_covariance(problem, w_T, samples)
        agrees = squared_mahalanobis(problem.residuals(w_T) / scale, covariance) <= gate
        volume = log_prior_volume(problem, w_T) - problem.dof * np.log(scale)
        return estimate_pass_probability(log_volume(covariance, gate) - volume, np.asarray(agrees))


def _draw_null_loops(problem: Problem, loops: Index, place: Index) -> Problem:
    # A fixed seed: the result must not depend on the call.
    rng = np.random.default_rng(0)
    times = min(max(1, _NULL_LOOP_COUNT // max(len(loops), 1)), len(loops))
    first = np.tile(np.arange(len(loops)), times)
    second, measured = (
        np.concatenate([first[:0], *(rng.permutation(len(loops)) for _ in range(times))]) for _ in range(2)
    )
    i, j = problem.i[loops[first]], problem.j[loops[second]]
    wrong = (place[first] != place[second]) & (np.abs(i - j) > 1)
    source = loops[measured[wrong]]
    return replace(
        problem,
        i=i[wrong],
        j=j[wrong],
        ij_T=problem.ij_T[source],
        sqrt_information=problem.sqrt_information[source],
        trusted=np.zeros(int(wrong.sum()), dtype=bool),
    )


def estimate_pass_probability(log_pass_probability: Array, agrees: Mask) -> PassProbability:
    """Fit a line by maximum likelihood; a share of the null loops may be true by accident.

    ``log_pass_probability`` (k,) is that of loops uniform over the map, and ``agrees`` (k,) which null loops
    pass the gate.
    """
    if len(agrees) == 0:
        return PassProbability(0.0, 1.0)
    bin_ = np.clip(np.digitize(log_pass_probability, _BINS) - 1, 0, len(_BINS) - 2)
    count = np.bincount(bin_, minlength=len(_BINS) - 1)
    agreeing = np.bincount(bin_, agrees, minlength=len(_BINS) - 1)
    right, offset, slope, middle = _GRID
    chance = right + (1 - right) * np.exp(np.minimum(offset + slope * middle, -1e-3))
    log_odds = np.sum(agreeing * np.log(chance) + (count - agreeing) * np.log1p(-chance), axis=-1)
    best = np.unravel_index(int(np.argmax(log_odds)), log_odds.shape)
    return PassProbability(float(offset[best][0]), float(slope[best][0]))
