"""Prediction of edges from other edges: innovations, covariances, and volumes of their gates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.special import gammaln

from backend import se3
from backend.pose_graph.chi_square import SIGNIFICANCE, chi_square_gate
from backend.pose_graph.linear import cholesky, elimination_order, jacobian
from backend.pose_graph.problem import Problem
from backend.quantiles import chi_square_quantile

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

_EM_ITERATIONS = 50
_MIN_SCALE = 1e-3
"""Smallest factor on the stated standard deviations: smaller residuals are rounding errors, not noise."""
_SAMPLE_COUNTS = {3: 60, 6: 150}


@dataclass(frozen=True)
class LoopInnovations:
    """Innovations of edges: measured minus predicted by the rest, whitened by the edges' own noise."""

    edges: Index
    residual: Array
    """(k, d)."""
    spread: Array
    """(k, d, s) whitened samples of the prediction error."""
    log_prior_volume: Array
    """(k,) logarithm of the whitened volume in which a false loop may lie."""

    @cached_property
    def covariance(self) -> Array:
        """(k, d, d) covariance of edge and prediction together."""
        d = self.residual.shape[1]
        return np.asarray(np.eye(d) + self.spread @ np.swapaxes(self.spread, 1, 2) / self.spread.shape[2])

    def sigma(self) -> Array:
        """Return (k,) Mahalanobis norms of the innovations."""
        return np.sqrt(squared_mahalanobis(self.residual, self.covariance))

    def agrees(self) -> Mask:
        """Return (k,) which innovations pass the chi-square gate: a true loop fails once in a thousand."""
        return np.asarray(self.sigma() ** 2 <= chi_square_gate(self.residual.shape[1]))

    def conditioned_on(self, one: int) -> tuple[Array, Array]:
        """Return innovations (k, d) and covariances (k, d, d), conditioned on edge number ``one``."""
        covariance = self.covariance
        cross = self.spread @ self.spread[one].T / self.spread.shape[2]
        k, d, _ = cross.shape  # the columns of all edges in one system
        gain = solve_covariance(covariance[one], cross.reshape(k * d, d).T).T.reshape(k, d, d)
        return self.residual - gain @ self.residual[one], covariance - gain @ np.swapaxes(cross, 1, 2)

    def subset(self, which: Index) -> LoopInnovations:
        """Return some of the innovations, by index."""
        return LoopInnovations(
            self.edges[which], self.residual[which], self.spread[which], self.log_prior_volume[which]
        )

    def log_pass_probability(self) -> Array:
        """Return (k,) log probabilities that a false loop, uniform over the map, passes the gate."""
        return log_volume(self.covariance, chi_square_gate(self.residual.shape[1])) - self.log_prior_volume


def squared_mahalanobis(residual: Array, covariance: Array) -> Array:
    """Return squared Mahalanobis distances (k,) of residuals (k, d); see `solve_covariance`."""
    found = np.einsum("...a,...a->...", residual, solve_covariance(covariance, residual[..., None])[..., 0])
    spoilt = found < 0  # by rounding, of a matrix that is nearly singular
    if spoilt.any():
        off, solved = residual[spoilt], _solve_by_axes(covariance[spoilt], residual[spoilt, :, None])
        found[spoilt] = np.einsum("ka,ka->k", off, solved[..., 0])
    return np.asarray(found)


def solve_covariance(covariance: Array, right: Array) -> Array:
    """Return the inverse covariances (..., d, d) of innovations times ``right`` (..., d, c).

    Far along an uncertain heading, predictions are so uncertain beside the edge's own noise that the matrix
    is singular in double precision.
    """
    try:
        return np.asarray(np.linalg.solve(covariance, right))
    except np.linalg.LinAlgError:
        return _solve_by_axes(covariance, right)


def _solve_by_axes(covariance: Array, right: Array) -> Array:
    """Solve on the principal axes. The edge's own whitened noise is part of each: none is below 1."""
    values, axes = np.linalg.eigh(covariance)
    along = np.swapaxes(axes, -1, -2) @ right
    return np.asarray(axes @ (along / np.maximum(values, 1.0)[..., None]))


def log_volume(covariance: Array, within: float) -> Array:
    """Return the log volume of the ellipsoid within a squared Mahalanobis distance."""
    d = covariance.shape[-1]
    ball = d / 2 * np.log(np.pi * within) - gammaln(d / 2 + 1)
    return np.asarray(ball + np.linalg.slogdet(covariance)[1] / 2)


def white_noise(rows: int, d: int, stream: int = 0) -> Array:
    """Return white noise (rows, s), the same on every call; another ``stream`` is independent noise."""
    return np.random.default_rng(stream).standard_normal((rows, _SAMPLE_COUNTS[d]))


def sample_posterior(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, d: int, noise: Array | None = None
) -> Array | None:
    """Draw (n, d, s) samples from the posterior at a solution, right perturbations; None if singular.

    ``noise`` is `white_noise` of at least as many rows as the graph has.

    With J the whitened system, x = (J'J)^-1 J' e has the covariance (J'J)^-1 for e of unit covariance: all
    joint covariances at the price of one factor. Source: Papandreou and Yuille 2010 (NIPS).
    """
    order = elimination_order(graph, d)
    J = jacobian(graph, values, order)
    if noise is None:
        noise = white_noise(J.shape[0], d)
    try:
        factor = cholesky(csc_array(J.T @ J), "NATURAL")
    except RuntimeError:
        return None
    solved = factor.solve(np.asarray(J.T @ noise[: J.shape[0]]))
    if not np.isfinite(solved).all():
        return None
    found = np.empty_like(solved)
    found[order] = solved
    return found.reshape(-1, d, _SAMPLE_COUNTS[d])


def innovations(
    problem: Problem, w_T: Array, samples: Array, edges: Index, scale: float = 1.0
) -> LoopInnovations:
    """Return the innovations of edges that took no part in the solution ``w_T`` and its ``samples``.

    ``scale`` is the factor of the noise over the stated one.
    """
    edges = np.sort(edges)
    residual = problem.with_edges(np.isin(np.arange(len(problem.i)), edges)).residuals(w_T)
    volume = log_prior_volume(problem, w_T)[edges] - problem.dof * np.log(scale)
    return LoopInnovations(edges, residual / scale, whitened_spread(problem, w_T, samples, edges), volume)


def whitened_spread(problem: Problem, w_T: Array, samples: Array, edges: Index) -> Array:
    """Return whitened prediction errors (k, d, s) of edges from posterior samples (n, d, s)."""
    i, j = problem.i[edges], problem.j[edges]
    turn = problem.adjoint(se3.inverse(w_T[j]) @ w_T[i])
    return np.asarray(problem.sqrt_information[edges] @ (samples[j] - turn @ samples[i]))


def whitened_covariance(problem: Problem, w_T: Array, samples: Array) -> Array:
    """Return the covariances (m, d, d) of `whitened_spread` of all edges, without its samples."""
    # Many null loops join the same two poses, and differ in their information alone.
    pairs, pair = np.unique(problem.i * problem.count + problem.j, return_inverse=True)
    i, j = np.divmod(pairs, problem.count)
    own = samples @ np.swapaxes(samples, 1, 2)
    turn = problem.adjoint(se3.inverse(w_T[j]) @ w_T[i])
    cross = turn @ (samples[i] @ np.swapaxes(samples[j], 1, 2))
    error = own[j] + turn @ own[i] @ np.swapaxes(turn, 1, 2) - cross - np.swapaxes(cross, 1, 2)
    root = problem.sqrt_information
    return np.asarray(root @ error[pair] @ np.swapaxes(root, 1, 2) / samples.shape[2])


def log_prior_volume(problem: Problem, w_T: Array) -> Array:
    """Return (m,) log whitened volumes in which a false loop may lie: the map times all rotations."""
    extent = np.ptp(w_T[:, : problem.dimension, 3], axis=0)
    log_volume_ = np.log(np.maximum(extent, 1e-3 * extent.max() + 1e-9)).sum()
    log_volume_ += np.log(2 * np.pi) if problem.dof == 3 else np.log(8 * np.pi**2)
    return np.asarray(log_volume_ + problem.log_sqrt_information)


def first_scale(pending: LoopInnovations, place: Index) -> float:
    """Estimate the factor on the stated standard deviations before any loop is accepted.

    It is the largest that the likely loops do not contradict, and at most 1.
    """
    variance, share = _mixture(pending)
    # Loops between the same places have a common error: they count once.
    dof = pending.residual.shape[1] * max(len(np.unique(place[share > 0.5])), 1)
    return float(np.sqrt(min(variance * dof / chi_square_quantile(SIGNIFICANCE, dof), 1.0)))


def likely_scale(pending: LoopInnovations) -> float:
    """Estimate the same factor as `first_scale`: the most likely one, and at most 1."""
    return float(np.sqrt(min(_mixture(pending)[0], 1.0)))


def _mixture(pending: LoopInnovations) -> tuple[float, Array]:
    """Return the factor on the stated covariances, and (k,) the probability that each loop is true.

    Expectation maximisation of a mixture: true loops Gaussian about the prediction, false ones uniform.
    """
    d = pending.residual.shape[1]
    covariance = pending.covariance
    off = squared_mahalanobis(pending.residual, covariance)
    peak = -d / 2 * np.log(2 * np.pi) - np.linalg.slogdet(covariance)[1] / 2 + pending.log_prior_volume
    true, variance = 0.5, max(float(np.quantile(off, 0.1)) / d, _MIN_SCALE**2)
    share = np.zeros(len(off))
    for _ in range(_EM_ITERATIONS):
        odds = peak - off / variance / 2 - d / 2 * np.log(variance) + np.log(true / (1 - true))
        share = 1 / (1 + np.exp(-np.clip(odds, -50, 50)))
        variance = max(float(share @ off) / (d * max(float(share.sum()), 1e-9)), _MIN_SCALE**2)
        true = float(np.clip(share.mean(), 0.01, 0.99))
    return variance, np.asarray(share)


def noise_scale(problem: Problem, kept: Mask, w_T: Array) -> float:
    """Estimate the factor on the stated standard deviations from the chi-square of the kept edges.

    It is 1 unless a chi-square test rejects that. If stated covariances are far too large, so that false
    loops would pass the gates, it is the largest factor of any axis that the test does not reject:
    covariances that are too large along one axis may be right along another. It is at least `_MIN_SCALE`:
    residuals of exactly zero are possible.
    """
    d = problem.dof
    redundancy = int(kept.sum()) - problem.count + 1
    if redundancy <= 0:
        return 1.0
    statistics = (problem.residuals(w_T)[kept] ** 2).sum(axis=0)
    total = float(statistics.sum())
    if total > chi_square_quantile(1 - SIGNIFICANCE, d * redundancy):
        return float(np.sqrt(total / (d * redundancy)))
    # Each axis has as many edges and as many unknowns as any other.
    largest = d * float(statistics.max()) / chi_square_quantile(SIGNIFICANCE, d * redundancy)
    return float(np.clip(np.sqrt(largest), _MIN_SCALE, 1.0))
