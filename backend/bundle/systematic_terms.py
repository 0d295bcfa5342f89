"""Errors that all pictures or all positions share, as additional columns of the Jacobian of a refinement."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from backend.bundle.factors import LOG_SCALE
from backend.bundle.graph import WORLD, BundleOptimum

Array = NDArray[np.float64]
Kind = Literal["radial", "decentring", "principal point", "position offset"]

_OF_LENS: Mapping[Kind, Callable[[Array, Array], list[tuple[Array, Array]]]] = {
    "radial": lambda x, y: [(x * power, y * power) for power in (x**2 + y**2, (x**2 + y**2) ** 2)],
    "decentring": lambda x, y: [(2 * x * y, x**2 + 3 * y**2), (3 * x**2 + y**2, 2 * x * y)],
    "principal point": lambda x, y: [(np.ones_like(x), 0 * x), (0 * x, np.ones_like(x))],
}
"""Displacements at image points over the focal length, for each coefficient: k1 and k2; p1 and p2; the offset
of the principal point over the focal length. Source: Brown 1966, in OpenCV's notation."""

LENS_KINDS: tuple[Kind, ...] = tuple(_OF_LENS)
_POSITION_ROWS = 3


def lens_displacement(kind: Kind, coefficients: Array, xy: Array) -> Array:
    """Return by how much a lens error displaces image points ``xy`` (m, 2), both over the focal length."""
    terms = zip(coefficients, _OF_LENS[kind](*xy.T), strict=True)
    return np.asarray(sum(c * np.column_stack(term) for c, term in terms))


@dataclass(frozen=True)
class AddedColumns:
    """Derivatives of the whitened residuals by coefficients that the model lacks."""

    columns: Mapping[Kind, Array]
    """(rows, c) for each kind of error."""
    keyframe: NDArray[np.int64]
    """(rows,) keyframe of each row; 0 for rows that belong to none."""


def added_columns(optimum: BundleOptimum, jacobian: csc_array, left: Array) -> AddedColumns:
    """Return the columns for the lens and, where there are positions, for an offset in body axes.

    The offset is forward and left. Upward it would be one of the world's height, which is free.

    ``jacobian`` (rows, dimensions), columns by key, and ``left`` (rows,), the residuals, are whitened, with
    the weights of the robust losses.
    """
    tracks, seen = optimum.problem.tracks, np.flatnonzero(optimum.used)
    # The height of a point belongs to the last picture that shows it.
    last = np.zeros(int(tracks.track.max()) + 1, dtype=np.int64)
    np.maximum.at(last, tracks.track[seen], tracks.keyframe[seen])
    keyframe = np.zeros(len(left), dtype=np.int64)
    keyframe[: 2 * len(seen)] = np.repeat(tracks.keyframe[seen], 2)
    at = 2 * len(seen)
    positions: list[tuple[int, int]] = []
    for number in range(len(seen), optimum.graph.size()):
        factor = optimum.graph.at(number)
        keys, size = factor.keys(), factor.dim()
        first = gtsam.Symbol(keys[0])
        kind, index = first.string()[0], first.index()
        keyframe[at : at + size] = last[index] if kind == "l" else index if kind == "x" else 0
        if kind == "x" and len(keys) == 2 and size == _POSITION_ROWS:
            positions.append((at, index))
        at += size
    columns = _of_pixels(optimum, seen, left)
    if positions:
        columns["position offset"] = _of_positions(optimum, jacobian, positions)
    return AddedColumns(columns, keyframe)


def _of_pixels(optimum: BundleOptimum, seen: NDArray[np.int64], left: Array) -> dict[Kind, Array]:
    problem = optimum.problem
    tracks, camera, sigmas = problem.tracks, problem.camera, problem.config.huber_sigmas
    std_px = (tracks.std_px * optimum.noise.pixel_scale)[seen]
    weighted = left[: 2 * len(seen)].reshape(-1, 2)
    # Huber's loss multiplies residuals beyond the limit by sqrt(limit / distance).
    weight = np.minimum(1.0, sigmas / np.maximum(np.linalg.norm(weighted, axis=1), 1e-12)) / std_px
    focal = np.array(camera.focal_px)
    x, y = ((tracks.pixel[seen] - weighted / weight[:, None] - camera.center_px) / focal).T
    columns: dict[Kind, Array] = {}
    for kind, terms in _OF_LENS.items():
        displaced = [(np.column_stack(term) * focal * weight[:, None]).ravel() for term in terms(x, y)]
        columns[kind] = np.zeros((len(left), len(displaced)))
        columns[kind][: 2 * len(seen)] = np.column_stack(displaced)
    return columns


def _of_positions(optimum: BundleOptimum, jacobian: csc_array, positions: list[tuple[int, int]]) -> Array:
    """Return the columns (rows, 2): an offset moves a position as a motion of the camera does."""
    rows, size = jacobian.shape
    scale = float(np.exp(optimum.values.atVector(WORLD)[LOG_SCALE]))
    c_T_b = np.linalg.inv(optimum.problem.b_T_c(optimum.values))
    first_pose = size - 6 * optimum.problem.measurements.count  # poses come last by key
    by_row, columns = jacobian.tocsr(), np.zeros((rows, 2))
    for at, k in positions:
        along = first_pose + 6 * k + 3
        moved = by_row[at : at + _POSITION_ROWS, along : along + 3].toarray()
        columns[at : at + _POSITION_ROWS] = moved @ c_T_b[:3, :2] / scale
    return columns
