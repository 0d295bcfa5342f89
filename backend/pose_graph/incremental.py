"""A trajectory that grows keyframe by keyframe, for use in flight: gtsam's ISAM2 with its log kept.

Odometry is taken in at once, at a price that does not grow. A loop makes ISAM2 solve all that lies between
its ends again: loops wait, and are taken in together, so seldom that the time for a keyframe is within the
budget in 99 of 100 cases. After an exception ISAM2 is of no use any more; it is built anew from the log.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.errors import BackendError, first_line
from backend.gauge import gauge_prior, unobserved_directions
from backend.measurements import Attitude, Measurements, Position, RelativePose, SlantRange
from backend.pose_graph.from_measurements import from_measurements
from backend.pose_graph.minimise import minimise
from backend.pose_graph.problem import Problem, spatial_poses
from backend.pose_graph.unary_factors import aligned, jacobian

Array = NDArray[np.float64]

BUDGET_S = 0.02
_REST = 100
"""Keyframes between two updates that break the budget: one in a hundred may."""
_WEAK = 30.0
"""rad and m: a hold that gives way to any measurement."""
_MOVED = 0.05
"""rad and m: what has moved by more is linearised anew."""


@dataclass(frozen=True)
class IncrementalUpdate:
    """What a new keyframe brought."""

    w_T_b: Array
    """(4, 4) where the new keyframe is."""
    waiting: int
    """Loops that were not taken in yet."""
    refused: tuple[str, ...] = ()
    """Loops that could not be taken in, with the reason."""
    rebuilt: str = ""
    """Why everything was built anew; empty where it was not."""


class Incremental:
    """Keyframes 0, 1, 2, ... as they come; what the first one does not measure is held where it starts."""

    def __init__(self, budget_s: float = BUDGET_S) -> None:
        self.budget_s = budget_s
        self.count = 0
        self._log = gtsam.NonlinearFactorGraph()
        self._start = gtsam.Values()
        self._isam = _isam("CHOLESKY")
        self._waiting: list[RelativePose] = []
        self._rest = 0

    def add(
        self,
        relative_poses: tuple[RelativePose, ...] = (),
        attitudes: tuple[Attitude, ...] = (),
        ranges: tuple[SlantRange, ...] = (),
        positions: tuple[Position, ...] = (),
        w_T_b: Array | None = None,
    ) -> IncrementalUpdate:
        """The next keyframe, number ``count``, with the measurements that came with it.

        One of its relative poses must join it to an earlier one; the first may be given a pose (4, 4).
        Raises ``BackendError`` for bad figures: then nothing was taken in.
        """
        number = self.count
        here = [e for e in relative_poses if number in (e.i, e.j)]
        if number and not here:
            raise BackendError(f"no relative pose joins keyframe {number} to an earlier one")
        if any(max(e.i, e.j) > number for e in relative_poses):
            raise BackendError(f"a relative pose names a keyframe after the newest, {number}")
        anchor = min(here, key=lambda e: e.kind == "loop") if here else None
        loops = [e for e in relative_poses if e.kind == "loop" and e is not anchor]
        now = tuple(e for e in relative_poses if e.kind != "loop" or e is anchor)
        measured = Measurements(np.zeros(0), now, attitudes, ranges, positions)
        problem, keys = _renumbered(measured, number)
        _renumbered(Measurements(np.zeros(0), tuple(loops)), number)  # refused before it waits
        factors = _factors(problem, keys)
        if anchor is None:
            start = _first(problem, w_T_b)
            factors.push_back(_hold(problem, start))
        else:
            start = self._predicted(anchor, number)
        values = gtsam.Values()
        values.insert(number, gtsam.Pose3(start))
        self._start.insert(number, gtsam.Pose3(start))
        rebuilt, _ = self._take_in(factors, values)
        self.count += 1
        self._waiting += loops
        refused: tuple[str, ...] = ()
        self._rest -= 1
        if self._waiting and self._rest <= 0:
            again, refused = self._take_in_loops()
            rebuilt = rebuilt or again
        return IncrementalUpdate(self.pose(number), len(self._waiting), refused, rebuilt)

    def pose(self, k: int) -> Array:
        """(4, 4) where keyframe ``k`` is by now."""
        return np.asarray(self._isam.calculateEstimatePose3(k).matrix(), dtype=np.float64)

    def trajectory(self) -> Array:
        """(n, 4, 4) where all keyframes are by now."""
        return spatial_poses(self._isam.calculateEstimate())

    def settle(self) -> IncrementalUpdate:
        """Take in what waits and solve all anew, at any price: the batch's answer."""
        if self.count == 0:
            raise BackendError("there is no keyframe: nothing to settle")
        rebuilt, refused = self._take_in_loops()
        self._start = self._isam.calculateEstimate()
        self._rebuild(self._log)
        return IncrementalUpdate(self.pose(self.count - 1), 0, refused, rebuilt)

    def error(self) -> float:
        """Half the squared whitened residuals of all that was taken in, by their robust losses."""
        return float(self._log.error(self._isam.calculateEstimate()))

    def _predicted(self, anchor: RelativePose, number: int) -> Array:
        if anchor.j == number:
            return self.pose(anchor.i) @ anchor.i_T_j
        return self.pose(anchor.j) @ np.linalg.inv(anchor.i_T_j)

    def _take_in_loops(self) -> tuple[str, tuple[str, ...]]:
        loops, self._waiting = tuple(self._waiting), []
        begin = time.perf_counter()
        problem, keys = _renumbered(Measurements(np.zeros(0), loops), self.count)
        rebuilt, refused = self._take_in(_factors(problem, keys), gtsam.Values(), loops)
        if time.perf_counter() - begin > self.budget_s:
            self._rest = _REST
        return rebuilt, refused

    def _take_in(
        self, factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, loops: tuple[RelativePose, ...] = ()
    ) -> tuple[str, tuple[str, ...]]:
        """Why ISAM2 was built anew, and loops that had to be left out."""
        try:
            self._isam.update(factors, values, force_relinearize=bool(loops))
            self._log.push_back(factors)
        except (RuntimeError, ValueError, IndexError) as error:
            why = first_line(error)
        else:
            return "", ()
        with_factors = gtsam.NonlinearFactorGraph(self._log)
        with_factors.push_back(factors)
        try:
            self._rebuild(with_factors)
        except BackendError as refusal:
            if not loops:
                raise
            self._rebuild(self._log)
            return why, tuple(f"the loop {e.i}-{e.j} was left out: {refusal}" for e in loops)
        self._log = with_factors
        return why, ()

    def _rebuild(self, log: gtsam.NonlinearFactorGraph) -> None:
        at = minimise(log, self._start).values
        # Cholesky squares the condition number, and a long chain may be what it failed at.
        fresh = _isam("QR")
        try:
            fresh.update(log, at)
        except (RuntimeError, ValueError, IndexError) as error:
            raise BackendError(f"it cannot be built anew: {first_line(error)}") from error
        self._isam, self._start = fresh, at


def _isam(factorization: str) -> gtsam.ISAM2:
    params = gtsam.ISAM2Params()
    params.setFactorization(factorization)
    params.setRelinearizeThreshold(_MOVED)
    # Only when loops come, or on request: it costs as much as they do.
    params.enableRelinearization = False
    return gtsam.ISAM2(params)


def _renumbered(measured: Measurements, number: int) -> tuple[Problem, list[int]]:
    """The new measurements as a problem of few poses, and their true keys. Raises ``BackendError``."""
    owners = [
        single.k for kind in (measured.attitudes, measured.ranges, measured.positions) for single in kind
    ]
    if any(k != number for k in owners):
        raise BackendError(f"a measurement is not of the newest keyframe, {number}")
    keys = sorted({number, *(k for e in measured.relative_poses for k in (e.i, e.j))})
    if keys[0] < 0:
        raise BackendError(f"a relative pose names keyframe {keys[0]}")
    place = {key: k for k, key in enumerate(keys)}
    local = Measurements(
        np.zeros(len(keys)),
        tuple(replace(e, i=place[e.i], j=place[e.j]) for e in measured.relative_poses),
        tuple(replace(a, k=place[a.k]) for a in measured.attitudes),
        tuple(replace(r, k=place[r.k]) for r in measured.ranges),
        tuple(replace(p, k=place[p.k]) for p in measured.positions),
        names=tuple(str(key) for key in keys),
    )
    return from_measurements(local, None)[0], keys


def _factors(problem: Problem, keys: list[int]) -> gtsam.NonlinearFactorGraph:
    factors = problem.edge_factors()
    factors.push_back(problem.unary_factor_graph())
    out = gtsam.NonlinearFactorGraph()
    for factor in (factors.at(k) for k in range(factors.size())):
        out.push_back(factor.rekey([keys[k] for k in list(factor.keys())]))
    return out


def _first(problem: Problem, w_T_b: Array | None) -> Array:
    if w_T_b is not None:
        if w_T_b.shape != (4, 4) or not np.isfinite(w_T_b).all():
            raise BackendError("the pose of the first keyframe is not a finite (4, 4) transform")
        return w_T_b
    return aligned(np.eye(4)[None], problem.unary_factors)[0]


def _hold(problem: Problem, start: Array) -> gtsam.NonlinearFactorGraph:
    """A prior on what the first keyframe's own measurements leave open: a weak one, since later ones may tell
    it; a tight one where it measures nothing, since all is relative to it then."""
    out = gtsam.NonlinearFactorGraph()
    if not problem.unary_factors:
        out.push_back(gauge_prior(0, start, np.eye(6)))
        return out
    directions = unobserved_directions([jacobian(a, start, start[:3, 3]) for a in problem.unary_factors])
    if len(directions):
        out.push_back(gauge_prior(0, start, directions, _WEAK))
    return out
