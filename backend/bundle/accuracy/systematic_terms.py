"""Errors that all pictures or all positions share, as additional columns of the Jacobian of a refinement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend import se3
from backend.bundle.lens import CENTER, FOCAL, NAMES
from backend.bundle.minimise import BundleOptimum
from backend.bundle.observations import Cameras
from backend.bundle.projections import distorted
from backend.measurements import LensModel
from backend.pose_graph.linear import jacobian

Array = NDArray[np.float64]
Kind = Literal["radial", "decentring", "principal point", "position offset"]

_NUMBERS: Mapping[Kind, tuple[str, str]] = {
    "radial": ("k1", "k2"),
    "decentring": ("p1", "p2"),
    "principal point": ("cx", "cy"),
}
"""Numbers of the calibration that each kind of error changes."""
LENS_KINDS: tuple[Kind, ...] = tuple(_NUMBERS)


def _numbers(model: LensModel) -> dict[Kind, list[int]]:
    """Return the places in the calibration of each kind of error that the model of the lens has."""
    names = NAMES[model]
    return {
        kind: [names.index(name) for name in changed]
        for kind, changed in _NUMBERS.items()
        if set(changed) <= set(names)
    }


def lens_displacement(model: LensModel, kind: Kind, coefficients: Array, xy: Array) -> Array:
    """Return by how much a lens error displaces image points ``xy`` (m, 2), both over the focal length."""
    ideal, xy = np.zeros(len(NAMES[model])), np.ascontiguousarray(xy)
    ideal[FOCAL] = 1.0
    wrong = ideal.copy()
    wrong[_numbers(model)[kind]] += coefficients
    return distorted(wrong, xy) - distorted(ideal, xy)


@dataclass(frozen=True)
class AddedColumns:
    """Derivatives of the whitened residuals by coefficients that the model lacks."""

    columns: Mapping[Kind, Array]
    """(rows, c) for each kind of error."""
    keyframe: NDArray[np.int64]
    """(rows,) keyframe of each row; 0 for rows that belong to none."""


def added_columns(optimum: BundleOptimum) -> AddedColumns:
    """Return the columns for the lens and, where there are positions, for an offset in body axes.

    The offset is forward and left. Upward it would be one of the world's height, which is free.

    They are whitened, with the weights of the robust losses, in the order of the rows of
    `LinearSystem.jacobian` at the optimum.
    """
    picture = row_pictures(optimum)
    columns = _of_pixels(optimum, len(picture))
    if optimum.problem.measurements.positions:
        columns["position offset"] = _of_positions(optimum, len(picture))
    return AddedColumns(columns, np.maximum(picture, 0))


def row_pictures(optimum: BundleOptimum) -> NDArray[np.int64]:
    """Return the keyframe (rows,) of each row of `LinearSystem.jacobian`, -1 for rows that belong to none."""
    seen = optimum.cost.observations
    # The height of a point belongs to the last picture that shows it.
    last = np.zeros(len(optimum.at.point), dtype=np.int64)
    np.maximum.at(last, seen.track, seen.keyframe)
    of_pose_side = optimum.cost.pose_side.keyframes
    return np.concatenate([np.repeat(seen.keyframe, 2), np.repeat(last, 3), of_pose_side])


def _of_pixels(optimum: BundleOptimum, rows: int) -> dict[Kind, Array]:
    cameras = Cameras.of(optimum.problem, optimum.values)
    by_lens = optimum.cost.observations.linearise(cameras, optimum.at.point, True).of_calibration
    by_lens = by_lens.reshape(-1, by_lens.shape[2])
    by_lens[:, CENTER] *= cameras.calibration[FOCAL]
    columns: dict[Kind, Array] = {}
    for kind, numbers in _numbers(optimum.problem.camera.lens).items():
        columns[kind] = np.zeros((rows, len(numbers)))
        columns[kind][: len(by_lens)] = by_lens[:, numbers]
    return columns


def _of_positions(optimum: BundleOptimum, rows: int) -> Array:
    """Return the columns (rows, 2): an offset moves a position as a motion of the camera does."""
    factors = optimum.cost.pose_side
    mine = np.flatnonzero(factors.rows_of("position"))
    scale = optimum.transform.scale
    c_T_b = se3.inverse(optimum.problem.b_T_c(optimum.values))
    columns = np.zeros((rows, 2))
    of_pose_side = columns[rows - len(factors.keyframes) :]
    by_row = jacobian(factors.graph, optimum.values, optimum.structure.by_key).tocsr()
    for row, k in zip(mine.tolist(), factors.keyframes[mine].tolist(), strict=True):
        along = by_row[[row]].toarray()[0, optimum.structure.columns(POSE(k))][3:]
        of_pose_side[row] = along @ c_T_b[:3, :2] / scale
    return columns
