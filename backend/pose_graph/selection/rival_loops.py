"""The exchange of kept for rejected loops that has almost as much for it as the selection itself.

One false loop that odometry allows can bend the map until true loops disagree with it. If these are one row,
the evidence is that of one row against one loop, and no answer is certain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.chi_square import SIGNIFICANCE
from backend.pose_graph.gauge_fixed_problem import GaugeFixedProblem
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.evidence import LinearizedSet, log_unit_volumes
from backend.pose_graph.selection.growth import coarse_solver
from backend.pose_graph.selection.places import ROW_LENGTH, place_pairs
from backend.pose_graph.selection.swap import LocalSearch, one_loop_a_place

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

LEAST_LOG_ODDS = -float(np.log(SIGNIFICANCE))
"""Odds of 1000 to 1 (nats), below which neither of two answers is called right: the level of all gates."""


@dataclass(frozen=True)
class Rivals:
    """Rejected edges that agree with each other, and kept edges that contradict them: one side is false."""

    rejected: Index
    """(r,) numbers of the rejected edges, loops with those of their rows."""
    kept: Index
    """(k,) numbers of the kept edges that are false if the rejected ones are true."""
    log_odds: float
    """Log odds (nats) of the kept edges against the rejected ones, each row of loops counted once."""


def rival_loops(gauge_fixed: GaugeFixedProblem, kept: Mask, w_T: Array) -> Rivals | None:
    """Return the most probable exchange of ``kept`` (m,) for rejected loops; None if it is improbable.

    ``w_T`` (n, 4, 4) is the solution of the kept edges.
    """
    problem, loops = gauge_fixed.problem, ~gauge_fixed.problem.trusted
    if not (kept & loops).any() or kept[loops].all():
        return None
    rows = place_pairs(problem.i, problem.j, ROW_LENGTH)
    solve = coarse_solver(gauge_fixed)
    few = one_loop_a_place(problem, kept, w_T, rows)
    w_T = solve(few, w_T)
    volumes = log_unit_volumes(problem, w_T)
    current = LinearizedSet.of(problem, gauge_fixed.graph, few, w_T, volumes)
    search = LocalSearch(problem, gauge_fixed.graph, solve, rows, lambda: False, -LEAST_LOG_ODDS)
    other = None if current is None else search.propose(current, True, volumes)
    if current is None or other is None:
        return None
    log_odds = current.evidence(current.odds) - other.evidence(current.odds)
    if log_odds > LEAST_LOG_ODDS:
        return None
    gained, lost = other.kept & ~few, few & ~other.kept
    rejected, false = (which | (loops & np.isin(rows, rows[which & loops])) for which in (gained, lost))
    return Rivals(np.flatnonzero(rejected & ~kept), np.flatnonzero(false & kept), log_odds)


def rivals_sentence(problem: Problem, found: Rivals) -> str:
    """Return what contradicts what, how sure the answer is, and what to do."""
    odds = np.exp(max(found.log_odds, 0.0))
    rejected = described(problem, found.rejected, "rejected edge", "rejected edges")
    kept = described(problem, found.kept, "kept loop", "kept loops")
    return (
        f"{rejected} would agree with the rest without {kept}, and the odds for what is kept are only"
        f" {odds:.0f} to 1; check which of the two are true, and delete the others from the file"
    )


def described(problem: Problem, edges: Index, kind: str, kinds: str) -> str:
    """Return edges in words: ``1 kept loop (vertex 1 to vertex 9)``; ``kind`` and ``kinds`` are its names."""
    low, high = np.minimum(problem.i, problem.j)[edges], np.maximum(problem.i, problem.j)[edges]
    if len(edges) == 1:
        return f"1 {kind} ({problem.name(low[0])} to {problem.name(high[0])})"
    ends = [f"{problem.name(each.min())} to {problem.name(each.max())}" for each in (low, high)]
    return f"{len(edges)} {kinds} (from {ends[0]}, into {ends[1]})"
