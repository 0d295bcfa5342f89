"""Factors of everything but the floor points: each row of their system has a kind and an instrument."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X as POSE

from tests.backend.bundle.posed_costs import posed


def test_each_row_has_an_instrument_also_where_factors_were_added_from_outside() -> None:
    cost, at = posed("sonar", more=True)
    factors = cost.pose_side
    # What is pushed into the graph has no kind: it must not count either.
    factors.graph.push_back(
        gtsam.PoseTranslationPrior3D(POSE(0), np.zeros(3), gtsam.noiseModel.Unit.Create(3))
    )
    rows = sum(factor.jacobian()[0].shape[0] for factor in _linear(factors.graph, at.values))
    assert len(factors.instruments) == len(factors.keyframes) == rows
    assert factors.rows_of("inertial prior").sum() == 9 * cost.problem.measurements.count


def _linear(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> list[gtsam.GaussianFactor]:
    linear = graph.linearize(values)
    return [linear.at(k) for k in range(linear.size())]
