"""Errors of the motion during the read-out of each picture, which covariances of poses include.

How a camera turns and moves while its rows are read is known from noisy instruments, and is even only nearly.
What is wrong with it bends all points of a picture together, which the noise of single pixels does not show.
It counts as a turn from the first row to the last, of the same standard deviation about each axis in all
pictures. The residuals of the map tell that deviation by the method of moments: the squares of their
gradients by these turns, over what the noise of pixels explains.

Source: Searle, Casella and McCulloch 1992, Variance Components, chapter 5 (moments of random effects).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from backend.bundle.exposure_motion import READOUT
from backend.bundle.graph import WORLD
from backend.bundle.minimise import BundleOptimum
from backend.bundle.observations import Cameras
from backend.bundle.reduced_system import LinearSystem, ReducedSystem
from backend.se3 import cross_matrix

Array = NDArray[np.float64]

_AT_ONCE = 16
"""Pictures whose turns are eliminated together, so that memory does not grow with the number of pictures."""


def row_motion_covariances(
    optimum: BundleOptimum, linear: LinearSystem, reduced: ReducedSystem, readout_std_s: float
) -> Array:
    """Return what errors of the motion during the read-out add to the joint covariances (n, 6 + w, 6 + w) of
    each pose and the world; 0 for a global shutter.

    ``readout_std_s`` is the standard deviation of a read-out time that is a variable. Where it is larger than
    that of the system, because residuals are dependent, that counts too.
    """
    world = np.arange(reduced.size)[reduced.structure.columns(WORLD)]
    pose = np.array(
        [
            np.arange(reduced.size)[reduced.structure.columns(POSE(k))]
            for k in range(optimum.problem.measurements.count)
        ]
    )
    rows = np.hstack([pose, np.broadcast_to(world, (len(pose), len(world)))])
    added = np.zeros((len(rows), rows.shape[1], rows.shape[1]))
    if optimum.problem.exposure_motion is None:
        return added
    squares, expected, power, of_readout = 0.0, 0.0, 0.0, 0.0
    at = _readout_column(reduced)
    for score, left, follow in _turns(optimum, linear, reduced):
        squares += float(np.sum(score**2))
        expected += float(np.einsum("kaa->", left))
        power += float(np.sum(left**2))
        of_rows = follow[rows]
        added += of_rows @ np.swapaxes(of_rows, 1, 2)
        of_readout += float(follow[at] @ follow[at]) if at is not None else 0.0
    variance = max(squares - expected, 0.0) / power if power > 0 else 0.0
    added *= variance
    if at is not None:
        unit = np.zeros(reduced.size)
        unit[at] = 1.0
        change = reduced.factor.solve(unit)
        more = readout_std_s**2 - float(change[at]) - variance * of_readout
        by_second = change[rows] / change[at]
        added += max(more, 0.0) * by_second[:, :, None] * by_second[:, None, :]
    return added


def _readout_column(reduced: ReducedSystem) -> int | None:
    return reduced.structure.columns(READOUT).start if READOUT in reduced.structure.variable else None


def _turns(
    optimum: BundleOptimum, linear: LinearSystem, reduced: ReducedSystem
) -> Iterator[tuple[Array, Array, Array]]:
    """Yield, for some pictures at a time, the gradients (k, 3) of the residuals by a turn of each, with all
    else free to follow, their covariances (k, 3, 3) by the noise of pixels, and how the pose side follows
    (size, 3k) an error of each turn."""
    problem, seen = optimum.problem, optimum.cost.observations
    motion = problem.exposure_motion
    assert motion is not None
    f_T_c = Cameras.of(problem, optimum.values).f_T_c
    jacobian, right = linear.jacobian()
    right = right - jacobian @ np.concatenate(reduced.solve(*linear.gradient))
    arm = optimum.at.point[seen.track] - f_T_c[seen.keyframe, :3, 3]
    late = motion.since_middle(motion.recorded_px[seen.number])
    by_turn = late[:, None, None] * (linear.seen.of_point @ cross_matrix(arm))
    known = np.flatnonzero(motion.is_known)
    for some in np.array_split(known, -(-len(known) // _AT_ONCE)) if len(known) else []:
        mine = np.flatnonzero(np.isin(seen.keyframe, some))
        columns = 3 * np.searchsorted(some, seen.keyframe[mine])[:, None] + np.arange(3)
        rows = (2 * mine[:, None] + np.arange(2)).ravel()
        entries = by_turn[mine].ravel(), (np.repeat(rows, 3), np.repeat(columns, 2, axis=0).ravel())
        own = csr_array(coo_array(entries, shape=(len(right), 3 * len(some))))
        mixed = (jacobian.T @ own).toarray()
        by_pose, by_point = reduced.solve(mixed[: reduced.size], mixed[reduced.size :])
        left = (own.T @ own).toarray() - mixed.T @ np.vstack([by_pose, by_point])
        each = np.arange(3 * len(some)).reshape(-1, 3)
        yield np.asarray(own.T @ right).reshape(-1, 3), left[each[:, :, None], each[:, None, :]], -by_pose
