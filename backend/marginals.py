"""Covariances of poses at a solution, never an exception for a part that is not determined."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.elimination import nested_dissection
from backend.errors import GTSAM_ERRORS
from backend.gauge import floating_parts
from backend.se3 import PLANAR

Array = NDArray[np.float64]

_DEEP = 5_000
"""Keys from which nested dissection orders: shortcuts recurse down the tree, and COLAMD's is as deep as a
chain."""

_NO_KNOWLEDGE = 1e10
"""Variance (rad^2, m^2) above which rounding, not measurement, speaks."""

_HOLD = 1e3
"""A variable held to a thousandth of its own standard deviation is held."""


def pose_covariances(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: Sequence[int]) -> Array:
    """Marginal covariances of poses. Returns (n, 6, 6), rotation first, right perturbation, rad and m.

    Planar poses are embedded with zeros for what cannot move. NaN where a pose is not determined: the parts
    of the graph that are, are still answered.
    """
    out = np.full((len(keys), 6, 6), np.nan)
    tree = bayes_tree(graph, values)
    if tree is not None and not floating_parts(graph).floating:
        _fill(out, tree, keys, range(len(keys)))
        return out
    for part in floating_parts(graph).parts:
        inside = set(part)
        mine = [k for k, key in enumerate(keys) if key in inside]
        tree = bayes_tree(*_part(graph, values, inside)) if mine else None
        if tree is not None and part not in floating_parts(graph).floating:
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

    A joint of two variables costs gtsam a walk through the tree for each pair. Here the common one, w, is
    eliminated last: each pose is then a linear function of it, x = G w, plus what is uncertain while w is
    held, so that cov(x) = cov(x | w) + G cov(w) G^T and cov(x, w) = G cov(w).
    """
    d = len(values.atVector(common))
    out = np.full((len(keys), 6 + d, 6 + d), np.nan)
    if common not in graph.keys():  # noqa: SIM118
        return out  # gtsam ends the interpreter where an ordering names what no factor does
    for eliminate in ((), (gtsam.EliminateQR,)):  # Cholesky by default
        try:
            of_common, G, held = _conditioned(graph.linearize(values), keys, common, d, *eliminate)
        except (*GTSAM_ERRORS, np.linalg.LinAlgError):
            continue
        out[:, 6:, 6:] = of_common
        out[:, :6, 6:] = G @ of_common
        out[:, 6:, :6] = np.swapaxes(out[:, :6, 6:], 1, 2)
        out[:, :6, :6] = held + out[:, :6, 6:] @ np.swapaxes(G, 1, 2)
        break
    return out


def _conditioned(
    linear: gtsam.GaussianFactorGraph, keys: Sequence[int], common: int, d: int, *eliminate: Any
) -> tuple[Array, Array, Array]:
    """cov(w) (d, d), dx/dw (n, 6, d), and cov(x | w) (n, 6, 6)."""
    ordering = nested_dissection(linear, common)
    # What the one elimination holds is given back before the next begins.
    of_common, G = _sensitivity(linear, ordering, keys, common, d, *eliminate)
    hold = np.diag(_HOLD / np.sqrt(np.diag(of_common)))
    linear.add(gtsam.JacobianFactor(common, hold, np.zeros(d), gtsam.noiseModel.Unit.Create(d)))
    tree = linear.eliminateMultifrontal(ordering, *eliminate)
    held = np.array([tree.marginalCovariance(key) for key in keys]).reshape(-1, 6, 6)
    return of_common, G, held


def _sensitivity(
    linear: gtsam.GaussianFactorGraph,
    ordering: gtsam.Ordering,
    keys: Sequence[int],
    common: int,
    d: int,
    *eliminate: Any,
) -> tuple[Array, Array]:
    """cov(w) (d, d) and dx/dw (n, 6, d): w comes last in the ordering, the rest follows from it."""
    others = gtsam.Ordering()
    for k in range(ordering.size() - 1):
        others.push_back(ordering.at(k))
    net, rest = linear.eliminatePartialSequential(others, *eliminate)
    of_common = np.asarray(np.linalg.inv(rest.hessian()[0]), dtype=np.float64)

    def poses(w: Array) -> Array:
        given = gtsam.VectorValues()
        given.insert(common, w)
        found = net.optimize(given)
        return np.array([found.at(key) for key in keys]).reshape(-1, 6)

    return of_common, np.stack([poses(w) for w in np.eye(d)], axis=2) - poses(np.zeros(d))[:, :, None]
