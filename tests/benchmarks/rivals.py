"""Other methods to reject false loops, for comparison with `backend.pose_graph.selection` on the same graphs.

Each starts from odometry and trusts it, as ours does, and ends with a least-squares fit of the kept edges.
"""

from __future__ import annotations

from collections.abc import Callable

import gtsam
import networkx
import numpy as np

from backend.pose_graph.chi_square import edge_limit
from backend.pose_graph.gauge_fixed_problem import GaugeFixedProblem, Options, least_squares_fit
from backend.pose_graph.graph import PoseGraph
from backend.pose_graph.initialize import spanning_tree
from backend.pose_graph.problem import Problem, from_pose_graph
from backend.pose_graph.selection.gnc import gnc_inliers
from backend.pose_graph.selection.prediction import (
    chi_square_gate,
    innovations,
    sample_posterior,
    squared_mahalanobis,
)
from backend.pose_graph.unary_factors import fixed, gtsam_poses

Array = np.ndarray
Rival = Callable[[PoseGraph], tuple[Array, Array]]
"""Function from a graph to kept edges (m,) and their poses (n, 4, 4)."""

_EXACT = 150
"""Number of loops above which a maximum clique takes too long."""


def kernel(graph: PoseGraph) -> tuple[Array, Array]:
    """Reject loops that are outliers after a solve with Cauchy's kernel on every loop."""
    problem, odometry, gauge_fixed = _begun(graph)
    factors = problem.with_edges(problem.trusted).edge_factors()
    loops = problem.with_edges(~problem.trusted)
    make = gtsam.BetweenFactorPose2 if problem.dimension == 2 else gtsam.BetweenFactorPose3
    cauchy = gtsam.noiseModel.mEstimator.Cauchy.Create(1.0)
    poses = gtsam_poses(loops.ij_T, loops.dimension)
    for i, j, pose, R in zip(loops.i.tolist(), loops.j.tolist(), poses, loops.sqrt_information, strict=True):
        noise = gtsam.noiseModel.Robust.Create(cauchy, gtsam.noiseModel.Gaussian.SqrtInformation(R))
        factors.add(make(i, j, pose, noise))
    factors.push_back(gauge_fixed.priors)
    found = gtsam.LevenbergMarquardtOptimizer(factors, problem.values(odometry)).optimize()
    w_T = problem.poses(gtsam.Values(found))
    near = np.linalg.norm(problem.residuals(w_T), axis=1) <= edge_limit(problem)
    return _solved(gauge_fixed, problem.trusted | near, w_T)


def gnc(graph: PoseGraph) -> tuple[Array, Array]:
    """Select loops by graduated non-convexity with truncated least squares (Yang et al. 2020)."""
    problem, odometry, gauge_fixed = _begun(graph)
    return _solved(gauge_fixed, *gnc_inliers(problem, gauge_fixed.priors, odometry, ~problem.trusted))


def clique(graph: PoseGraph) -> tuple[Array, Array]:
    """Find the largest set of pairwise consistent loops (Mangelson et al. 2018).

    It is the maximum clique of up to 150 loops; for more, the best of greedy searches from each loop, as its
    authors do.
    """
    problem, odometry, gauge_fixed = _begun(graph)
    samples = sample_posterior(gauge_fixed.graph(problem.trusted), problem.values(odometry), problem.dof)
    assert samples is not None
    loops = np.flatnonzero(~problem.trusted)
    found = innovations(problem, odometry, samples, loops)
    agree = np.empty((len(loops), len(loops)), dtype=bool)
    for a in range(len(loops)):
        agree[a] = squared_mahalanobis(*found.conditioned_on(a)) <= chi_square_gate(problem.dof)
    agree &= agree.T
    np.fill_diagonal(agree, False)
    if len(loops) <= _EXACT:
        chosen = networkx.max_weight_clique(networkx.from_numpy_array(agree), weight=None)[0]
    else:
        chosen = max((_greedy(agree, a) for a in range(len(loops))), key=len)
    kept = problem.trusted.copy()
    kept[loops[chosen]] = True
    return _solved(gauge_fixed, kept, odometry)


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
    priors = gtsam.NonlinearFactorGraph()
    priors.push_back(fixed(0, odometry[0], problem.dimension).factor)
    return problem, odometry, GaugeFixedProblem(problem, priors, Options(covariances=False))


def _solved(gauge_fixed: GaugeFixedProblem, kept: Array, w_T: Array) -> tuple[Array, Array]:
    return kept, least_squares_fit(gauge_fixed, kept, w_T).w_T


RIVALS: dict[str, Rival] = {"GNC": gnc, "PCM clique": clique, "kernel alone": kernel}
