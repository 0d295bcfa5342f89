"""Bayes tree of a linearised graph, and the covariances of the variables in each of its cliques.

The entries of the covariance matrix where the triangular factor is not zero depend on each other alone. The
dense inverse is therefore not needed for variables that share a clique.
Sources: Takahashi, Fagan and Chen 1973; Kaess and Dellaert 2009 (Robotics and Autonomous Systems 57).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtrtri

from backend.errors import GTSAM_ERRORS
from backend.pose_graph.elimination import nested_dissection

Array = NDArray[np.float64]


def bayes_tree(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, by_qr: bool = False
) -> gtsam.GaussianBayesTree | None:
    """Eliminate the linear system at ``values``; None if it is singular.

    QR is used if Cholesky fails, or at once with ``by_qr``. Nested dissection keeps the tree shallow:
    gtsam recurses down it, and `clique_covariances` loses digits from level to level. COLAMD's tree of a
    chain is as deep as the chain.
    """
    try:
        linear = graph.linearize(values)
        order = nested_dissection(linear)
        if not by_qr:
            try:
                return linear.eliminateMultifrontal(order)
            except GTSAM_ERRORS:
                pass
        return linear.eliminateMultifrontal(order, gtsam.EliminateQR)
    except GTSAM_ERRORS:
        return None


@dataclass(frozen=True)
class CliqueCovariance:
    """Joint covariance of a clique's variables."""

    frontals: tuple[int, ...]
    """Variables eliminated in this clique: each is a frontal variable of one clique only."""
    rows: dict[int, range]
    """Rows of each variable in ``matrix``."""
    matrix: Array

    def of(self, *keys: int) -> Array:
        """Return the joint covariance of some variables, in the order of ``keys``."""
        at = np.array([row for key in keys for row in self.rows[key]], dtype=np.intp)
        return np.asarray(self.matrix[at[:, None], at])


_ABOVE_ROOT = CliqueCovariance((), {}, np.zeros((0, 0)))


def clique_covariances(tree: gtsam.GaussianBayesTree, values: gtsam.Values) -> Iterator[CliqueCovariance]:
    """Yield the covariance of each clique of the tree of ``values``, parents before their children.

    A clique that is singular, and all below it, are NaN. Errors of rounding may double from a clique to its
    children; over the few levels of a shallow tree that is harmless, over the 160 of a chain it is not.
    """
    children = _children(tree, values)
    waiting = [(root, _ABOVE_ROOT) for root in children[None]]
    while waiting:
        clique, parent = waiting.pop()
        found = clique.covariance(parent)
        yield found
        waiting += [(child, found) for child in children[clique.frontals[0]]]


@dataclass(frozen=True)
class _Clique:
    """Frontal variables x given the separator s: R x + S s = noise of unit covariance."""

    frontals: tuple[int, ...]
    separator: tuple[int, ...]
    size: dict[int, int]
    R: Array
    S: Array

    @staticmethod
    def of(conditional: gtsam.GaussianConditional, size: dict[int, int]) -> _Clique:
        """Read a conditional; ``size`` holds the dimension of each variable."""
        keys, R = conditional.keys(), conditional.R()
        count, rows = 0, 0
        while rows < len(R):
            rows += size[keys[count]]
            count += 1
        return _Clique(tuple(keys[:count]), tuple(keys[count:]), size, R, conditional.S())

    def covariance(self, parent: CliqueCovariance) -> CliqueCovariance:
        """Return the covariance from that of the parent, which has the whole separator.

        With B = -R^-1 S, cov(x, s) = B cov(s) and cov(x) = (R'R)^-1 + B cov(s) B'.
        """
        above = parent.of(*self.separator)
        n = len(self.R)
        root, singular = dtrtri(self.R)
        if singular:
            root = np.full_like(self.R, np.nan)
        B = -root @ self.S
        matrix = np.empty((n + len(above),) * 2)
        matrix[n:, n:] = above
        matrix[:n, n:] = B @ above
        matrix[n:, :n] = matrix[:n, n:].T
        matrix[:n, :n] = root @ root.T + matrix[:n, n:] @ B.T
        rows, end = {}, 0
        for key in (*self.frontals, *self.separator):
            begin, end = end, end + self.size[key]
            rows[key] = range(begin, end)
        return CliqueCovariance(self.frontals, rows, matrix)


def _children(tree: gtsam.GaussianBayesTree, values: gtsam.Values) -> dict[int | None, list[_Clique]]:
    """Return the cliques by their parent's first frontal variable, roots by None."""
    size = values.dims()
    seen: set[int] = set()
    children: dict[int | None, list[_Clique]] = defaultdict(list)
    for key in size:
        if key in seen:
            continue
        node = tree[key]
        clique = _Clique.of(node.conditional(), size)
        seen.update(clique.frontals)
        parent = None if node.isRoot() else node.parent().conditional().firstFrontalKey()
        children[parent].append(clique)
    return children
