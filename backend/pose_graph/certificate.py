"""Certificate of global optimality of a pose graph's solution, from the dual of its isotropic approximation.

For all poses F >= trace(Lambda) + d n min(0, lambda), with any symmetric blocks Lambda and the least
eigenvalue lambda of the certificate matrix Q - Lambda. At a global optimum (with moderate noise) the
multipliers of the rotations make the two sides equal. Source: Rosen, Carlone, Bandeira, Leonard 2019 (IJRR),
theorem 7.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

from backend.arguments import check_type
from backend.errors import BackendError
from backend.pose_graph.graph import PoseGraph
from backend.pose_graph.solution import Solution
from backend.pose_graph.synchronization import (
    Factor,
    Synchronization,
    assembled,
    descend,
    elimination_order,
    isotropic,
)

Array = NDArray[np.float64]

MAX_POSES = 10_000
GAP = 1e-6
"""Relative gap up to which a solution counts as the optimum."""

_TIGHT_BOUND = 1e-3
"""Relative difference of bound and error below which the graph's own covariances count as isotropic."""
_LANCZOS_TOLERANCE = 1e-4
_MIN_OBJECTIVE_PER_EDGE = 1e-3
"""Smallest F per edge to which the gap is relative."""


@dataclass(frozen=True)
class Certificate:
    """Optimality of a solution. F is twice a Gaussian error: a chi-square."""

    certified: bool
    """Whether the minimum of the isotropic approximation near the solution is its global one."""
    reason: str
    """Reason for a missing certificate; empty if certified."""
    objective: float = math.nan
    """F at the approximation's minimum near the solution."""
    lower_bound: float = math.nan
    """Lower bound of F for all poses, if the least eigenvalue is correct (see `lower_bound`)."""
    gap: float = math.nan
    """(objective - lower_bound) / max(objective, 0.001 an edge); 0 at the global optimum."""
    moved_m: float = math.nan
    """Largest distance between poses of the solution and of the approximation."""
    moved_rad: float = math.nan
    error_bound: float = math.nan
    """Lower bound of the graph's own error (half a chi-square) for all poses, under the same condition as
    ``lower_bound``."""

    def sentence(self, error: float) -> str:
        """Return the result as a sentence; ``error`` is that of the solution."""
        if not self.certified:
            return f"not certified as the global optimum: {self.reason}"
        scope = "certified for the accepted edges, right or wrong"
        if self.error_bound >= (1 - _TIGHT_BOUND) * error:
            return f"{scope}: no poses have an error below {self.error_bound:.6g}"
        return (
            f"{scope}, with each covariance made isotropic (gap {self.gap:.1g});"
            f" with the graph's own no poses have an error below {self.error_bound:.3g}"
        )


def certify(graph: PoseGraph, solution: Solution) -> Certificate:
    """Certify that the kept edges have no better solution, each component by itself; bounds are summed.

    The certificate is for the graph with isotropic covariances (the mean variance of rotation and of
    translation), after a descent from the solution. ``error_bound`` is for the original graph; it is close
    to the solution's error if covariances are isotropic already. Raises ``TypeError`` for other objects.
    """
    check_type(graph, PoseGraph, "graph", "backend.read_g2o(path)")
    check_type(solution, Solution, "solution")
    return certify_poses(graph, solution.w_T_b, solution.component, solution.edge_kept)


def certify_poses(
    graph: PoseGraph, w_T: Array, component: NDArray[np.int64], edge_kept: NDArray[np.bool_]
) -> Certificate:
    """Certify poses (n, 4, 4) in components (n,), -1 where not placed, for the kept edges (m,), as `certify`.

    The poses may be those of another estimate near the optimum: ``moved_m`` and ``moved_rad`` are then its
    distance from it.
    """
    placed = component >= 0
    kept = edge_kept & placed[graph.i] & placed[graph.j]
    try:
        parts = [
            _certify_component(graph, w_T, np.flatnonzero(component == c), kept)
            for c in range(int(component.max(initial=-1)) + 1)
        ]
    except (BackendError, MemoryError) as refused:
        return Certificate(False, str(refused) or "there is not enough memory")
    looped = [part for part in parts if part is not None]
    if not looped:
        return Certificate(
            certified=True,
            reason="",
            objective=0.0,
            lower_bound=0.0,
            gap=0.0,
            moved_m=0.0,
            moved_rad=0.0,
            error_bound=0.0,
        )
    return Certificate(
        certified=all(part.certified for part in looped),
        reason=next((part.reason for part in looped if part.reason), ""),
        objective=sum(part.objective for part in looped),
        lower_bound=sum(part.lower_bound for part in looped),
        gap=max(part.gap for part in looped),
        moved_m=max(part.moved_m for part in looped),
        moved_rad=max(part.moved_rad for part in looped),
        error_bound=sum(part.error_bound for part in looped),
    )


def _certify_component(
    graph: PoseGraph, w_T: Array, members: NDArray[np.int64], kept: NDArray[np.bool_]
) -> Certificate | None:
    """Certify a connected component; None if it has no cycle: a tree fits exactly."""
    number = np.full(len(graph.ids), -1, dtype=np.int64)
    number[members] = np.arange(len(members))
    edges = np.flatnonzero(kept & (number[graph.i] >= 0))
    if len(edges) < len(members):
        return None
    if len(members) > MAX_POSES:
        raise BackendError(f"{len(members)} poses are more than {MAX_POSES}")
    if graph.fixed[members].sum() > 1:
        raise BackendError("more than one vertex is held in place")
    information, d = graph.information[edges], graph.dimension
    kappa, tau = isotropic(information)
    if not ((kappa > 0) & (tau > 0)).all():
        raise BackendError("an edge leaves a direction open")
    T = graph.ij_T[edges]
    problem = Synchronization(
        count=len(members),
        i=number[graph.i[edges]],
        j=number[graph.j[edges]],
        ij_R=T[:, :d, :d],
        ij_t_m=T[:, :d, 3],
        kappa=kappa,
        tau=tau,
    )
    w_T = w_T[members]
    order = elimination_order(problem)
    w_R, w_t = descend(problem, w_T[:, :d, :d], w_T[:, :d, 3], order)
    objective, bound = problem.objective(w_R, w_t), lower_bound(problem, w_R, w_t, order)
    gap = (objective - bound) / max(objective, _MIN_OBJECTIVE_PER_EDGE * len(edges))
    cosine = (np.einsum("nab,nab->n", w_R, w_T[:, :d, :d]) - (d - 2)) / 2
    return Certificate(
        certified=gap <= GAP,
        reason="" if gap <= GAP else f"no poses have less than {bound:.4g}, these have {objective:.4g}",
        objective=objective,
        lower_bound=bound,
        gap=gap,
        moved_m=float(np.linalg.norm(w_t - w_T[:, :d, 3], axis=1).max()),
        moved_rad=float(np.arccos(np.clip(cosine, -1, 1)).max()),
        error_bound=_isotropy_ratio(information, kappa, tau) * bound / 2,
    )


def _isotropy_ratio(information: Array, kappa: Array, tau: Array) -> float:
    """Return the largest c for which every edge's cost is at least c times its isotropic approximation.

    A rotation's angle is at least its chord, and the logarithm's translation at least the distance.
    """
    d = information.shape[-1]
    repeats = [2, 1] if d == 3 else [3, 3]
    pair = (tau, 2 * kappa) if d == 3 else (2 * kappa, tau)
    root = np.sqrt(np.repeat(np.column_stack(pair), repeats, axis=1))
    return float(np.linalg.eigvalsh(information / (root[:, :, None] * root[:, None, :]))[:, 0].min())


def lower_bound(problem: Synchronization, w_R: Array, w_t: Array, order: NDArray[np.int64]) -> float:
    """Return a lower bound of F from the multipliers at a critical point; at least 0.

    The signs of a factor prove that no eigenvalue is below minus the shift; with the first shift the bound
    loses GAP of F. A tighter bound depends on the least eigenvalue: Lanczos' iteration converges from above,
    and a margin of ten times its tolerance is subtracted.
    """
    n, d = w_t.shape
    multipliers = problem.multipliers(w_R, w_t)
    total = float(np.trace(multipliers, axis1=1, axis2=2).sum())
    blocks = np.zeros((n, d + 1, d + 1))
    blocks[:, 1:, 1:] = multipliers
    # Columns are (t, R') of each pose; the first position is fixed, without effect on the Schur complement.
    matrix = _connection_laplacian(problem, blocks)[1:, 1:]
    rotational = np.tile(np.r_[0.0, np.ones(d)], n)[1:]
    scale = max(total, _MIN_OBJECTIVE_PER_EDGE * len(problem.i)) / (n * d)
    for relative in (GAP, 1e2 * GAP, 1e4 * GAP, 1.0):
        shift = relative * scale
        factor = Factor(csc_array(matrix + diags_array(shift * rotational)), order)
        if factor.negative == 0:
            return float(
                max(total + n * d * min(0.0, _min_eigenvalue(factor.solve, rotational > 0, shift)), 0.0)
            )
    return 0.0


def _min_eigenvalue(solve: Callable[[Array], Array], rotational: NDArray[np.bool_], shift: float) -> float:
    """Return the least eigenvalue of Q - Lambda, at least minus ``shift``, which makes it positive."""
    size = int(rotational.sum())

    def inverse(x: Array) -> Array:
        rhs = np.zeros(len(rotational))
        rhs[rotational] = np.ravel(x)
        return np.asarray(solve(rhs)[rotational])

    operator = LinearOperator((size, size), matvec=inverse, dtype=np.float64)
    start = np.random.default_rng(0).normal(size=size)
    try:
        largest = eigsh(
            operator,
            k=1,
            which="LA",
            v0=start,
            tol=_LANCZOS_TOLERANCE,
            maxiter=300,
            return_eigenvectors=False,
        )
    except ArpackError:
        return -shift
    return max(1 / (float(largest[0]) * (1 + 10 * _LANCZOS_TOLERANCE)) - shift, -shift)


def _connection_laplacian(problem: Synchronization, subtracted: Array) -> csc_array:
    """Return M with F = trace(X' M X), X stacking (t, R') of each pose, less diagonal blocks (n, q, q).

    Source: equation 13.
    """
    d, m = problem.dimension, len(problem.i)
    step = np.zeros((m, d + 1, d + 1))
    step[:, 0, 0] = 1
    step[:, 0, 1:] = problem.ij_t_m
    step[:, 1:, 1:] = np.swapaxes(problem.ij_R, 1, 2)
    weight = np.repeat(np.column_stack([problem.tau, problem.kappa]), [1, d], axis=1)
    coupling = np.swapaxes(step, 1, 2) * weight[:, None, :]
    diagonal = -subtracted
    np.add.at(diagonal, problem.i, coupling @ step)
    np.add.at(diagonal, problem.j, weight[:, :, None] * np.eye(d + 1))
    return assembled(problem, diagonal, -coupling)
