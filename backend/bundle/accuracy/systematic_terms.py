"""Errors that all pictures or all positions share, as additional columns of the Jacobian of a refinement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.factors import LOG_SCALE
from backend.bundle.graph import WORLD
from backend.bundle.lens import CENTER, FOCAL, NAMES
from backend.bundle.minimise import BundleOptimum
from backend.bundle.observations import Cameras
from backend.bundle.projections import distorted
from backend.bundle.reduced_system import LinearSystem
from backend.measurements import LensModel

Array = NDArray[np.float64]
Kind = Literal["radial", "decentring", "principal point", "position offset"]

_NUMBERS: Mapping[Kind, tuple[str, str]] = {
    "radial": ("k1", "k2"),
    "decentring": ("p1", "p2"),
    "principal point": ("cx", "cy"),
}
"""Numbers of the calibration that each kind of error changes."""
LENS_KINDS: tuple[Kind, ...] = tuple(_NUMBERS)
_POSITION_ROWS = 3


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


def added_columns(optimum: BundleOptimum, linear: LinearSystem, rows: int) -> AddedColumns:
    """Return the columns for the lens and, where there are positions, for an offset in body axes.

    The offset is forward and left. Upward it would be one of the world's height, which is free.

    They are whitened, with the weights of the robust losses, in the order of the ``rows`` of
    `LinearSystem.jacobian`.
    """
    graph = optimum.cost.pose_side
    first_row = at = rows - sum(graph.at(number).dim() for number in range(graph.size()))
    positions: list[tuple[int, int]] = []
    for factor in (graph.at(number) for number in range(graph.size())):
        keys, size, pose = factor.keys(), factor.dim(), _first_pose(factor)
        if pose is not None and WORLD in keys and size == _POSITION_ROWS:
            positions.append((at, pose))
        at += size
    columns = _of_pixels(optimum, rows)
    if positions:
        columns["position offset"] = _of_positions(optimum, linear, rows, first_row, positions)
    return AddedColumns(columns, np.maximum(row_pictures(optimum), 0))


def row_pictures(optimum: BundleOptimum) -> NDArray[np.int64]:
    """Return the keyframe (rows,) of each row of `LinearSystem.jacobian`, -1 for rows that belong to none."""
    seen, graph = optimum.cost.observations, optimum.cost.pose_side
    # The height of a point belongs to the last picture that shows it.
    last = np.zeros(len(optimum.at.point), dtype=np.int64)
    np.maximum.at(last, seen.track, seen.keyframe)
    keyframe = [np.repeat(seen.keyframe, 2), np.repeat(last, 3)]
    for factor in (graph.at(number) for number in range(graph.size())):
        pose = _first_pose(factor)
        keyframe.append(np.full(factor.dim(), -1 if pose is None else pose))
    return np.concatenate(keyframe)


def _first_pose(factor: gtsam.NonlinearFactor) -> int | None:
    """Return the number of the first pose that a factor concerns; None without any."""
    symbols = map(gtsam.Symbol, factor.keys())
    return next((symbol.index() for symbol in symbols if symbol.chr() == ord("x")), None)


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


def _of_positions(
    optimum: BundleOptimum, linear: LinearSystem, rows: int, first_row: int, positions: list[tuple[int, int]]
) -> Array:
    """Return the columns (rows, 2): an offset moves a position as a motion of the camera does.

    The rows of the pose side begin at ``first_row``.
    """
    scale = float(np.exp(optimum.values.atVector(WORLD)[LOG_SCALE]))
    c_T_b = np.linalg.inv(optimum.problem.b_T_c(optimum.values))
    by_row, columns = linear.pose_side.tocsr(), np.zeros((rows, 2))
    for at, k in positions:
        moved = by_row[at - first_row : at - first_row + _POSITION_ROWS].toarray()
        along = moved[:, linear.structure.columns(POSE(k))][:, 3:]
        columns[at : at + _POSITION_ROWS] = along @ c_T_b[:3, :2] / scale
    return columns
