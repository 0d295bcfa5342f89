"""Find the step of odometry that a selection puts in doubt."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.chi_square import SIGNIFICANCE
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.chains import chain_members
from backend.pose_graph.selection.places import place_pairs
from backend.quantiles import binomial_tail

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


def doubtful_odometry(problem: Problem, kept: Mask) -> Mask | None:
    """Return the trusted edges (m,) over the step that more rejected loops span than kept ones.

    ``kept`` is (m,). One wrong step of odometry makes all true loops over it disagree, and none beside it.
    Of the steps with the largest margin, it is the one that the fewest trusted edges span. All of those edges
    are in doubt: if one alone lost its trust, the others would still carry the error past the loops.
    None if at each step the kept loops are as many as the rejected ones.
    """
    chain = np.empty(problem.count, dtype=np.int64)
    for number, members in enumerate(chain_members(problem)):
        chain[members] = number
    low, high = np.minimum(problem.i, problem.j), np.maximum(problem.i, problem.j)
    loops = ~problem.trusted & (chain[low] == chain[high])
    over = _spanning(problem.count, low[loops], high[loops], np.where(kept, -1, 1)[loops])
    trusted = problem.trusted & kept
    count = _spanning(problem.count, low[trusted], high[trusted], np.ones_like(low[trusted]))
    steps = low[trusted & (high - low == 1)]
    if len(steps) == 0 or over[steps].max() <= 0:
        return None
    step = steps[np.lexsort((count[steps], -over[steps]))[0]]
    return np.asarray(problem.trusted & (low <= step) & (step < high))


def odometry_dispute(problem: Problem, doubted: Mask, agreeing: Mask, probable: bool = False) -> str:
    """Return a sentence about rejected loops that agree with each other; empty if chance explains them.

    ``agreeing`` (m,) are those loops, ``doubted`` (m,) the trusted edges that they contradict. Loops between
    one pair of places may be false together, where a floor repeats; two pairs of places hardly are. With
    ``probable`` they have the higher evidence than the odometry and its loops, and are named in any case.
    """
    if not probable and len(np.unique(place_pairs(problem.i[agreeing], problem.j[agreeing]))) < 2:
        return ""
    return (
        f"{np.count_nonzero(agreeing)} loops agree with each other and contradict the odometry from"
        f" {_span(problem, doubted)}: odometry was believed, and may be what is wrong; look there, and leave"
        " out what is blurred or wrong"
    )


def agreement_is_lost(agreeing: Mask, kept: Mask) -> bool:
    """Return whether more loops were lost than the gate rejects by chance.

    ``agreeing`` (m,) are the loops that agreed with all odometry, and ``kept`` (m,) the edges of a selection
    that trusts less of it. False loops hardly agree with odometry by chance: so many lost ones speak for it.
    """
    lost, count = int(np.count_nonzero(agreeing & ~kept)), int(np.count_nonzero(agreeing))
    return binomial_tail(lost, count, SIGNIFICANCE) <= SIGNIFICANCE


def _span(problem: Problem, doubted: Mask) -> str:
    """Return the poses between which all ``doubted`` edges (m,) lead."""
    first, last = problem.i[doubted], problem.j[doubted]
    before, after = int(np.minimum(first, last).max()), int(np.maximum(first, last).min())
    return f"{problem.name(before)} to {problem.name(after)}"


def _spanning(count: int, low: Index, high: Index, vote: Index) -> Index:
    """Return (count,) the sum of the votes of the edges over the step from each pose to the next."""
    change = np.zeros(count + 1, dtype=np.int64)
    np.add.at(change, low, vote)
    np.add.at(change, high, -vote)
    return np.cumsum(change)[:-1]
