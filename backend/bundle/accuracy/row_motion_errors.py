"""Errors of the motion during the read-out of each picture, which covariances of poses include.

Noisy instruments tell how a camera turns and moves while its rows are read, and its velocity is not quite
constant. An error of that motion moves all points of a picture together, which the noise of single pixels
does not include. It counts as a turn from the first row to the last, of the same standard deviation about
each axis in all pictures. The residuals of the map give that deviation by the method of moments: from the
squares of their gradients by these turns, less what the noise of pixels explains.

Source: Searle, Casella and McCulloch 1992, Variance Components, chapter 5 (moments of random effects).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.exposure_motion import READOUT, since_middle
from backend.bundle.factors import WORLD
from backend.bundle.minimise import BundleOptimum
from backend.bundle.observations import Cameras
from backend.bundle.picture_variables import PictureVariables, picture_variables
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

    ``readout_std_s`` is the standard deviation of a read-out time that is a variable. Because residuals are
    dependent, it may be larger than that of the system: the difference counts too.
    """
    poses = [POSE(k) for k in range(optimum.problem.measurements.count)]
    world = reduced.structure.columns_of([WORLD]).repeat(len(poses), axis=0)
    rows = np.hstack([reduced.structure.columns_of(poses), world])
    added = np.zeros((len(rows), rows.shape[1], rows.shape[1]))
    if optimum.problem.exposure_motion is None:
        return added
    squares, expected, power, of_readout = 0.0, 0.0, 0.0, 0.0
    at = _readout_column(reduced)
    for turns in _turns(optimum, linear, reduced):
        k, follow = np.arange(len(turns.pictures)), turns.follow
        information = turns.information.reshape(len(k), 3, len(k), 3)[k, :, k]
        squares += float(np.sum(turns.gradient**2))
        expected += float(np.einsum("kaa->", information))
        power += float(np.sum(information**2))
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
) -> Iterator[PictureVariables]:
    """Yield, for some pictures at a time, the equations of a turn of each."""
    problem, seen = optimum.problem, optimum.cost.observations
    motion = problem.exposure_motion
    assert motion is not None
    f_T_c = Cameras.of(problem, optimum.values).f_T_c
    arm = optimum.at.point[seen.track] - f_T_c[seen.keyframe, :3, 3]
    late = since_middle(motion.recorded_px[seen.number], motion.rows)
    by_turn = late[:, None, None] * (linear.seen.of_point @ cross_matrix(arm))
    return picture_variables(linear, reduced, np.flatnonzero(motion.is_known), by_turn, _AT_ONCE)
