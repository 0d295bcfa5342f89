"""How improbable it is that edges which agree in one transform are false, and a group of such edges."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from backend.pose_graph.problem import Problem
from backend.pose_graph.selection.agreement import log_odds
from backend.pose_graph.selection.evidence import log_unit_volumes, odometry_log_odds
from backend.pose_graph.selection.places import ROW_LENGTH, place_pairs
from backend.pose_graph.selection.prediction import noise_scale
from backend.pose_graph.selection.rival_loops import LEAST_LOG_ODDS, Rivals
from backend.quantiles import binomial_tail

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

_COMMON_CAUSE = LEAST_LOG_ODDS
"""Improbability (nats) that a floor repeats, so that rows of loops are false together."""


@dataclass(frozen=True)
class MovedRivals(Rivals):
    """Rivals, and how far the poses behind the edges would move if the rejected ones are true."""

    length: float
    """Distance in the unit of the graph."""
    degrees: float
    """Angle by which they would turn."""


@dataclass(frozen=True)
class Improbability:
    """Improbability (nats) that edges which agree in one transform are false."""

    problem: Problem
    kept: Mask
    """(m,) which edges the solution keeps."""
    w_T: Array
    """(n, 4, 4) poses of the solution."""

    @cached_property
    def row(self) -> Index:
        """(m,) label of each row of loops between two places; each edge of odometry has its own."""
        p, loops = self.problem, np.flatnonzero(~self.problem.trusted)
        row = np.arange(len(p.i)) + len(p.i)
        row[loops] = place_pairs(p.i[loops], p.j[loops], ROW_LENGTH)
        return row

    @cached_property
    def of_edge(self) -> Array:
        """(m,) improbability of an edge that is false by itself."""
        loops = ~self.problem.trusted
        prior = np.where(loops, log_odds(self.kept, loops), odometry_log_odds(loops))
        scale = noise_scale(self.problem, self.kept, self.w_T)
        volumes = log_unit_volumes(self.problem, self.w_T) - self.problem.dof * np.log(scale)
        return np.asarray(np.maximum(volumes + prior, 0.0))

    def rows(self, edges: Index) -> int:
        """Return the number of rows of the loops among some edges."""
        return self._count(edges, self.row)

    def log_odds(self, against: Index, edges: Index) -> float:
        """Return the log odds (nats) that the edges ``against`` others are true, and those false.

        A row of loops counts as one.
        """
        return self._log_false(edges, against, self.row) - self._log_false(against, edges, self.row)

    def log_odds_of_loops(self, against: Index, edges: Index) -> float:
        """Return the log odds as `log_odds`, where each loop counts for itself."""
        each = np.arange(len(self.kept))
        return self._log_false(edges, against, each) - self._log_false(against, edges, each)

    def _count(self, edges: Index, label: Index) -> int:
        return len(np.unique(label[edges[~self.problem.trusted[edges]]]))

    def _log_false(self, edges: Index, true: Index, label: Index) -> float:
        """Return the log probability that some edges are false while others are ``true``, up to a constant.

        Loops count by their ``label`` (m,). They agree by chance, or by a common cause: then each share below
        a half is as probable.
        """
        trusted, (n, n_true) = self.problem.trusted[edges], (self._count(e, label) for e in (edges, true))
        odometry = -float(self.of_edge[edges[trusted]].sum())
        if n == 0:
            return odometry
        own = float(self.of_edge[edges[~trusted]].max())
        others = self._count(np.arange(len(self.kept)), label)
        chance = -(n - 1) * max(own - float(np.log(others)), 0.0)
        share = binomial_tail(n + 1, n + n_true + 1, 0.5)
        return odometry - own + float(np.logaddexp(chance, np.log(share) - _COMMON_CAUSE))
