"""Marginal covariances of poses at a solution; NaN instead of an exception for an undetermined pose."""

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
"""Number of keys above which nested dissection is used: gtsam recurses down the tree, and COLAMD's tree is as
deep as a chain."""

_MAX_VARIANCE = 1e10
"""Variance (rad^2, m^2) above which the result is dominated by rounding."""


def pose_covariances(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: Sequence[int], by_qr: bool = False
) -> Array:
    """Return marginal covariances of poses: (n, 6, 6), rotation first, right perturbation, rad and m.

    Planar poses are embedded with zeros for the other directions. An undetermined pose is NaN; components
    that are determined still get their covariances. ``by_qr`` needs half the digits of a normal matrix: for
    edges whose information differs by more than ten orders.
    """
    out = np.full((len(keys), 6, 6), np.nan)
    if by_qr:
        _fill_by_qr(out, graph, values, keys)
        return out
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
    """Eliminate the linear system at ``values``; None if it is singular."""
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


def _fill_by_qr(
    out: Array,
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    keys: Sequence[int],
) -> None:
    """Fill the covariances of a connected graph; gtsam's own marginals go through normal matrices."""
    row = {key: k for k, key in enumerate(keys)}
    try:
        linear = graph.linearize(values)
        net = linear.eliminateSequential(nested_dissection(linear), gtsam.EliminateQR)
        last = net.at(net.size() - 1)
        # Vanishing information overflows to infinite variances, which are unknown.
        with np.errstate(over="ignore", invalid="ignore"):
            root = np.linalg.inv(last.jacobian()[0])
            found = [(last.firstFrontalKey(), root @ root.T)] if last.firstFrontalKey() in row else []
            found += [(key, joint[: -len(root), : -len(root)]) for key, joint in _joints(net, row)]
    except (*GTSAM_ERRORS, np.linalg.LinAlgError):
        return
    for key, covariance in found:
        _put(out, row[key], covariance)


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
        _put(out, k, covariance)


def _put(out: Array, k: int, covariance: Array) -> None:
    """Store a pose's covariance, unless it is dominated by rounding."""
    variance = np.diag(covariance)
    if not (np.isfinite(covariance).all() and (variance >= 0).all() and (variance < _MAX_VARIANCE).all()):
        return
    if len(covariance) == 6:
        out[k] = covariance
    else:
        out[k] = 0
        out[k][np.ix_(PLANAR, PLANAR)] = covariance


def joint_covariances(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: Sequence[int], common: int
) -> Array:
    """Return joint marginals of each pose with one common variable, (n, 6 + d, 6 + d), pose first.

    Singular ones are NaN. gtsam would traverse and cache its tree for each pose, at a higher cost than the
    solve of a long flight. Here one traversal goes from the root, the common variable, to all poses.
    """
    d = len(values.atVector(common))
    out = np.full((len(keys), 6 + d, 6 + d), np.nan)
    if common not in graph.keys():  # noqa: SIM118
        return out  # gtsam aborts the interpreter if an ordering has a key without a factor
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
    """Yield the key of each requested variable and its joint covariance with the one eliminated last.

    An eliminated variable is x = B s + noise, with s its separator: cov(x) = (R'R)^-1 + B cov(s) B' and
    cov(x, s) = B cov(s). The variable of s that is eliminated first has all others in its own separator, so
    that cov(s) is a part of its joint covariance.
    Source: Takahashi, Fagan and Chen 1973.
    """
    conditionals = [net.at(k) for k in range(net.size())]
    children, last = _children(conditionals), len(conditionals) - 1
    common = conditionals[last].firstFrontalKey()
    root = np.linalg.inv(conditionals[last].jacobian()[0])
    size = {common: len(root)}
    waiting = [(k, {common: 0}, root @ root.T) for k in children[last]]
    while waiting:
        k, start, covariance = waiting.pop()
        key, *tied = conditionals[k].keys()
        if not children[k] and key not in asked:
            continue
        # The common variable comes last, and is appended if it is not in the separator.
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
        waiting += [(child, start, joint) for child in children[k]]


def _children(conditionals: Sequence[gtsam.GaussianConditional]) -> list[list[int]]:
    """Return the children of each variable in the elimination tree, in order of elimination."""
    place = {conditional.firstFrontalKey(): k for k, conditional in enumerate(conditionals)}
    last = len(conditionals) - 1
    children: list[list[int]] = [[] for _ in conditionals]
    for k, conditional in enumerate(conditionals[:last]):
        _, *tied = conditional.keys()
        children[min((place[key] for key in tied), default=last)].append(k)
    return children
