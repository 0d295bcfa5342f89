"""Incremental estimation of a trajectory, keyframe by keyframe, with gtsam's ISAM2.

Odometry is added at once, at constant cost. A loop makes ISAM2 solve everything between its ends again. Loops
are therefore queued and added together, so rarely that 99 of 100 keyframes stay within the time budget.

After loops were added, the edges must pass the chi-square test of the batch. If they fail, the batch selects
among all edges received so far, those that it rejected before included. ISAM2 is rebuilt where its selection
is another one, and after an exception, which makes ISAM2 unusable.

Readings of an IMU between two keyframes make a factor, with velocity and bias at both as variables. They join
keyframes that no picture joins. In the batch, a relative pose with their covariance takes the place of these.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.errors import BackendError, first_line
from backend.measurements import (
    Attitude,
    Measurements,
    Position,
    RelativePose,
    SlantRange,
)
from backend.pose_graph.incremental.inertial_link import (
    InertialLink,
    MeasuredInterval,
    bridges,
    inertial_link,
    relative_poses,
    turns_agree,
)
from backend.pose_graph.incremental.inertial_noise import FlightNoise
from backend.pose_graph.incremental.keyframe_factors import (
    edge_factors,
    first_gauge,
    first_pose,
    joined,
    rekeyed,
    renumbered,
)
from backend.pose_graph.incremental.received_measurements import ReceivedMeasurements
from backend.pose_graph.minimise import minimise
from backend.pose_graph.problem import spatial_poses
from backend.pose_graph.solve import solve
from backend.preintegration.intervals import InertialInterval

Array = NDArray[np.float64]

BUDGET_S = 0.02
_COOLDOWN_KEYFRAMES = 100
"""Number of keyframes between two updates that exceed the budget: one in a hundred may."""
_RELINEARIZE_THRESHOLD = 0.05
"""Change, in rad and m, above which a variable is relinearised."""


@dataclass(frozen=True)
class IncrementalUpdate:
    """Result of adding a keyframe."""

    w_T_b: Array
    """(4, 4) pose of the new keyframe."""
    pending: int
    """Number of queued loops."""
    rejected: tuple[str, ...] = ()
    """Messages about edges that were rejected or could not be added, with the reason."""
    rebuild_reason: str = ""
    """Reason for a rebuild of ISAM2; empty if there was none."""


class Incremental:
    """Estimator for keyframes 0, 1, 2, ...; a gauge prior fixes what the first one does not measure.

    ``loops_robust`` allows the rejection of edges if the chi-square test fails, as in `solve`.
    """

    def __init__(self, budget_s: float = BUDGET_S, loops_robust: bool = True) -> None:
        self.budget_s = budget_s
        self.loops_robust = loops_robust
        self._flight_noise = FlightNoise()
        self.count = 0
        self._received = ReceivedMeasurements()
        self._start = gtsam.Values()
        self._isam = _isam("CHOLESKY")
        self._pending: list[RelativePose] = []
        self._cooldown = 0
        self._bridged: list[tuple[int, int]] = []

    @property
    def edges(self) -> tuple[tuple[RelativePose, bool], ...]:
        """The edges that were received, queued loops apart, and whether each is kept at present."""
        return tuple(zip(self._received.edges, self._received.kept, strict=True))

    @property
    def rejected(self) -> tuple[RelativePose, ...]:
        """The edges that are rejected at present; later loops may restore them."""
        return tuple(edge for edge, is_kept in self.edges if not is_kept)

    def add(
        self,
        relative_poses: tuple[RelativePose, ...] = (),
        attitudes: tuple[Attitude, ...] = (),
        ranges: tuple[SlantRange, ...] = (),
        positions: tuple[Position, ...] = (),
        w_T_b: Array | None = None,
        inertial: InertialInterval | None = None,
    ) -> IncrementalUpdate:
        """Add the next keyframe, number ``count``, with its measurements.

        One of its relative poses must connect it to an earlier one, or else ``inertial`` readings of the body
        since keyframe ``inertial.i``, whose velocity earlier readings tell. They take metres over a level
        floor. Where gyro and relative pose turn otherwise, they are left out. ``w_T_b`` (4, 4) initialises
        the first keyframe.
        Raises ``BackendError`` for invalid values; the estimate is then unchanged.
        """
        number = self.count
        here = [e for e in relative_poses if number in (e.i, e.j)]
        certain = [e for e in here if e.kind != "loop"]
        readings_alone = not certain and inertial is not None and self.bridges_by(inertial)
        if number and not here and not readings_alone:
            raise BackendError(f"no relative pose joins keyframe {number} to an earlier one")
        if any(max(e.i, e.j) > number for e in relative_poses):
            raise BackendError(f"a relative pose names a keyframe after the newest, {number}")
        anchor = None if readings_alone else next(iter([*certain, *here]), None)
        loops = [e for e in relative_poses if e.kind == "loop" and e is not anchor]
        now = tuple(e for e in relative_poses if e.kind != "loop" or e is anchor)
        measured = Measurements(
            stamps_s=np.zeros(0), relative_poses=now, attitudes=attitudes, ranges=ranges, positions=positions
        )
        problem, keys = renumbered(measured, number)
        renumbered(Measurements(np.zeros(0), tuple(loops)), number)  # invalid loops are rejected now
        of_edges, unary = edge_factors(problem, keys), rekeyed(problem.unary_factor_graph(), keys)
        gauge = gtsam.NonlinearFactorGraph()
        link = self._link(inertial, anchor, certain) if number and inertial is not None else None
        if number == 0:
            start = first_pose(problem, w_T_b)
            gauge = first_gauge(problem, start)
        elif anchor is not None:
            start = self._predicted(anchor, number)
        else:
            assert link is not None
            start = link.w_T_j
        values, by_readings = gtsam.Values(), gtsam.NonlinearFactorGraph()
        values.insert(number, gtsam.Pose3(start))
        if link is not None:
            values.insert(link.values)
            by_readings = link.factors
        self._start.insert(values)
        self._received.add_edges(now, of_edges)
        self._received.add_keyframe(measured, unary, gauge)
        self._received.add_inertial(by_readings, readings_alone)
        rebuild_reason = self._update(joined(of_edges, unary, gauge, by_readings), values)
        self.count += 1
        self._pending += loops
        rejected: tuple[str, ...] = ()
        self._cooldown -= 1
        if self._pending and self._cooldown <= 0:
            again, rejected = self._update_with_loops()
            rebuild_reason = rebuild_reason or again
        return IncrementalUpdate(self.pose(number), len(self._pending), rejected, rebuild_reason)

    def pose(self, k: int) -> Array:
        """Return the current pose (4, 4) of keyframe ``k``."""
        return np.asarray(self._isam.calculateEstimatePose3(k).matrix(), dtype=np.float64)

    def trajectory(self) -> Array:
        """Return the current poses (n, 4, 4) of all keyframes."""
        return spatial_poses(self._isam.calculateEstimate())

    def settle(self) -> IncrementalUpdate:
        """Add all queued loops and solve the batch problem, without a time budget."""
        if self.count == 0:
            raise BackendError("there is no keyframe: nothing to settle")
        rebuild_reason, rejected = self._add_queued_loops()
        self._start = self._isam.calculateEstimate()
        if self.loops_robust:
            rejected += self._select() or ()
        self._rebuild()
        return IncrementalUpdate(self.pose(self.count - 1), 0, rejected, rebuild_reason)

    @property
    def bridged(self) -> int:
        """Number of keyframes that readings of the IMU alone joined to an earlier one."""
        return len(self._bridged)

    def error(self) -> float:
        """Return half the sum of squared whitened residuals of all kept factors, with robust losses."""
        return float(self._received.graph().error(self._isam.calculateEstimate()))

    def bridges_by(self, inertial: InertialInterval) -> bool:
        """Return whether these readings alone place the next keyframe to a height above the floor."""
        readings = self._readings(inertial)
        return readings is not None and bridges(self._isam, readings)

    def bridges(self) -> tuple[RelativePose, ...]:
        """Return a relative pose of kind ``inertial`` for each keyframe that readings alone join to an
        earlier one. Queued loops do not count in it."""
        if not self._bridged:
            return ()
        graph = self._received.chain()
        values = minimise(graph, self._isam.calculateEstimate()).values
        return relative_poses(graph, values, self._bridged)

    def _link(
        self, inertial: InertialInterval, anchor: RelativePose | None, certain: list[RelativePose]
    ) -> InertialLink | None:
        """Return the link by the readings; None where their noise is unknown or they contradict the pictures.

        The ``certain`` edges show their noise for those that come.
        """
        i, readings = inertial.i, self._readings(inertial)
        for edge in certain:
            if (edge.i, edge.j) == (i, self.count):
                self._flight_noise.add(inertial, edge, self.pose(i)[:3, :3])
        if readings is None:
            return None
        if anchor is None:
            self._bridged.append((i, self.count))
            return inertial_link(readings, self._isam, None)
        w_T_i, w_T_j = self.pose(i), self._predicted(anchor, self.count)
        if not readings.is_informative(w_T_i[2, 3]):
            return None
        if not turns_agree(readings, w_T_i[:3, :3].T @ w_T_j[:3, :3], anchor.covariance[:3, :3]):
            return None
        return inertial_link(readings, self._isam, w_T_j)

    def _readings(self, inertial: InertialInterval) -> MeasuredInterval | None:
        """Return readings up to the next keyframe with their noise; None if that is not known yet."""
        factors = self._flight_noise.factors()
        if factors is None:
            return None
        return MeasuredInterval(replace(inertial, j=self.count), factors)

    def _predicted(self, anchor: RelativePose, number: int) -> Array:
        if anchor.j == number:
            return self.pose(anchor.i) @ anchor.i_T_j
        return self.pose(anchor.j) @ se3.inverse(anchor.i_T_j)

    def _update_with_loops(self) -> tuple[str, tuple[str, ...]]:
        """Add the queued loops and test all edges; return the reason for a rebuild, and messages about
        rejected edges."""
        begin = time.perf_counter()
        rebuild_reason, rejected = self._add_queued_loops()
        test = self._received.test(self._isam.calculateEstimate(), self.count)
        if self.loops_robust and not test.passed and (more := self._select()) is not None:
            self._rebuild()
            rebuild_reason, rejected = rebuild_reason or "other edges agree", rejected + more
        if time.perf_counter() - begin > self.budget_s:
            self._cooldown = _COOLDOWN_KEYFRAMES
        return rebuild_reason, rejected

    def _add_queued_loops(self) -> tuple[str, tuple[str, ...]]:
        """Return the reason for a rebuild, and messages about loops that cannot be added."""
        loops, self._pending = tuple(self._pending), []
        if not loops:
            return "", ()
        received = self._received
        problem, keys = renumbered(Measurements(np.zeros(0), loops), self.count)
        factors, before = edge_factors(problem, keys), len(received.edges)
        received.add_edges(loops, factors, queued=True)
        try:
            return self._update(joined(factors), gtsam.Values(), relinearize=True), ()
        except BackendError as refusal:
            received.select([*received.kept[:before], *[False] * len(loops)])
            self._rebuild()
            return str(refusal), tuple(f"the loop {e.i}-{e.j} was left out: {refusal}" for e in loops)

    def _select(self) -> tuple[str, ...] | None:
        """Let the batch select among all edges, and start from its poses.

        Return messages about the edges that are newly rejected; None if the selection stays.
        """
        received, bridges = self._received, self.bridges()
        measured = received.measurements(self.count)
        measured = replace(measured, relative_poses=(*measured.relative_poses, *bridges))
        found = solve(measured, covariances=False)
        kept = found.edge_kept.tolist()[: len(received.edges)]
        if kept == received.kept:
            return None
        news = [
            f"the {'loop' if e.kind == 'loop' else 'odometry'} {e.i}-{e.j} is rejected: {reason}"
            for e, reason, now, was in zip(
                received.edges, found.edge_reason[: len(kept)], kept, received.kept, strict=True
            )
            if was and not now
        ]
        received.select(kept)
        self._start = self._isam.calculateEstimate()
        if (found.component == 0).all():  # each part has a frame of its own
            for k, w_T in enumerate(found.w_T_b):
                self._start.update(k, gtsam.Pose3(w_T))
        return tuple(news)

    def _update(
        self, factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, relinearize: bool = False
    ) -> str:
        """Add factors that were received; return the reason for a rebuild of ISAM2, or nothing."""
        try:
            self._isam.update(factors, values, force_relinearize=relinearize)
        except (RuntimeError, ValueError, IndexError) as error:
            self._rebuild()
            return first_line(error)
        return ""

    def _rebuild(self) -> None:
        graph = self._received.graph()
        at = minimise(graph, self._start).values
        # Cholesky squares the condition number and may have failed on a long chain.
        fresh = _isam("QR")
        try:
            fresh.update(graph, at)
        except (RuntimeError, ValueError, IndexError) as error:
            raise BackendError(f"it cannot be built anew: {first_line(error)}") from error
        self._isam, self._start = fresh, at


def _isam(factorization: str) -> gtsam.ISAM2:
    params = gtsam.ISAM2Params()
    params.setFactorization(factorization)
    params.setRelinearizeThreshold(_RELINEARIZE_THRESHOLD)
    # Relinearise only with loops or on request: it costs as much as a loop.
    params.enableRelinearization = False
    return gtsam.ISAM2(params)
