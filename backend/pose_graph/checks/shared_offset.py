"""Score test of a common offset of the accepted loops that end in one stretch of the path.

Where a floor repeats, all loops between two stretches may be wrong by the same transform. They agree with
each other, and the odometry before and behind the stretch takes the error in many small shares: each edge
passes its gate, and the chi-square test of the whole graph passes. The common offset is one parameter of all
those loops. The test asks whether the chi-square would fall if it were free, for every stretch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from backend import se3
from backend.pose_graph.checks.score_test import ChiSquareModel, LinearisedEdges, by_end
from backend.pose_graph.chi_square import SIGNIFICANCE, chi_square_gate
from backend.pose_graph.problem import Problem
from backend.quantiles import chi_square_limit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_MOST_BLOCKS = 64
"""Pieces of which stretches are made: with more, the test takes longer than the solve of a large graph."""
_UNCHECKED = 1e-6
"""Share of the loops' own information that other edges must leave; below it rounding errors decide."""


def shared_offset(offsets: LoopOffsets, test: ChiSquareModel | None) -> list[str]:
    """Return a sentence if a common offset of some kept loops of a part explains residuals.

    ``test`` is that of the columns of ``offsets``, or None if the part cannot be tested.
    """
    found = None if test is None else offsets.most_likely(test)
    if found is None or not found.is_false:
        return []
    part = offsets.linearised.problem
    ends = np.maximum(part.i, part.j)[found.loops]
    return [
        f"{len(found.loops)} loops that end at {part.name(ends.min())} to {part.name(ends.max())}"
        f" disagree with the rest by one common offset of about {found.length:.2g} {part.length_unit} and"
        f" {found.degrees:.2g} deg (chi-square {found.gain:.4g} lower with it): where a floor repeats"
        " they may be false together, or the odometry beside them is wrong; check what those loops show"
    ]


@dataclass(frozen=True)
class SharedOffset:
    """Common offset of a stretch of loops that lowers the chi-square most."""

    loops: Index
    """(k,) edges."""
    gain: float
    """Fall of the chi-square if the offset is free."""
    limit: float
    """Gain that chance exceeds at most once in a thousand graphs, whatever the stretch."""
    whitened: float
    """Mean squared norm of the offset, in units of the noise of a single one of the loops."""
    gate: float
    """Squared norm that the noise of a loop exceeds once in a thousand."""
    length: float
    """Root mean square by which the loops' ends move, in the unit of the graph."""
    degrees: float

    @property
    def is_false(self) -> bool:
        """Whether the loops contradict the rest, and a loop with that offset is a false one.

        Less than the noise of single loops may be an error that they have in common.
        """
        return self.gain > self.limit and self.whitened > self.gate


@dataclass(frozen=True)
class LoopOffsets:
    """Offsets of blocks of loops, in the order of their later ends; a stretch is some successive blocks."""

    linearised: LinearisedEdges
    blocks: list[Index]
    """Edges of each block."""
    moved: Array
    """(m, d, d) how the pose at the later end moves with an offset."""
    effect: Array
    """(m, d, d) derivatives of the whitened residuals by an offset."""

    @staticmethod
    def of(linearised: LinearisedEdges) -> LoopOffsets:
        """Divide the loops of a part into blocks."""
        problem, w_T = linearised.problem, linearised.w_T
        later = np.maximum(problem.i, problem.j)
        loops = np.flatnonzero(~problem.trusted)
        loops = loops[np.argsort(later[loops], kind="stable")]
        blocks = np.array_split(loops, min(_MOST_BLOCKS, len(loops)))
        moved = _moved(problem, w_T, later)
        of_later = np.where((later == problem.j)[:, None, None], *reversed(by_end(problem, w_T)))
        return LoopOffsets(linearised, blocks, moved, of_later @ moved)

    @property
    def columns(self) -> csc_array:
        """Derivatives (m d, blocks d) of the residuals by one offset for each block."""
        m, d, _ = self.effect.shape
        loops = np.concatenate(self.blocks)
        number = np.repeat(np.arange(len(self.blocks)), [len(block) for block in self.blocks])
        shape = (len(loops), d, d)
        row = np.broadcast_to((loops * d)[:, None, None] + np.arange(d)[:, None], shape)
        column = np.broadcast_to((number * d)[:, None, None] + np.arange(d), shape)
        entries = self.effect[loops].ravel(), (row.ravel(), column.ravel())
        return csc_array(entries, shape=(m * d, len(self.blocks) * d))

    def most_likely(self, test: ChiSquareModel) -> SharedOffset:
        """Return the offset of the stretch that explains most; ``test`` is that of the columns."""
        blocks, moved, effect = self.blocks, self.moved, self.effect
        problem, d = self.linearised.problem, self.linearised.problem.dof
        begin, end = np.triu_indices(len(blocks) + 1, 1)
        score, information = _of_stretches(test, begin, end, d)
        own = np.concatenate([[0], np.cumsum([(effect[block] ** 2).sum() for block in blocks])])
        gains, offsets = _gains(score, information, _UNCHECKED * (own[end] - own[begin]))
        best = int(np.argmax(gains))
        found = np.concatenate(blocks[begin[best] : end[best]])
        # Covariances that are too large are not narrowed: what they allow is no contradiction.
        stated = min(self.linearised.noise_scale, 1.0) ** 2
        length, degrees = _sizes(problem, moved[found] @ offsets[best])
        return SharedOffset(
            loops=np.sort(found),
            gain=stated * min(float(gains[best]), test.statistic),
            limit=chi_square_limit(SIGNIFICANCE / len(begin), d),
            whitened=float(((effect[found] @ offsets[best]) ** 2).sum(axis=1).mean()),
            gate=chi_square_gate(d),
            length=length,
            degrees=degrees,
        )


def _of_stretches(test: ChiSquareModel, begin: Index, end: Index, d: int) -> tuple[Array, Array]:
    """Return score (k, d) and information (k, d, d) of an offset of the blocks ``begin`` to ``end``."""
    n = len(test.score) // d
    sums = np.zeros((n + 1, d))
    sums[1:] = np.cumsum(test.score.reshape(n, d), axis=0)
    cells = np.zeros((n + 1, n + 1, d, d))
    cells[1:, 1:] = test.information.reshape(n, d, n, d).swapaxes(1, 2).cumsum(axis=0).cumsum(axis=1)
    information = cells[end, end] - cells[begin, end] - cells[end, begin] + cells[begin, begin]
    return sums[end] - sums[begin], information


def _sizes(problem: Problem, tangent: Array) -> tuple[float, float]:
    """Return the root mean square length and angle (degrees) of small transforms (k, d)."""
    turn, move = (tangent[:, 2:], tangent[:, :2]) if problem.dof == 3 else (tangent[:, :3], tangent[:, 3:])
    length, angle = (float(np.sqrt((each**2).sum(axis=1).mean())) for each in (move, turn))
    return length, float(np.degrees(angle))


def _moved(problem: Problem, w_T: Array, end: Index) -> Array:
    """Return (m, d, d) how the poses at some ends of the edges move with a transform about the middle."""
    middle = np.eye(4)
    middle[:3, 3] = w_T[:, :3, 3].mean(axis=0)
    return problem.adjoint(se3.inverse(w_T[end]) @ middle)


def _gains(score: Array, information: Array, least: Array) -> tuple[Array, Array]:
    """Return the falls of the chi-square (k,) by the best offsets (k, d).

    Directions whose information is below ``least`` (k,) are not checked by other edges, and are left out.
    """
    values, axes = np.linalg.eigh(information)
    checked = values > least[:, None]
    along = np.einsum("kab,ka->kb", axes, score) / np.where(checked, values, 1.0) * checked
    return (along**2 * values).sum(axis=1), -np.einsum("kab,kb->ka", axes, along)
