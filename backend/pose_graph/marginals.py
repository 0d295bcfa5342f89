"""Covariances of poses at a solution, never an exception for a part that is not determined."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.errors import GTSAM_ERRORS
from backend.gauge import graph_components
from backend.pose_graph.elimination import nested_dissection
from backend.se3 import PLANAR

Array = NDArray[np.float64]

_DEEP = 5_000
"""Keys from which nested dissection orders: shortcuts recurse down the tree, and COLAMD's is as deep as a
chain."""

_NO_KNOWLEDGE = 1e10
"""Variance (rad^2, m^2) above which rounding, not measurement, speaks."""


def pose_covariances(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: Sequence[int]) -> Array:
    """Marginal covariances of poses. Returns (n, 6, 6), rotation first, right perturbation, rad and m.

    Planar poses are embedded with zeros for what cannot move. NaN where a pose is not determined: the parts
    of the graph that are, are still answered.
    """
    out = np.full((len(keys), 6, 6), np.nan)
    tree = bayes_tree(graph, values)
    if tree is not None and not graph_components(graph).floating:
        _fill(out, tree, keys, range(len(keys)))
        return out
    for part in graph_components(graph).parts:
        inside = set(part)
        mine = [k for k, key in enumerate(keys) if key in inside]
        tree = bayes_tree(*_part(graph, values, inside)) if mine else None
        if tree is not None and part not in graph_components(graph).floating:
            _fill(out, tree, keys, mine)
    return out


def bayes_tree(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.GaussianBayesTree | None:
    """The linear system at ``values``, eliminated; None where it is singular."""
    try:
        linear = graph.linearize(values)
        deep = values.size() > _DEEP
        order = nested_dissection(linear) if deep else gtsam.Ordering.OrderingType.COLAMD
        try:
            return linear.eliminateMultifrontal(order)
        except GTSAM_ERRORS:
            return linear.eliminateMultifrontal(order, gtsam.EliminateQR)
    except GTSAM_ERRORS:
        return None


def _part(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: set[int]
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    factors = gtsam.NonlinearFactorGraph()
    for factor in (graph.at(k) for k in range(graph.size())):
        if factor is not None and set(factor.keys()) <= keys:
            factors.push_back(factor)
    rest = gtsam.Values(values)
    for key in values.keys():  # noqa: SIM118
        if key not in keys:
            rest.erase(key)
    return factors, rest


def _fill(out: Array, tree: gtsam.GaussianBayesTree, keys: Sequence[int], which: Sequence[int]) -> None:
    for k in which:
        try:
            covariance = tree.marginalCovariance(keys[k])
        except GTSAM_ERRORS:
            continue
        variance = np.diag(covariance)
        if not (np.isfinite(covariance).all() and (variance >= 0).all() and (variance < _NO_KNOWLEDGE).all()):
            continue
        if len(covariance) == 6:
            out[k] = covariance
        else:
            out[k] = 0
            out[k][np.ix_(PLANAR, PLANAR)] = covariance


def joint_covariances(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: Sequence[int], common: int
) -> Array:
    """Joint marginals of each pose with one common variable, (n, 6 + d, 6 + d), pose first; NaN: singular.

    gtsam would walk through its tree for each of them, and keep what it met there: of a long flight more than
    it takes to solve it. Here one walk goes from the root, the common variable, down to all of them.
    """
    d = len(values.atVector(common))
    out = np.full((len(keys), 6 + d, 6 + d), np.nan)
    if common not in graph.keys():  # noqa: SIM118
        return out  # gtsam ends the interpreter where an ordering names what no factor does
    linear, row = graph.linearize(values), {key: k for k, key in enumerate(keys)}
    ordering = nested_dissection(linear, common)
    for eliminate in ((), (gtsam.EliminateQR,)):  # Cholesky by default
        try:
            for key, joint in _joints(linear.eliminateSequential(ordering, *eliminate), row.keys()):
                out[row[key]] = joint
        except (*GTSAM_ERRORS, np.linalg.LinAlgError):
            out[:] = np.nan
            continue
        break
    return out


def _joints(net: gtsam.GaussianBayesNet, asked: Container[int]) -> Iterator[tuple[int, Array]]:
    """Of each variable asked for: its key, and its joint covariance with the one eliminated last.

    An eliminated variable is a function of those that it was tied to then, x = B s, plus what is uncertain
    while they are held: cov(x) = (R'R)^-1 + B cov(s) B', cov(x, s) = B cov(s). The first of them that is
    eliminated next was tied to all the others, so that cov(s) is a part of what was found for it.
    Source: Takahashi, Fagan and Chen 1973.
    """
    conditionals = [net.at(k) for k in range(net.size())]
    below, last = _below(conditionals), len(conditionals) - 1
    common = conditionals[last].firstFrontalKey()
    root = np.linalg.inv(conditionals[last].jacobian()[0])
    size = {common: len(root)}
    waiting = [(k, {common: 0}, root @ root.T) for k in below[last]]
    while waiting:
        k, start, covariance = waiting.pop()
        key, *tied = conditionals[k].keys()
        if not below[k] and key not in asked:
            continue
        # The common one comes last, and is carried along where it is not among them.
        others = [*(other for other in tied if other != common), common]
        A = conditionals[k].jacobian()[0]
        n = size[key] = A.shape[1] - sum(size[other] for other in tied)
        ends = np.cumsum([n, *(size[other] for other in tied)])
        blocks = {other: A[:, a:b] for other, a, b in zip(tied, ends[:-1], ends[1:], strict=True)}
        blocks.setdefault(common, np.zeros((n, size[common])))
        free = np.linalg.inv(A[:, :n])
        B = -free @ np.hstack([blocks[other] for other in others])
        at = np.concatenate([np.arange(start[other], start[other] + size[other]) for other in others])
        joint = np.empty((n + len(at),) * 2)
        joint[n:, n:] = covariance[np.ix_(at, at)]
        joint[:n, n:] = B @ joint[n:, n:]
        joint[n:, :n] = joint[:n, n:].T
        joint[:n, :n] = free @ free.T + joint[:n, n:] @ B.T
        if key in asked:
            both = np.r_[:n, len(joint) - size[common] : len(joint)]
            yield key, joint[np.ix_(both, both)]
        begins = np.cumsum([0, n, *(size[other] for other in others[:-1])]).tolist()
        start = dict(zip((key, *others), begins, strict=True))
        waiting += [(child, start, joint) for child in below[k]]


def _below(conditionals: Sequence[gtsam.GaussianConditional]) -> list[list[int]]:
    """Of each variable, in order of elimination: those that hang on it, the first that they were tied to."""
    place = {conditional.firstFrontalKey(): k for k, conditional in enumerate(conditionals)}
    last = len(conditionals) - 1
    below: list[list[int]] = [[] for _ in conditionals]
    for k, conditional in enumerate(conditionals[:last]):
        _, *tied = conditional.keys()
        below[min((place[key] for key in tied), default=last)].append(k)
    return below
