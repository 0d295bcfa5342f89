"""Rejected rows of a file that agree with the others after one typical mistake is undone.

Each row is read again as it would be without each of the mistakes, and compared with the solution of the kept
edges. A false loop may come to agree by chance, and the more readings are tried, the likelier: all readings
of all rejected rows are judged together at one false discovery rate. Nothing is corrected, only told.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend import se3
from backend.pose_graph.checks.solved_parts import posterior_samples, solved_parts
from backend.pose_graph.chi_square import chi_square_gate
from backend.pose_graph.graph import PoseGraph
from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.agreement import TAIL_FACTOR, sharp_agreements
from backend.pose_graph.selection.null_loops import NullLoops
from backend.pose_graph.selection.places import ROW_LENGTH, place_pairs
from backend.pose_graph.selection.prediction import innovations, noise_scale
from backend.pose_graph.solution import RowMistake, Solution
from backend.wording import counted

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

FALSE_DISCOVERY_RATE = 0.05
"""Share of the named rows that agree by chance, at the level that is usual for a finding. It is above that of
the selection, since a person looks at a named row, and nothing is built on it."""
_MOST_LISTED = 5
_AXES = "xyz"


@dataclass(frozen=True)
class _Reading:
    """A reading of rows without one mistake."""

    mistake: str
    """Name of the mistake, as it stands in summary.json."""
    pose: Callable[[Array, Array], Array]
    """Function from relative poses (k, 4, 4) and headings (k,) as written to relative poses."""
    ends_exchanged: bool = False


def _readings(dimension: int) -> list[_Reading]:
    common = [
        _Reading("opposite sign of the turn", _turned_back),
        _Reading("vertices exchanged", lambda T, _: T, ends_exchanged=True),
        *(_axes_exchanged(a, b) for a in range(dimension) for b in range(a + 1, dimension)),
        *(_times(a, -1.0, f"opposite sign of {_AXES[a]}") for a in range(dimension)),
        *(_times(a, 10.0, f"{_AXES[a]} ten times too small") for a in range(dimension)),
        *(_times(a, 0.1, f"{_AXES[a]} ten times too large") for a in range(dimension)),
    ]
    if dimension == 3:
        return [*common, _Reading("quaternion with its real part first", _real_part_first)]
    return [
        *common,
        _turned("turn in degrees", np.radians),
        _turned("turn ten times too small", lambda heading: 10 * heading),
        _turned("turn ten times too large", lambda heading: heading / 10),
    ]


def _turned_to(T: Array, R: Array) -> Array:
    T = T.copy()
    T[:, :3, :3] = R
    return T


def _turned_back(T: Array, _: Array) -> Array:
    return _turned_to(T, np.swapaxes(T[:, :3, :3], 1, 2))


def _axes_exchanged(a: int, b: int) -> _Reading:
    def pose(T: Array, _: Array) -> Array:
        T = T.copy()
        T[:, [a, b], 3] = T[:, [b, a], 3]
        return T

    return _Reading(f"{_AXES[a]} and {_AXES[b]} exchanged", pose)


def _times(axis: int, factor: float, mistake: str) -> _Reading:
    def pose(T: Array, _: Array) -> Array:
        T = T.copy()
        T[:, axis, 3] *= factor
        return T

    return _Reading(mistake, pose)


def _turned(mistake: str, corrected: Callable[[Array], Array]) -> _Reading:
    def pose(T: Array, heading: Array) -> Array:
        return se3.from_planar(np.column_stack([T[:, :2, 3], corrected(heading)]))

    return _Reading(mistake, pose)


def _real_part_first(T: Array, _: Array) -> Array:
    quaternion = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    # (a, b, c, d) was read as (x, y, z, w), and is meant as (w, x, y, z).
    return _turned_to(T, Rotation.from_quat(np.roll(quaternion, -1, axis=1)).as_matrix())


def row_mistakes(graph: PoseGraph, problem: Problem, solution: Solution) -> tuple[RowMistake, ...]:
    """Return the rejected edges that one mistake of their rows explains, in the order of the graph.

    ``problem`` is that of the graph.
    """
    found: list[RowMistake] = []
    for part, w_T, inside in solved_parts(problem, solution, solution.edge_informative):
        edges = np.flatnonzero(inside)
        kept = solution.edge_kept[edges]
        if kept.all():
            continue
        for e, mistake, before, after in _explained(part, _headings(graph)[edges], kept, w_T):
            row = edges[e]
            line = None if graph.rows is None else int(graph.rows.lines[row])
            ends = int(graph.ids[graph.i[row]]), int(graph.ids[graph.j[row]])
            found.append(RowMistake(line, *ends, mistake, before, after))
    return tuple(found)


def _headings(graph: PoseGraph) -> Array:
    if graph.rows is not None:
        return graph.rows.headings
    return np.zeros(len(graph.i)) if graph.dimension == 3 else se3.to_planar(graph.ij_T)[:, 2]


def _explained(part: Problem, headings: Array, kept: Mask, w_T: Array) -> list[tuple[int, str, float, float]]:
    """Return edge, mistake, and innovations in sigmas as written and as corrected, of one component."""
    samples = posterior_samples(part, kept, w_T)
    if samples is None:
        return []
    rejected, readings = np.flatnonzero(~kept), _readings(part.dimension)
    scale, count = noise_scale(part, kept, w_T), len(rejected)
    before = innovations(part, w_T, samples, rejected, scale).sigma()
    place, loops = place_pairs(part.i, part.j, ROW_LENGTH), np.flatnonzero(~part.trusted)
    null_loops = NullLoops.of(part, loops, place[loops])
    pass_probability = null_loops.chance(w_T, samples, scale)
    sigma, chance = np.empty((2, len(readings), count))
    for k, reading in enumerate(readings):
        again = _read_again(part, headings, rejected, reading)
        after = innovations(again, w_T, samples, np.arange(count), scale)
        sigma[k], chance[k] = after.sigma(), pass_probability.of(after.log_pass_probability())
    # The row as written is an outlier of a noise with heavy tails, or the mistake. As it may be the former,
    # the mistake must be likelier than chance makes the best of all readings.
    gain = (before / TAIL_FACTOR) ** 2 - sigma**2
    agrees = sigma**2 <= chi_square_gate(part.dof)
    agrees &= gain > 2 * np.log(sigma.size / FALSE_DISCOVERY_RATE)
    each = np.arange(sigma.size)
    agrees = sharp_agreements(chance.ravel(), agrees.ravel(), each, FALSE_DISCOVERY_RATE).reshape(sigma.shape)
    explained = []
    for k in np.flatnonzero(agrees.any(axis=0)).tolist():
        able = [h for h in np.argsort(sigma[:, k]).tolist() if agrees[h, k]]
        mistake = ", or ".join(readings[h].mistake for h in able)
        explained.append((int(rejected[k]), mistake, float(before[k]), float(sigma[able[0], k])))
    return explained


def _read_again(part: Problem, headings: Array, rejected: Index, reading: _Reading) -> Problem:
    """Return the problem of the rejected edges alone, without the mistake."""
    i, j = part.i[rejected], part.j[rejected]
    return replace(
        part,
        i=j if reading.ends_exchanged else i,
        j=i if reading.ends_exchanged else j,
        ij_T=reading.pose(part.ij_T[rejected], headings[rejected]),
        sqrt_information=part.sqrt_information[rejected],
        trusted=np.zeros(len(rejected), dtype=bool),
    )


def mistake_warnings(found: tuple[RowMistake, ...]) -> list[str]:
    """Return a sentence for each kind of mistake, with the rows that it explains."""
    sentences = []
    for mistake in dict.fromkeys(each.mistake for each in found):
        rows = [each for each in found if each.mistake == mistake]
        named = ", ".join(_named(row) for row in rows[:_MOST_LISTED])
        more = f" and {len(rows) - _MOST_LISTED} more" if len(rows) > _MOST_LISTED else ""
        sentences.append(
            f"{counted(len(rows), 'rejected edge')} would agree with the others but for one mistake in rows"
            f" ({mistake}): {named}{more}; check these rows of the file, as nothing was corrected"
        )
    return sentences


def _named(row: RowMistake) -> str:
    where = "" if row.line is None else f"line {row.line}, "
    sigma = f"{row.sigma:.3g} sigma as written, {row.corrected_sigma:.2g} without the mistake"
    return f"{where}{row.first}-{row.second} ({sigma})"
