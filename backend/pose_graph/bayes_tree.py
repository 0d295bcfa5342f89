"""Bayes tree of a linearised graph, and the covariances of the variables in each of its cliques.

The entries of the covariance matrix where the triangular factor is not zero depend on each other alone. The
dense inverse is therefore not needed for variables that share a clique.
Sources: Takahashi, Fagan and Chen 1973; Kaess and Dellaert 2009 (Robotics and Autonomous Systems 57).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.errors import GTSAM_ERRORS
from backend.pose_graph.elimination import nested_dissection
from backend.pose_graph.information_root import covariance_root, joint_root, marginal_root

Array = NDArray[np.float64]

_DEEP = 5_000
"""Number of keys above which nested dissection is used: gtsam recurses down the tree, and COLAMD's tree is as
deep as a chain."""


def bayes_tree(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, by_qr: bool = False
) -> gtsam.GaussianBayesTree | None:
    """Eliminate the linear system at ``values``; None if it is singular.

    QR is used if Cholesky fails, or at once with ``by_qr``.
    """
    try:
        linear = graph.linearize(values)
        order = (
            nested_dissection(linear)
            if values.size() > _DEEP
            else gtsam.Ordering.ColamdGaussianFactorGraph(linear)
        )
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
    """Rows of each variable in the roots."""
    information_root: Array
    covariance_root: Array

    def of(self, *keys: int) -> Array:
        """Return the joint covariance of some variables, in the order of ``keys``."""
        V = self.covariance_root[self.places(keys)]
        return np.asarray(V @ V.T)

    def places(self, keys: Sequence[int]) -> NDArray[np.intp]:
        """Return the rows of some variables, in the order of ``keys``."""
        return np.array([row for key in keys for row in self.rows[key]], dtype=np.intp)


_ABOVE_ROOT = CliqueCovariance((), {}, np.zeros((0, 0)), np.zeros((0, 0)))


def clique_covariances(tree: gtsam.GaussianBayesTree, values: gtsam.Values) -> Iterator[CliqueCovariance]:
    """Yield the covariance of each clique of the tree of ``values``, parents before their children.

    A clique that is singular, and all below it, are NaN.
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
        """Return the covariance from that of the parent, which has the whole separator."""
        above = marginal_root(parent.information_root, parent.places(self.separator))
        W = joint_root(self.R, self.S, above)
        rows, end = {}, 0
        for key in (*self.frontals, *self.separator):
            begin, end = end, end + self.size[key]
            rows[key] = range(begin, end)
        return CliqueCovariance(self.frontals, rows, W, covariance_root(W))


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
