"""Record of the incremental estimation: measurements received, their factors, and which edges take part."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np

from backend.measurements import Attitude, Measurements, Position, RelativePose, SlantRange
from backend.pose_graph.chi_square import ChiSquare, edges_test


class ReceivedMeasurements:
    """Growing record; an edge that does not take part stays, since later loops may speak for it."""

    def __init__(self) -> None:
        self.edges: list[RelativePose] = []
        self.kept: list[bool] = []
        self._queued: list[bool] = []
        self._factors: list[gtsam.NonlinearFactor] = []
        self._kept_factors = gtsam.NonlinearFactorGraph()
        self._attitudes: list[Attitude] = []
        self._ranges: list[SlantRange] = []
        self._positions: list[Position] = []
        self._unary_factors = gtsam.NonlinearFactorGraph()
        self._unary_rows = 0
        self._gauge = gtsam.NonlinearFactorGraph()
        self._inertial = gtsam.NonlinearFactorGraph()
        self._bridges = gtsam.NonlinearFactorGraph()

    def add_edges(
        self, edges: Sequence[RelativePose], factors: Sequence[gtsam.NonlinearFactor], queued: bool = False
    ) -> None:
        """Add edges that take part, with their factors; ``queued`` are loops that join joined keyframes."""
        self.edges += edges
        self._queued += [queued] * len(edges)
        self._factors += factors
        self.kept += [True] * len(edges)
        for factor in factors:
            self._kept_factors.push_back(factor)

    def add_keyframe(
        self,
        measured: Measurements,
        unary_factors: gtsam.NonlinearFactorGraph,
        gauge: gtsam.NonlinearFactorGraph,
    ) -> None:
        """Add what is measured of one keyframe alone, with its factors; ``gauge`` may hold a prior."""
        self._attitudes += measured.attitudes
        self._ranges += measured.ranges
        self._positions += measured.positions
        self._unary_factors.push_back(unary_factors)
        self._unary_rows += sum(unary_factors.at(k).dim() for k in range(unary_factors.size()))
        self._gauge.push_back(gauge)

    def add_inertial(self, factors: gtsam.NonlinearFactorGraph, bridges: bool) -> None:
        """Add the factors of an IMU; if it ``bridges``, the last one joins a keyframe that no edge joins."""
        self._inertial.push_back(factors)
        if bridges:
            self._bridges.push_back(factors.at(factors.size() - 1))

    def select(self, kept: Sequence[bool]) -> None:
        """Let only the ``kept`` edges (m,) take part."""
        self.kept = list(kept)
        self._kept_factors = gtsam.NonlinearFactorGraph()
        for factor, is_kept in zip(self._factors, kept, strict=True):
            if is_kept:
                self._kept_factors.push_back(factor)

    def graph(self) -> gtsam.NonlinearFactorGraph:
        """Return all factors that take part."""
        return self._with_others(gtsam.NonlinearFactorGraph(self._kept_factors))

    def chain(self) -> gtsam.NonlinearFactorGraph:
        """Return the factors without loops that were queued, which join what is joined already."""
        graph = gtsam.NonlinearFactorGraph()
        for factor, queued in zip(self._factors, self._queued, strict=True):
            if not queued:
                graph.push_back(factor)
        return self._with_others(graph)

    def _with_others(self, graph: gtsam.NonlinearFactorGraph) -> gtsam.NonlinearFactorGraph:
        for others in (self._unary_factors, self._gauge, self._inertial):
            graph.push_back(others)
        return graph

    def test(self, values: gtsam.Values, count: int) -> ChiSquare:
        """Test the edges that take part, of ``count`` keyframes, as the batch does.

        A bridge counts as an edge: of its fifteen rows, velocity and bias take nine.
        """
        edges = self._kept_factors.size() + self._bridges.size()
        statistic = 2 * (self._kept_factors.error(values) + self._bridges.error(values))
        return edges_test(6, count, edges, self._unary_rows, statistic)

    def measurements(self, count: int) -> Measurements:
        """Return all measurements, those of edges that do not take part too."""
        return Measurements(
            stamps_s=np.arange(float(count)),
            relative_poses=tuple(self.edges),
            attitudes=tuple(self._attitudes),
            ranges=tuple(self._ranges),
            positions=tuple(self._positions),
        )
