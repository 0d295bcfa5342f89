"""Initial guesses: a spanning tree of the most certain edges, or the chordal relaxation of all edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array
from scipy.sparse.csgraph import dijkstra, minimum_spanning_tree

from backend import se3
from backend.pose_graph.linear import cholesky

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def spanning_tree(n: int, i: Index, j: Index, ij_T: Array, cost: Array, root: int, w_T_root: Array) -> Array:
    """Compose poses from the root along the shortest paths. Returns (n, 4, 4); unreachable poses are NaN.

    ``cost`` (m,) > 0 is an edge's variance: the shortest-path tree gives each pose the least accumulated
    variance.
    """
    w_T = np.full((n, 4, 4), np.nan)
    w_T[root] = w_T_root
    links, code, order = _links(n, i, j, cost)
    distance, parent = dijkstra(links, directed=False, indices=np.array(root), return_predecessors=True)
    reached = np.flatnonzero(np.isfinite(distance) & (np.arange(n) != root))
    reached = reached[np.argsort(distance[reached], kind="stable")]
    above = parent[reached].astype(np.int64)
    edge = order[np.searchsorted(code, np.minimum(reached, above) * n + np.maximum(reached, above))]
    forward = i[edge] == above
    step = np.where(forward[:, None, None], ij_T[edge], se3.inverse(ij_T[edge]))
    for k, p, T in zip(reached.tolist(), above.tolist(), step, strict=True):
        w_T[k] = w_T[p] @ T
    return se3.orthonormal(w_T)


def tree_edges(n: int, i: Index, j: Index, cost: Array) -> Index:
    """Return the edges of the minimum spanning tree (forest) for ``cost`` (m,) > 0."""
    links, code, order = _links(n, i, j, cost)
    tree = minimum_spanning_tree(links).tocoo()
    used = np.minimum(tree.row, tree.col).astype(np.int64) * n + np.maximum(tree.row, tree.col)
    return order[np.searchsorted(code, used)]


def _links(n: int, i: Index, j: Index, cost: Array) -> tuple[csr_array, Index, Index]:
    """Return costs as a sparse matrix, the sorted codes of its entries, and the edge of each entry."""
    low, high = np.minimum(i, j), np.maximum(i, j)
    order = np.lexsort((cost, high, low))
    code = low[order] * n + high[order]
    if len(order):
        # Keep the cheapest of parallel edges: a sparse matrix would add them.
        first = np.concatenate([[True], code[1:] != code[:-1]])
        order, code = order[first], code[first]
    return csr_array((cost[order], (low[order], high[order])), shape=(n, n)), code, order


def chordal(
    i: Index, j: Index, ij_T: Array, kappa: Array, tau: Array, w_T_root: Array, n: int, planar: bool
) -> Array | None:
    """Solve for rotations, then for positions, by linear least squares; pose 0 is ``w_T_root``.

    ``kappa`` and ``tau`` (m,) are the weights of rotation and translation. The graph must be connected.
    Returns (n, 4, 4), or None if the linear system is singular.
    Source: Martinec and Pajdla 2007, section 3; Carlone et al. 2015 (ICRA), section III-B.
    """
    d = 2 if planar else 3
    R_ij = ij_T[:, :d, :d]
    U = _laplacian_solve(i, j, kappa, np.swapaxes(R_ij, 1, 2), w_T_root[:d, :d].T, np.zeros((n * d, d)), n)
    if U is None:
        return None
    w_T = np.tile(np.eye(4), (n, 1, 1))
    w_T[:, :d, :d] = se3.nearest_rotations(np.swapaxes(U.reshape(n, d, d), 1, 2))
    step = tau[:, None] * np.einsum("mab,mb->ma", w_T[i, :3, :3], ij_T[:, :3, 3])
    pull = np.zeros((n, 3))
    np.add.at(pull, j, step)
    np.add.at(pull, i, -step)
    t = _laplacian_solve(i, j, tau, np.ones((len(i), 1, 1)), w_T_root[None, :3, 3], pull, n)
    if t is None:
        return None
    w_T[:, :3, 3] = t
    return w_T


def _laplacian_solve(
    i: Index, j: Index, weight: Array, block: Array, first: Array, rhs: Array, n: int
) -> Array | None:
    """Minimise sum weight |x_j - block x_i - ...|^2 with x_0 = ``first``; ``rhs`` (n d, c) holds the
    constant part."""
    d = block.shape[1]
    degree = np.bincount(i, weight, n) + np.bincount(j, weight, n)
    a, b = np.meshgrid(np.arange(d), np.arange(d), indexing="ij")
    row = (j[:, None, None] * d + a).ravel()
    column = (i[:, None, None] * d + b).ravel()
    value = (-weight[:, None, None] * block).ravel()
    diagonal = np.arange(n * d)
    H = csc_array(
        (
            np.concatenate([value, value, np.repeat(degree, d)]),
            (np.concatenate([row, column, diagonal]), np.concatenate([column, row, diagonal])),
        ),
        shape=(n * d, n * d),
    )
    right = rhs[d:] - H[d:, :d] @ first
    if n == 1:
        return first
    try:
        factor = cholesky(csc_array(H[d:, d:]))
    except RuntimeError:
        return None
    x = np.vstack([first, factor.solve(np.asarray(right))])
    return x if np.isfinite(x).all() else None
