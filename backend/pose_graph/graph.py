"""Pose graph as plain arrays: the content of a g2o file."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from backend.errors import BackendError
from backend.gauge import SYMBOL_SHIFT
from backend.measurements import RelativePose
from backend.wording import counted, either

Array = NDArray[np.float64]

NOT_RIGID = 1e-3
"""Largest deviation of a rotation from an exact one that rounding in a file explains."""
_ZERO_EIGENVALUE = 1e-9
"""Eigenvalue of the information (scaled to unit diagonal) below which it counts as zero: files round."""
MAX_INFORMATION = 1e20
"""Limit of the information (rad^-2, m^-2): doubles do not resolve its deviation of 1e-10 m at 1000 km, and
residuals would be errors of rounding."""
MIN_INFORMATION = 1e-10
"""Information (rad^-2, m^-2) that counts as none: a standard deviation of 100 km, or of 100 000 rad."""


@dataclass(frozen=True)
class EdgeRows:
    """The rows of a file that hold the edges."""

    lines: NDArray[np.int64]
    """(m,) line number of each edge, counted from 1."""
    headings: Array
    """(m,) heading of each planar edge as written, which may be beyond a turn; zero for a spatial edge."""


@dataclass(frozen=True)
class PoseGraph:
    """Vertices and edges; edges refer to vertices by their index in ``ids``."""

    dimension: Literal[2, 3]
    ids: NDArray[np.int64]
    """(n,) number of each vertex in the file, increasing."""
    poses: Array
    """(n, 4, 4) initial poses, NaN where the file has none."""
    i: NDArray[np.int64]
    """(m,)."""
    j: NDArray[np.int64]
    """(m,)."""
    ij_T: Array
    """(m, 4, 4) pose of vertex j relative to vertex i."""
    information: Array
    """(m, d, d) in gtsam's tangent order: (x, y, heading) for d = 3, rotation first for d = 6."""
    fixed: NDArray[np.bool_]
    """(n,) vertices that the file declares fixed."""
    warnings: tuple[str, ...] = ()
    """Messages about lines that were skipped, repaired or dropped when the file was read."""
    dropped: dict[str, int] = field(default_factory=dict)
    """Lines of the file that are not in the graph, counted by reason."""
    rows: EdgeRows | None = None
    """Rows of the edges in their file; None for a graph that was not read from one."""

    @property
    def has_pose(self) -> NDArray[np.bool_]:
        """(n,) True if the vertex has an initial pose."""
        return _finite(self.poses)

    @property
    def is_odometry(self) -> NDArray[np.bool_]:
        """(m,) True if no other vertex number lies between the two that an edge joins.

        The numbers of one robot follow each other, with any step and with gaps. Numbers of gtsam's symbols
        carry the robot's letter in their highest byte; edges between two letters are loops.
        """
        robot = self.ids >> SYMBOL_SHIFT
        return np.asarray((np.abs(self.i - self.j) == 1) & (robot[self.i] == robot[self.j]))

    @property
    def is_repeated(self) -> NDArray[np.bool_]:
        """(m,) True if an edge before it is the same in all digits: two measurements hardly are."""
        order = np.lexsort((self.j, self.i))
        same = np.concatenate([[False], (np.diff(self.i[order]) == 0) & (np.diff(self.j[order]) == 0)])
        # Only edges between the same vertices are compared in full.
        some = order[same | np.append(same[1:], False)]
        matrices = [a.reshape(len(a), a.shape[1] ** 2)[some] for a in (self.ij_T, self.information)]
        figures = np.column_stack([self.i[some], self.j[some], *matrices])
        first = np.unique(figures, axis=0, return_index=True)[1]
        repeated = np.zeros(len(self.i), dtype=bool)
        repeated[np.delete(some, first)] = True
        return repeated

    @property
    def is_rank_deficient(self) -> NDArray[np.bool_]:
        """(m,) True if the information of an edge is only positive semi-definite."""
        size = np.sqrt(np.maximum(np.diagonal(self.information, axis1=1, axis2=2), 0))
        size[size**2 < MIN_INFORMATION] = 1
        # Radians and metres differ in size.
        unit = self.information / size[:, :, None] / size[:, None]
        return np.asarray(np.linalg.eigvalsh(unit)[:, 0] < _ZERO_EIGENVALUE)


def rank_deficient_warning(graph: PoseGraph) -> list[str]:
    """Return one warning about edges with singular information; an empty list if there is none."""
    has_information = (
        np.diagonal(graph.information, axis1=1, axis2=2).max(axis=1, initial=0) > MIN_INFORMATION
    )
    blind = np.flatnonzero(graph.is_rank_deficient & has_information)
    if len(blind) == 0:
        return []
    i, j = graph.ids[graph.i[blind[0]]], graph.ids[graph.j[blind[0]]]
    return [
        f"{len(blind)} of {len(graph.i)} edges "
        f"{either(len(blind), 'tells', 'tell')} nothing about some direction (an eigenvalue of the "
        f"information matrix is zero; the first is {i}-{j}): there other edges decide"
    ]


def repeated_edges(graph: PoseGraph) -> list[str]:
    """Return a sentence about edges that repeat another one; an empty list if there is none.

    They stay, because published graphs hold some, and their optima count each.
    """
    repeated = np.flatnonzero(graph.is_repeated)
    if len(repeated) == 0:
        return []
    i, j = graph.ids[graph.i[repeated[0]]], graph.ids[graph.j[repeated[0]]]
    return [
        f"{counted(len(repeated), 'edge repeats', 'edges repeat')} another one in all digits (the first is "
        f"{i}-{j}): remove copies, as"
        " each counts as a measurement and makes the standard deviations too small"
    ]


def check(graph: PoseGraph) -> None:
    """Validate the arrays of a pose graph. Raises ``BackendError`` with the first invalid vertex or edge.

    `square_roots` detects information that is not positive.
    """
    n, m, d = len(graph.ids), len(graph.i), 3 if graph.dimension == 2 else 6
    shapes = {
        "poses": (graph.poses, (n, 4, 4)),
        "fixed": (graph.fixed, (n,)),
        "j": (graph.j, (m,)),
        "ij_T": (graph.ij_T, (m, 4, 4)),
        "information": (graph.information, (m, d, d)),
    }
    if graph.rows is not None:
        shapes |= {f"rows.{name}": (array, (m,)) for name, array in vars(graph.rows).items()}
    for name, (array, shape) in shapes.items():
        if array.shape != shape:
            raise BackendError(f"{name} has shape {array.shape} instead of {shape}")
    ends = np.concatenate([graph.i, graph.j])
    if ends.dtype.kind not in "iu":
        raise BackendError(f"i and j are of type {ends.dtype}: give whole numbers")
    bad = {
        "names a vertex that is not there": _either(graph, (ends < 0) | (ends >= n)),
        "joins a vertex to itself": graph.i == graph.j,
        "is not a finite rigid transform": ~_rigid(graph.ij_T),
        "has information that is not finite": ~np.isfinite(graph.information.sum(axis=(1, 2))),
        f"has information beyond {MAX_INFORMATION:.0e}": too_certain(graph.information),
    }
    for what, which in bad.items():
        if which.any():
            e = int(np.argmax(which))
            raise BackendError(f"edge {e} ({graph.i[e]}-{graph.j[e]}) {what} ({which.sum()} such); drop it")
    lost = graph.has_pose & ~_rigid(np.where(graph.has_pose[:, None, None], graph.poses, np.eye(4)))
    if lost.any():
        k = int(np.argmax(lost))
        raise BackendError(
            f"the pose of vertex {graph.ids[k]} is not rigid ({lost.sum()} such); mend or remove it"
        )


def too_certain(information: Array) -> NDArray[np.bool_]:
    """Return (m,) whether information matrices (m, d, d) have an element beyond `MAX_INFORMATION`."""
    return np.asarray(np.abs(information).max(axis=(1, 2), initial=0) > MAX_INFORMATION)


def _either(graph: PoseGraph, ends: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return ends[: len(graph.i)] | ends[len(graph.i) :]


def _rigid(T: Array) -> NDArray[np.bool_]:
    with np.errstate(invalid="ignore", over="ignore"):
        R = T[:, :3, :3]
        off = R @ np.swapaxes(R, 1, 2) - np.eye(3)
        turn = np.einsum("na,na->n", np.cross(R[:, 0], R[:, 1]), R[:, 2])
        near = (np.abs(off).max(axis=(1, 2), initial=0) < NOT_RIGID) & (turn > 0)
        return np.asarray(near & np.isfinite(T.sum(axis=(1, 2))))


def _finite(T: Array) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(T).all(axis=(1, 2)))


def build_pose_graph(w_T_b: Array, relative_poses: tuple[RelativePose, ...]) -> PoseGraph:
    """Build a spatial graph from placed keyframes and their relative poses.

    ``w_T_b`` is (n, 4, 4); a keyframe without a finite pose is left out together with its edges.
    """
    placed = _finite(w_T_b)
    number = np.cumsum(placed) - 1
    edges = [e for e in relative_poses if placed[e.i] and placed[e.j]]
    return PoseGraph(
        dimension=3,
        ids=np.flatnonzero(placed),
        poses=w_T_b[placed],
        i=number[np.array([e.i for e in edges], dtype=np.int64)],
        j=number[np.array([e.j for e in edges], dtype=np.int64)],
        ij_T=np.array([e.i_T_j for e in edges]).reshape(-1, 4, 4),
        information=np.linalg.inv(np.array([e.covariance for e in edges]).reshape(-1, 6, 6)),
        fixed=np.zeros(int(placed.sum()), dtype=bool),
    )
