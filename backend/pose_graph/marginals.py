"""Marginal covariances of poses at a solution; NaN instead of an exception for an undetermined pose."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.gauge import graph_components
from backend.pose_graph.bayes_tree import bayes_tree, clique_covariances
from backend.se3 import PLANAR

Array = NDArray[np.float64]

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
    row = {key: k for k, key in enumerate(keys)}
    components = graph_components(graph)
    tree = None if components.floating else bayes_tree(graph, values, by_qr=by_qr)
    if tree is not None:
        _fill(out, tree, values, row)
        return out
    for part in components.parts:
        if part in components.floating or row.keys().isdisjoint(part):
            continue
        factors, inside = _part(graph, values, set(part))
        tree = bayes_tree(factors, inside, by_qr=by_qr)
        if tree is not None:
            _fill(out, tree, inside, row)
    return out


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


def _fill(out: Array, tree: gtsam.GaussianBayesTree, values: gtsam.Values, row: dict[int, int]) -> None:
    """Store the covariances of a tree's poses, except those that are dominated by rounding."""
    asked: list[int] = []
    found: list[Array] = []
    # Vanishing information overflows to infinite variances, which are unknown.
    with np.errstate(over="ignore", invalid="ignore"):
        for clique in clique_covariances(tree, values):
            for key in clique.frontals:
                if key in row:
                    asked.append(row[key])
                    found.append(clique.of(key))
    if not found:
        return
    covariances = np.array(found)
    variance = np.diagonal(covariances, axis1=1, axis2=2)
    sound = np.isfinite(covariances).all(axis=(1, 2)) & (variance >= 0).all(axis=1)
    sound &= (variance < _MAX_VARIANCE).all(axis=1)
    whole = np.zeros((np.count_nonzero(sound), 6, 6))
    place = np.arange(6) if covariances.shape[1] == 6 else PLANAR
    whole[:, place[:, None], place] = covariances[sound]
    out[np.array(asked)[sound]] = whole
