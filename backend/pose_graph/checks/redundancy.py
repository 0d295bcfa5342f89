"""Redundancy of a solved pose graph: cycles of accepted edges, and the size of their residuals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.gauge import format_keys
from backend.pose_graph.bridges import find_bridges, reached
from backend.pose_graph.chi_square import ChiSquare
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.places import ROW_LENGTH, place_pairs
from backend.pose_graph.solution import Solution
from backend.wording import counted, either

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


def unchecked_components(problem: Problem, solution: Solution) -> list[str]:
    """Return a sentence for each connected component with accepted edges that no other edge checks.

    These are a whole component whose edges form a tree, and poses that a single loop joins to the rest. A
    tree fits its edges exactly, whether they are right or wrong. Parallel edges count once: they check each
    other, and nothing else. Two fixed vertices also check the edges between them.
    """
    component = solution.component
    fixed = np.bincount(
        [component[a.k] for a in problem.unary_factors if component[a.k] >= 0], minlength=len(component) + 1
    )
    sentences = []
    for number in range(int(component.max(initial=-1)) + 1):
        members = np.flatnonzero(component == number)
        inside = component[problem.i] == number
        if len(members) < 2 or fixed[number] > 1:
            continue
        ends, trusted = _simple_edges(problem, inside & solution.edge_kept)
        if len(ends) < len(members):
            rejected = int((inside & ~solution.edge_kept).sum())
            sentences.append(_sentence(problem, members.tolist(), rejected, inside & solution.edge_kept))
            continue
        sentences += _bridge_sentences(problem, ends, trusted)
        left_out = inside & problem.trusted & ~solution.edge_kept & solution.edge_informative
        sentences += _unchecked_odometry_sentence(problem, ends, left_out)
        loops = inside & ~problem.trusted & solution.edge_informative
        sentences += _one_place_sentence(problem, loops, solution.edge_kept)
    return sentences


def _simple_edges(problem: Problem, kept: Mask) -> tuple[Index, Mask]:
    """Return the ends (e, 2) of the kept edges, and which are trusted; parallel edges are one.

    It is trusted if one of them is.
    """
    ends = np.sort(np.column_stack([problem.i, problem.j])[kept], axis=1)
    simple, number = np.unique(ends, axis=0, return_inverse=True)
    trusted = np.zeros(len(simple), dtype=bool)
    trusted[number[problem.trusted[kept]]] = True
    return simple, trusted


def _bridge_sentences(problem: Problem, ends: Index, trusted: Mask) -> list[str]:
    """Return a sentence about loops whose removal would cut the graph in two; a tail of odometry is none."""
    bridges = find_bridges(ends, problem.count)
    bridges = bridges[~trusted[bridges]]
    if len(bridges) == 0:
        return []
    i, j = ends[bridges[0]].tolist()
    loop = f"{problem.name(i)} to {problem.name(j)}"
    if len(bridges) > 1:
        return [f"{len(bridges)} loops (the first is {loop}) each join a part that no other edge checks"]
    rest = np.delete(ends, bridges[0], axis=0)
    smaller = min((reached(rest, end, problem.count) for end in (i, j)), key=len)
    who = format_keys(smaller.tolist(), problem.name)
    return [f"one loop alone ({loop}) joins {who} to the rest, and no other edge checks it"]


def _unchecked_odometry_sentence(problem: Problem, ends: Index, left_out: Mask) -> list[str]:
    """Return a sentence if odometry is only checked by odometry that was ``left_out`` (m,).

    Either may then be the wrong one: the fit is the same, and the poses between them differ. Such edges are
    bridges of the kept graph, and none of the graph with the edges that were left out.
    """
    if not left_out.any():
        return []
    rejected = np.column_stack([problem.i, problem.j])[left_out]
    whole = np.unique(np.concatenate([ends, np.sort(rejected, axis=1)]), axis=0)
    still = set(map(tuple, whole[find_bridges(whole, problem.count)].tolist()))
    alone = [(i, j) for i, j in ends[find_bridges(ends, problem.count)].tolist() if (i, j) not in still]
    if not alone:
        return []
    (i, j), (k, m) = alone[0], rejected[0].tolist()
    return [
        f"{counted(len(alone), 'edge')} (the first is {problem.name(i)} to {problem.name(j)}) "
        f"{either(len(alone), 'is', 'are')} checked only by"
        f" odometry that was rejected (the first is {problem.name(k)} to {problem.name(m)}): either may be"
        " what is wrong"
    ]


def _one_place_sentence(problem: Problem, loops: Mask, kept: Mask) -> list[str]:
    """Return a sentence if all loops but those between one pair of places were rejected."""
    place = place_pairs(problem.i[loops], problem.j[loops], ROW_LENGTH)
    accepted, rejected = (len(np.unique(place[which])) for which in (kept[loops], ~kept[loops]))
    if accepted != 1 or rejected == 0:
        return []
    e = int(np.argmax(loops & kept))
    ends = f"{problem.name(problem.i[e])} and {problem.name(problem.j[e])}"
    count = int((~kept[loops]).sum())
    return [
        f"only loops near {ends} were kept, and "
        f"{counted(count, 'loop elsewhere was', 'loops elsewhere were')} rejected: odometry alone decided"
        " between them; check both"
    ]


def _sentence(problem: Problem, members: list[int], rejected: int, kept: Mask) -> str:
    who = format_keys(members, problem.name)
    base = "odometry alone" if problem.trusted[kept].all() else "a tree of edges alone"
    why = f": {counted(rejected, 'edge was', 'edges were')} rejected, and" if rejected else ", and"
    do = "add loops, or check the rejected edges and their covariances" if rejected else "add loops"
    return f"{who} rest on {base}{why} no loop is left that checks it; {do}"


def rejected_odometry_warning(problem: Problem, solution: Solution) -> list[str]:
    """Return one warning about steps of odometry that were rejected; an empty list if there is none."""
    wrong = np.flatnonzero(problem.trusted & ~solution.edge_kept & solution.edge_informative)
    if len(wrong) == 0:
        return []
    i, j = problem.i[wrong[0]], problem.j[wrong[0]]
    return [
        f"{counted(len(wrong), 'edge of odometry contradicts', 'edges of odometry contradict')} the loops "
        "over "
        f"{either(len(wrong), 'it and is', 'them and are')} left out (the first is"
        f" {problem.name(i)} to {problem.name(j)}); check their lines in the file"
    ]


def small_residuals_warning(problem: Problem, solution: Solution) -> list[str]:
    """Return one warning if the chi-square is far below its degrees of freedom; else an empty list."""
    kept = solution.edge_kept
    placed = int((solution.component >= 0).sum()) - (int(solution.component.max(initial=-1)) + 1)
    dof = problem.dof * (int(kept.sum()) - placed)
    statistic = float((solution.edge_residual[kept] ** 2).sum())
    if not ChiSquare(statistic, dof, np.inf).is_far_below:
        return []
    return [
        f"the edges agree far better than their covariances state (chi-square {statistic:.3g} for {dof}"
        " degrees of freedom): the covariances are too large, and so are the standard deviations given here,"
        " or the edges were computed from each other"
    ]
