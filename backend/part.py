"""One connected part of a graph: anchor it, start it, solve it plainly, and reject edges only where it
must."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.absolutes import OUTLIER_SIGMA, aligned, fixed, jacobian
from backend.agreement import draws, grown, judged, noise_scale
from backend.consistency import ChiSquare, agreeing_edges, chi_square, edge_limit, reason
from backend.errors import BackendError
from backend.gauge import direction_words, hold_factor, key_runs, open_directions
from backend.initialize import chordal, elimination_cost, spanning_tree, tree_edges
from backend.marginals import pose_covariances
from backend.problem import Problem
from backend.solve import Minimum, OnStep, gauss_newton, levenberg_marquardt

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LOOP_DETOUR = 1e6
"""Factor on the cost of a loop in the spanning tree: one false loop spoils all poses behind it."""
_ROUNDS = 4
_DEAR = 1.5e10
"""Operations of an elimination, some seconds."""
_FEW, _COARSE = 8, 1e-3
"""Steps and tolerance of the solves on the way to which edges agree."""


@dataclass(frozen=True)
class Options:
    """How to solve."""

    loops_robust: bool = True
    covariances: bool = True
    max_iterations: int = 100
    relative_tolerance: float = 1e-5
    on_step: OnStep | None = None
    deadline: float = math.inf
    """On ``time.monotonic``'s clock."""


@dataclass(frozen=True)
class Part:
    """A solved part; arrays in the order of its poses and edges."""

    w_T: Array
    covariances: Array | None
    kept: Mask
    reasons: tuple[str, ...]
    residual: Array
    error: float
    iterations: int
    converged: bool
    held: str
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class _Fit:
    """A plain solve of some edges."""

    minimum: Minimum
    w_T: Array
    test: ChiSquare


@dataclass(frozen=True)
class _Anchored:
    """A problem with what is held, and the options: everything that a plain solve of some edges needs."""

    problem: Problem
    ties: gtsam.NonlinearFactorGraph
    """Absolute measurements and what is held."""
    options: Options

    def graph(self, kept: Mask) -> gtsam.NonlinearFactorGraph:
        graph = self.problem.with_edges(kept).edge_factors()
        graph.push_back(self.ties)
        return graph


def solve_part(problem: Problem, options: Options) -> Part:
    """Solve one connected part. Raises ``BackendError`` where it has no answer."""
    start = _start(problem)
    ties, held = _ties(problem, start)
    anchored = _Anchored(problem, ties, options)
    kept = np.ones(len(problem.i), dtype=bool)
    sigma = np.full(len(kept), np.nan)
    # Random false loops fill the elimination up: then they are looked for before all edges are solved.
    dear = elimination_cost(problem) > _DEAR and _has_loops_on_odometry(problem)
    fit = None if dear and options.loops_robust else _plain(anchored, kept, start)
    if fit is None or (options.loops_robust and not fit.test.passed):
        kept, fit, sigma = _rejected(anchored, fit)
    minimum, w_T = fit.minimum, fit.w_T
    covariances = None
    if options.covariances:
        covariances = pose_covariances(anchored.graph(kept), minimum.values, range(problem.count))
    return Part(
        w_T=w_T,
        covariances=covariances,
        kept=kept,
        reasons=_reasons(problem, kept, w_T, sigma),
        residual=np.linalg.norm(problem.residuals(w_T), axis=1),
        error=minimum.error,
        iterations=minimum.iterations,
        converged=minimum.converged,
        held=held,
        warnings=tuple(_warnings(problem, fit)),
    )


def _reasons(problem: Problem, kept: Mask, w_T: Array, sigma: Array) -> tuple[str, ...]:
    said = [""] * len(kept)
    for e in np.flatnonzero(~kept).tolist():
        said[e] = reason(problem, e, w_T, sigma[e])
    return tuple(said)


def _warnings(problem: Problem, fit: _Fit) -> list[str]:
    minimum, test, said = fit.minimum, fit.test, []
    if not (minimum.converged and test.passed):
        who = key_runs(range(problem.count), problem.name)
    if not minimum.converged:
        said.append(f"{who}: no start converged ({minimum.reason}); the best point found is given")
    if not test.passed:
        ratio = math.sqrt(test.statistic / test.freedom)
        said.append(
            f"{who}: the edges disagree more than their covariances allow (chi-square {test.statistic:.4g}"
            f" for {test.freedom} degrees of freedom): deviations are {ratio:.2g} times what is stated"
        )
    for kind in ("position", "range"):
        of_kind = [a for a in problem.absolutes if a.kind == kind]
        far = sum(2 * a.plain.error(minimum.values) > OUTLIER_SIGMA**2 for a in of_kind)
        if far:
            said.append(f"{far} of {len(of_kind)} {kind}s lie beyond {OUTLIER_SIGMA:.0f} sigma: weighed down")
    return said


def placed_alone(problem: Problem) -> bool:
    """Whether absolute measurements place the single pose of a problem."""
    if any(a.kind == "fixed" for a in problem.absolutes):
        return True
    if problem.dimension == 2:
        return False
    return len(_open(problem, _start(problem))) == 0


def _ties(problem: Problem, start: Array) -> tuple[gtsam.NonlinearFactorGraph, str]:
    """Absolute factors plus a hold on what they leave open, and a sentence about the hold."""
    ties = problem.absolute_factors()
    if any(a.kind == "fixed" for a in problem.absolutes):
        return ties, ""
    who, first = key_runs(range(problem.count), problem.name), problem.name(0)
    if problem.dimension == 2 or not problem.absolutes:
        ties.push_back(fixed(0, start[0], problem.dimension).factor)
        return ties, f"position and attitude of {who}: nothing measures them, {first} is held where it starts"
    directions = _open(problem, start)
    if len(directions) == 0:
        return ties, ""
    ties.push_back(hold_factor(0, start[0], directions))
    return ties, f"{direction_words(directions)} of {who}: nothing measures them, held at {first}"


def _open(problem: Problem, start: Array) -> Array:
    return open_directions([jacobian(a, start[a.k], start[0, :3, 3]) for a in problem.absolutes])


def _start(problem: Problem) -> Array:
    """The given poses where all are known; else a tree from a known one, or moved to the absolute
    measurements."""
    given = np.isfinite(problem.initial).all(axis=(1, 2))
    if given.all():
        return se3.orthonormal(problem.initial)
    root = int(np.argmax(given))
    first = problem.initial[root] if given.any() else np.eye(4)
    R = problem.sqrt_information
    cost = 1 / np.maximum((R**2).sum(axis=(1, 2)), 1e-300) * np.where(problem.trusted, 1, _LOOP_DETOUR)
    w_T = spanning_tree(problem.count, problem.i, problem.j, problem.ij_T, cost, root, first)
    return w_T if given.any() else aligned(w_T, problem.absolutes)


def _chordal_start(problem: Problem, w_T_root: Array) -> Array | None:
    weight = (problem.sqrt_information**2).sum(axis=1)
    planar = problem.dimension == 2
    kappa = weight[:, 2] if planar else weight[:, :3].mean(axis=1)
    tau = weight[:, :2].mean(axis=1) if planar else weight[:, 3:].mean(axis=1)
    if not ((kappa > 0) & (tau > 0)).all():
        return None
    w_T = chordal(problem.i, problem.j, problem.ij_T, kappa, tau, w_T_root, problem.count, planar)
    given = np.isfinite(problem.initial).any()
    return w_T if w_T is None or given else aligned(w_T, problem.absolutes)


def _plain(anchored: _Anchored, kept: Mask, start: Array) -> _Fit:
    """All kept edges as they are, from the better of the start and the chordal relaxation; from the other one
    where that does not end well."""
    problem, options = anchored.problem.with_edges(kept), anchored.options
    graph = anchored.graph(kept)
    limits = (options.max_iterations, options.relative_tolerance, options.on_step, options.deadline)
    attempts: list[_Fit] = []
    refused: BackendError | None = None
    for values in _starts(problem, start):
        if attempts and time.monotonic() > options.deadline:
            break
        try:
            attempts.append(_fit(anchored, problem, gauss_newton(graph, values, *limits, problem.name)))
        except BackendError as error:
            refused = error
            continue
        if attempts[-1].minimum.converged and attempts[-1].test.passed:
            return attempts[-1]
    if not attempts:
        raise refused or BackendError("no start was found")
    best = min(attempts, key=lambda fit: (not fit.minimum.converged, fit.minimum.error))
    if best.minimum.converged:
        return best
    return _fit(anchored, problem, levenberg_marquardt(graph, best.minimum, *limits))


def _starts(problem: Problem, start: Array) -> Iterator[gtsam.Values]:
    """The given start and the chordal one, the one of lower error first."""
    if not np.isfinite(start).all():
        bad = int(np.argmin(np.isfinite(start).all(axis=(1, 2))))
        raise BackendError(f"the start of {problem.name(bad)} is not finite; give it a pose or none at all")
    # Edges that agree with the start to within their noise need no better one; a tree has none.
    before = _edge_statistic(problem, start)
    looped = len(problem.i) >= problem.count
    relaxed = _chordal_start(problem, start[0]) if looped and not chi_square(problem, before).passed else None
    starts = [start] if relaxed is None else [start, relaxed]
    if relaxed is not None and _edge_statistic(problem, relaxed) < before:
        starts.reverse()
    for w_T in starts:
        yield problem.values(w_T)
    relaxed = _chordal_start(problem, start[0]) if looped and relaxed is None else None
    if relaxed is not None:
        yield problem.values(relaxed)


def _edge_statistic(problem: Problem, w_T: Array) -> float:
    return float((problem.residuals(w_T) ** 2).sum())


def _fit(anchored: _Anchored, edges: Problem, minimum: Minimum) -> _Fit:
    statistic = 2 * (minimum.error - float(anchored.ties.error(minimum.values)))
    return _Fit(minimum, edges.poses(minimum.values), chi_square(edges, statistic))


def _rejected(anchored: _Anchored, fit: _Fit | None) -> tuple[Mask, _Fit, Array]:
    """Which edges agree, the solution from them, and by how many sigmas (m,) each other one disagrees.

    ``fit`` is that of all edges; without it there must be odometry that connects all poses.
    """
    problem, trusted = anchored.problem, anchored.problem.trusted
    found = None
    if fit is None or _has_loops_on_odometry(problem):
        kept, at = _grown(anchored)
        found = _settled(anchored, kept, ~trusted, at)
        if fit is None or found[1].test.passed or not _sticks_out(problem, found, trusted).any():
            return found
    # Odometry may be wrong too: then all edges are judged alike.
    everything = np.ones_like(trusted)
    kept, at = agreeing_edges(
        problem, anchored.ties, fit.w_T, everything, anchored.options.on_step, anchored.options.deadline
    )
    other = _settled(anchored, _connected(problem, kept, at), everything, at)
    if found is None or other[0].sum() > found[0].sum():
        return other
    return found


def _has_loops_on_odometry(problem: Problem) -> bool:
    """Whether trusted edges alone connect all poses, and there are others."""
    if problem.trusted.all():
        return False
    chain = problem.with_edges(problem.trusted)
    return len(tree_edges(problem.count, chain.i, chain.j, np.ones(len(chain.i)))) == problem.count - 1


def _sticks_out(problem: Problem, found: tuple[Mask, _Fit, Array], among: Mask) -> Mask:
    off = np.linalg.norm(problem.residuals(found[1].w_T), axis=1)
    return np.asarray(among & (off > edge_limit(problem)))


def _grown(anchored: _Anchored) -> tuple[Mask, Array]:
    problem, options = anchored.problem, anchored.options

    def solve(kept: Mask, w_T: Array) -> Array:
        limits = (_FEW, _COARSE, None, options.deadline)
        begin = Minimum(problem.values(w_T), 0.0, 0.0, 0, False, "")
        graph = anchored.graph(kept)
        try:
            at = gauss_newton(graph, begin.values, *limits, problem.name)
        except BackendError:
            at = begin
        if not at.converged:
            at = levenberg_marquardt(graph, at, *limits)
        return problem.poses(at.values)

    def draw(kept: Mask, w_T: Array) -> Array | None:
        if time.monotonic() > options.deadline:
            return None
        return draws(anchored.graph(kept), problem.values(w_T), problem.freedom)

    def on_round(number: int, believed: int) -> None:
        if options.on_step is not None:
            options.on_step(number, float(believed))

    chain = problem.with_edges(problem.trusted)
    start = spanning_tree(
        problem.count, chain.i, chain.j, chain.ij_T, np.ones(len(chain.i)), 0, _start(problem)[0]
    )
    start = start if np.isfinite(problem.initial).any() else aligned(start, problem.absolutes)
    return grown(problem, problem.trusted, solve(problem.trusted, start), solve, draw, on_round)


def _connected(problem: Problem, kept: Mask, w_T: Array) -> Mask:
    """Kept edges, and of the others those that agree best where the graph would fall apart without them."""
    cost = np.where(kept, 1e-9, 1) * (1 + (problem.residuals(w_T) ** 2).sum(axis=1))
    tree = tree_edges(problem.count, problem.i, problem.j, cost)
    return kept | np.isin(np.arange(len(kept)), tree)


def _settled(anchored: _Anchored, kept: Mask, candidate: Mask, w_T: Array) -> tuple[Mask, _Fit, Array]:
    """Solve the kept edges plainly; take back what the prediction's uncertainty explains, drop what sticks
    out."""
    problem, limit = anchored.problem, edge_limit(anchored.problem)
    banned = np.zeros_like(kept)
    for remaining in reversed(range(_ROUNDS)):
        fit = _plain(anchored, kept, w_T)
        w_T = fit.w_T
        sigma = np.linalg.norm(problem.residuals(w_T), axis=1)
        sticks_out = np.zeros_like(kept)
        if not fit.test.passed:
            sticks_out = kept & candidate & (sigma > limit * max(1.0, noise_scale(problem, kept, w_T)))
        drawn = draws(anchored.graph(kept), fit.minimum.values, problem.freedom)
        back = np.zeros_like(kept)
        if drawn is not None:
            back, innovation = judged(problem, kept, w_T, drawn)
            back &= ~banned
            sigma = np.where(kept, sigma, innovation)
        if remaining == 0 or not (back.any() or sticks_out.any()):
            break
        banned |= sticks_out
        kept = _connected(problem, (kept | back) & ~sticks_out, w_T)
    return kept, fit, sigma
