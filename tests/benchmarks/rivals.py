"""Other methods to reject false loops, for comparison with `backend.pose_graph.selection` on the same graphs.

Each starts from odometry and trusts it, as ours does, and ends with a least-squares fit of the kept edges.
"""

from __future__ import annotations

from collections.abc import Callable

import gtsam
import networkx
import numpy as np

from backend import se3
from backend.pose_graph.chi_square import SIGNIFICANCE, chi_square_gate
from backend.pose_graph.gauge_fixed_problem import (
    GaugeFixedProblem,
    Options,
    initial_poses,
    least_squares_fit,
)
from backend.pose_graph.graph import PoseGraph
from backend.pose_graph.initialize import spanning_tree
from backend.pose_graph.problem import Problem, from_pose_graph
from backend.pose_graph.selection.chains import chain_members
from backend.pose_graph.selection.prediction import squared_mahalanobis
from backend.pose_graph.unary_factors import fixed, gtsam_poses

Array = np.ndarray
Rival = Callable[[PoseGraph], tuple[Array, Array]]
"""Function from a graph to kept edges (m,) and their poses (n, 4, 4)."""

_EXACT = 150
"""Number of loops above which a maximum clique takes too long."""


def cauchy(graph: PoseGraph) -> tuple[Array, Array]:
    """Reject loops that are outliers after a solve with Cauchy's kernel on every loop."""
    problem, gauge_fixed, w_T = _robust_solve(graph, gtsam.noiseModel.mEstimator.Cauchy.Create(1.0))
    near = np.linalg.norm(problem.residuals(w_T), axis=1) <= np.sqrt(chi_square_gate(problem.dof))
    return _solved(gauge_fixed, problem.trusted | near, w_T)


def huber(graph: PoseGraph) -> tuple[Array, Array]:
    """Solve with Huber's kernel on every loop; nothing is rejected."""
    problem, _, w_T = _robust_solve(graph, gtsam.noiseModel.mEstimator.Huber.Create(1.345))
    return np.ones_like(problem.trusted), w_T


def _robust_solve(
    graph: PoseGraph, loss: gtsam.noiseModel.mEstimator.Base
) -> tuple[Problem, GaugeFixedProblem, Array]:
    problem, odometry, gauge_fixed = _begun(graph)
    factors = problem.with_edges(problem.trusted).edge_factors()
    loops = problem.with_edges(~problem.trusted)
    make = gtsam.BetweenFactorPose2 if problem.dimension == 2 else gtsam.BetweenFactorPose3
    poses = gtsam_poses(loops.ij_T, loops.dimension)
    for i, j, pose, R in zip(loops.i.tolist(), loops.j.tolist(), poses, loops.sqrt_information, strict=True):
        noise = gtsam.noiseModel.Robust.Create(loss, gtsam.noiseModel.Gaussian.SqrtInformation(R))
        factors.add(make(i, j, pose, noise))
    factors.push_back(gauge_fixed.priors)
    found = gtsam.LevenbergMarquardtOptimizer(factors, problem.values(odometry)).optimize()
    return problem, gauge_fixed, problem.poses(gtsam.Values(found))


def gnc(graph: PoseGraph) -> tuple[Array, Array]:
    """Select loops by gtsam's graduated non-convexity with truncated least squares (Yang et al. 2020).

    Odometry and priors are its known inliers.
    """
    problem, odometry, gauge_fixed = _begun(graph)
    factors = problem.edge_factors()
    m = factors.size()
    factors.push_back(gauge_fixed.priors)
    params = gtsam.GncLMParams()
    params.setLossType(gtsam.GncLossType.TLS)
    params.setKnownInliers([*np.flatnonzero(problem.trusted).tolist(), *range(m, factors.size())])
    optimizer = gtsam.GncLMOptimizer(factors, problem.values(odometry), params)
    optimizer.setInlierCostThresholdsAtProbability(1 - SIGNIFICANCE)
    w_T = problem.poses(gtsam.Values(optimizer.optimize()))
    return _solved(gauge_fixed, np.asarray(optimizer.getWeights())[:m] > 0.5, w_T)


def clique(graph: PoseGraph) -> tuple[Array, Array]:
    """Find the largest set of pairwise consistent loops (Mangelson et al. 2018).

    Loops between the same two robots are compared, and those within one robot. It is the maximum clique of up
    to 150 loops; for more, the best of greedy searches from each loop, as its authors do.
    """
    problem, odometry, gauge_fixed = _begun(graph)
    chain = np.empty(problem.count, dtype=np.int64)
    for number, members in enumerate(chain_members(problem)):
        chain[members] = number
    loops = np.flatnonzero(~problem.trusted)
    ends = np.sort(chain[np.column_stack([problem.i, problem.j])[loops]], axis=1)
    kept = problem.trusted.copy()
    for pair in np.unique(ends, axis=0):
        among = loops[(ends == pair).all(axis=1)]
        agree = _pairwise_consistent(problem, odometry, among)
        if len(among) <= _EXACT:
            chosen = networkx.max_weight_clique(networkx.from_numpy_array(agree), weight=None)[0]
        else:
            chosen = max((_greedy(agree, a) for a in range(len(among))), key=len)
        kept[among[chosen]] = True
    return _solved(gauge_fixed, kept, odometry)


def _pairwise_consistent(problem: Problem, w_T: Array, loops: Array) -> Array:
    """Return (k, k) whether the cycle of two loops and the odometry between them closes within its noise."""
    T, inverse, walked = w_T, se3.inverse(w_T), _walked_covariances(problem, w_T)
    i, j, z, noise = _oriented(problem, loops)
    agree = np.zeros((len(loops), len(loops)), dtype=bool)
    for a in range(len(loops)):
        there, back = inverse[j[a]] @ T[j], inverse[i] @ T[i[a]]
        after = se3.inverse(z) @ back
        # Each part of the cycle has a covariance, and the transform that follows it.
        parts = (
            (noise[a], se3.inverse(there @ after)),
            (_between(walked, j[a], j), se3.inverse(after) @ inverse[j]),
            (noise, se3.inverse(back) @ z),
            (_between(walked, i, i[a]), inverse[i[a]]),
        )
        covariance = sum(_turned(problem, A, P) for P, A in parts)
        error = z[a] @ there @ after
        off = se3.planar_log(error) if problem.dof == 3 else se3.log(error)
        agree[a] = squared_mahalanobis(off, covariance) <= chi_square_gate(problem.dof)
    agree &= agree.T
    np.fill_diagonal(agree, False)
    return agree


def _oriented(problem: Problem, loops: Array) -> tuple[Array, Array, Array, Array]:
    """Return ends, measurements and covariances of loops that all go from the lower to the higher pose."""
    i, j, z = problem.i[loops], problem.j[loops], problem.ij_T[loops]
    R = problem.sqrt_information[loops]
    noise, swap = np.linalg.inv(np.swapaxes(R, 1, 2) @ R), i > j
    noise = np.where(swap[:, None, None], _turned(problem, z, noise), noise)
    z = np.where(swap[:, None, None], se3.inverse(z), z)
    return np.minimum(i, j), np.maximum(i, j), z, noise


def _walked_covariances(problem: Problem, w_T: Array) -> Array:
    """Return (n, d, d) sums of the covariances of all steps of odometry before each pose, in the world."""
    steps = np.flatnonzero(problem.trusted)
    _, end, _, noise = _oriented(problem, steps)
    added = np.zeros((problem.count, problem.dof, problem.dof))
    added[end] = _turned(problem, w_T[end], noise)
    return np.cumsum(added, axis=0)


def _between(walked: Array, here: Array, there: Array) -> Array:
    sign = np.sign(there - here)
    return np.reshape(sign, (-1, 1, 1)) * (walked[there] - walked[here])


def _turned(problem: Problem, T: Array, covariance: Array) -> Array:
    A = problem.adjoint(T)
    return np.asarray(A @ covariance @ np.swapaxes(A, -1, -2))


def _greedy(agree: Array, first: int) -> list[int]:
    """Grow a clique from one loop, each time by the loop of highest degree (Pattabiraman et al. 2015)."""
    degree, members, open_ = agree.sum(axis=1), [first], agree[first].copy()
    while open_.any():
        best = int(np.argmax(np.where(open_, degree, -1)))
        members.append(best)
        open_ &= agree[best]
    return members


def _begun(graph: PoseGraph) -> tuple[Problem, Array, GaugeFixedProblem]:
    problem = from_pose_graph(graph)
    chain = problem.with_edges(problem.trusted)
    cost = np.ones(len(chain.i))
    odometry = spanning_tree(problem.count, chain.i, chain.j, chain.ij_T, cost, 0, np.eye(4))
    if np.isnan(odometry).any():
        odometry = initial_poses(problem)
    priors = gtsam.NonlinearFactorGraph()
    priors.push_back(fixed(0, odometry[0], problem.dimension).factor)
    return problem, odometry, GaugeFixedProblem(problem, priors, Options(covariances=False))


def _solved(gauge_fixed: GaugeFixedProblem, kept: Array, w_T: Array) -> tuple[Array, Array]:
    return kept, least_squares_fit(gauge_fixed, kept, w_T).w_T


RIVALS: dict[str, Rival] = {
    "gtsam's GNC": gnc,
    "PCM clique": clique,
    "Cauchy kernel": cauchy,
    "Huber kernel": huber,
}
