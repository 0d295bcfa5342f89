"""Marginal covariances of poses at a solution; NaN instead of an exception for an undetermined pose."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.gauge import graph_components
from backend.pose_graph.bayes_tree import CliqueCovariance, bayes_tree, clique_covariances
from backend.se3 import PLANAR

Array = NDArray[np.float64]

MAX_VARIANCE = 1e10
"""Variance (rad^2, m^2) above which the result is dominated by rounding."""
_MAX_ROUNDING = 1e-6
"""Error of a whitened covariance, at which a prediction could look like that of an edge without a check."""


@dataclass(frozen=True)
class SolutionCovariances:
    """Covariances at a solution; NaN where undetermined."""

    poses: Array
    """(n, 6, 6), rotation first, right perturbation, rad and m; zeros for the directions that a planar pose
    does not have."""
    predictions: Array
    """(k, d, d) covariance of the prediction of each factor, whitened by the factor's own noise."""


def pose_covariances(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: Sequence[int], by_qr: bool = False
) -> Array:
    """Return the covariances of poses as `posterior` does."""
    return posterior(graph, values, keys, by_qr=by_qr).poses


def posterior(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    keys: Sequence[int],
    factors: Sequence[gtsam.NonlinearFactor] = (),
    by_qr: bool = False,
) -> SolutionCovariances:
    """Return covariances of poses, and of the predictions of ``factors`` of the graph on two poses each.

    Components that are determined get their covariances if others are not. ``by_qr`` needs half the digits of
    a normal matrix: for edges whose information differs by more than ten orders.
    """
    row = {key: k for k, key in enumerate(keys)}
    ends = [tuple(factor.keys()) for factor in factors]
    factors_of: dict[int, list[int]] = defaultdict(list)
    for k, key in ((k, key) for k, pair in enumerate(ends) for key in pair):
        factors_of[key].append(k)
    found: dict[int, Array] = {}
    jacobians = [np.asarray(factor.linearize(values).jacobian()[0]) for factor in factors]
    d = len(jacobians[0]) if jacobians else 0
    predictions = np.full((len(ends), d, d), np.nan)
    # Vanishing information overflows to infinite variances, which are unknown.
    with np.errstate(over="ignore", invalid="ignore"):
        for clique in _cliques(graph, values, row.keys(), by_qr):
            for key in clique.frontals:
                if key in row:
                    found[row[key]] = clique.of(key)
                for k in factors_of.get(key, ()):
                    # The end that is eliminated first shares a clique with the other one.
                    if clique.rows.keys() >= set(ends[k]):
                        predictions[k] = _predicted(jacobians[k], clique.of(*ends[k]))
    poses = np.full((len(row), 6, 6), np.nan)
    if found:
        poses[list(found)] = _embedded(np.array(list(found.values())))
    return SolutionCovariances(poses, predictions)


def _cliques(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: Set[int], by_qr: bool
) -> Iterator[CliqueCovariance]:
    """Yield the cliques of the whole graph, or of its determined components that contain some of the keys."""
    components = graph_components(graph)
    tree = None if components.floating else bayes_tree(graph, values, by_qr=by_qr)
    if tree is not None:
        yield from clique_covariances(tree, values)
        return
    for part in components.parts:
        if part in components.floating or keys.isdisjoint(part):
            continue
        of_part, inside = _part(graph, values, set(part))
        tree = bayes_tree(of_part, inside, by_qr=by_qr)
        if tree is not None:
            yield from clique_covariances(tree, inside)


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


def _predicted(J: Array, covariance: Array) -> Array:
    """Return J C J'; NaN if the rounding errors of its terms are not small beside the factor's own noise."""
    rounding = np.finfo(float).eps * float((J**2 @ np.diagonal(covariance)).sum())
    found = J @ covariance @ J.T
    return found if rounding < _MAX_ROUNDING else np.full_like(found, np.nan)


def _embedded(covariances: Array) -> Array:
    """Return covariances (n, 6, 6) of poses from (n, 3, 3) or (n, 6, 6); NaN if rounding dominates them."""
    variance = np.diagonal(covariances, axis1=1, axis2=2)
    valid = np.isfinite(covariances).all(axis=(1, 2)) & (variance >= 0).all(axis=1)
    valid &= (variance < MAX_VARIANCE).all(axis=1)
    place = np.arange(6) if covariances.shape[1] == 6 else PLANAR
    out = np.zeros((len(covariances), 6, 6))
    out[:, place[:, None], place] = covariances
    out[~valid] = np.nan
    return out
