"""Quality rasters of a mosaic: number of pictures, position uncertainty and brightness difference.

They have one value per cell of the plan, so that they cost little compared with the mosaic itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frontend.mosaic.canvas import CELL_PX
from frontend.mosaic.exposure import Exposure
from frontend.mosaic.plan import MosaicPlan
from frontend.mosaic.view import Lattice, MosaicView

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class MosaicQuality:
    """Rasters (rows, cols) over the cells of a plan, NaN where the mosaic is empty."""

    cell_m: float
    pictures: Float32
    """Number of placed pictures that see the centre of the cell."""
    position_std_m: Float32
    """Standard deviation of the position of the ground: root of the summed variances in x and y."""
    seam_share: Float32
    """Root mean square brightness difference between two pictures of one point of the cell, after exposure
    compensation, as a share of the brightness; NaN where no two were compared."""


def mosaic_quality(
    plan: MosaicPlan,
    exposure: Exposure,
    w_T_b: Array,
    covariances: Array,
    height_std_m: Float32 | None = None,
) -> MosaicQuality:
    """Return the quality for poses (n, 4, 4) with covariances (n, 6, 6).

    Covariances have the rotation first and are those of a right perturbation in body axes. ``height_std_m``:
    standard deviation of the heights of the plan's surface, on its lattice. None: they are exact.
    """
    empty = plan.owner < 0
    pictures, std = np.zeros(plan.owner.shape, np.float32), np.full(plan.owner.shape, np.nan, np.float32)
    for view in plan.all_views(w_T_b):
        where, lattice = plan.cells_under(view)
        pictures[where] += _inside(plan, view, lattice)
    for index, view in enumerate(plan.views):
        where, lattice = plan.cells_under(view)
        own = plan.owner[where] == index
        if own.any():
            z_m, of_height = _heights(plan, lattice, height_std_m)
            found = ground_std(view, w_T_b[view.k], covariances[view.k], lattice, z_m, of_height)
            std[where][own] = found[own]
    # The owner of a cell shows a part of it, even if the centre lies just outside the picture.
    pictures = np.where(empty, np.nan, np.maximum(pictures, 1)).astype(np.float32)
    return MosaicQuality(CELL_PX * plan.gsd_m, pictures, std, _seam_raster(plan, exposure))


def _inside(plan: MosaicPlan, view: MosaicView, lattice: Lattice) -> NDArray[np.bool_]:
    return plan.pixels(view, lattice)[2]


def _heights(
    plan: MosaicPlan, lattice: Lattice, height_std_m: Float32 | None
) -> tuple[Float32 | float, Float32 | float]:
    """Return z of the ground at the nodes of a lattice, and the standard deviation of its height."""
    if plan.surface is None:
        return plan.floor_z_m, 0.0
    heights = plan.surface.heights(lattice)
    z_m = plan.floor_z_m if heights is None else np.float32(plan.floor_z_m) + heights
    return z_m, 0.0 if height_std_m is None else plan.surface.nearest(lattice, height_std_m)


def ground_std(
    view: MosaicView,
    w_T_b: Array,
    covariance: Array,
    lattice: Lattice,
    ground_z_m: Float32 | float,
    height_std_m: Float32 | float = 0.0,
) -> Float32:
    """Return (rows, cols) the standard deviation in metres of the ground position at each node of a picture.

    It is propagated to first order, as in Haralick 1996, Propagating covariance in computer vision. An error
    of the height of the ground displaces it along the ray.
    """
    x = lattice.x0_m + lattice.step_m * np.arange(lattice.cols)
    y = lattice.y0_m - lattice.step_m * np.arange(lattice.rows)
    p = np.stack(np.broadcast_arrays(x[None], y[:, None], ground_z_m), axis=-1)
    rotation = np.kron(np.eye(2), w_T_b[:3, :3])
    C = rotation @ covariance @ rotation.T
    J = ground_jacobian(p, view.w_p_c_m, w_T_b[:3, 3])
    ray = p - view.w_p_c_m
    by_height = (ray[..., :2] ** 2).sum(axis=-1) * (height_std_m / ray[..., 2]) ** 2
    return np.asarray(np.sqrt(np.einsum("rcai,ij,rcaj->rc", J, C, J) + by_height).astype(np.float32))


def ground_jacobian(w_p: Array, w_p_c: Array, w_p_b: Array) -> Array:
    """Return the Jacobian (..., 2, 6) of seen floor positions with respect to rotation and translation.

    A camera at ``w_p_c`` (3,) on a body at ``w_p_b`` (3,) sees the floor points ``w_p`` (..., 3). Both
    perturbations of the body are in world axes. The end of each ray moves with the body, and then along the
    ray back to the floor. Source: derived.
    """
    ray, arm = w_p - w_p_c, w_p - w_p_b
    slide = -ray[..., :2] / ray[..., 2:]
    J = np.zeros((*w_p.shape[:-1], 2, 6))
    for a in range(2):
        along = np.zeros_like(w_p)
        along[..., a], along[..., 2] = 1.0, slide[..., a]
        J[..., a, :3], J[..., a, 3:] = np.cross(arm, along), along
    return J


def _seam_raster(plan: MosaicPlan, exposure: Exposure) -> Float32:
    """Return (rows, cols) the brightness difference of the sampling point nearest to each cell."""
    rows, cols = plan.owner.shape
    out = np.full((rows, cols), np.nan, np.float32)
    if len(exposure.point):
        squares, pitch = plan.sampling, plan.sampling.pitch_px
        sampled = np.full((squares.rows, squares.cols), np.nan, np.float32)
        sampled.ravel()[exposure.point] = exposure.point_seam
        r = np.minimum((np.arange(rows) * CELL_PX + CELL_PX // 2 - squares.row) // pitch, squares.rows - 1)
        c = np.minimum((np.arange(cols) * CELL_PX + CELL_PX // 2 - squares.col) // pitch, squares.cols - 1)
        out = sampled[np.ix_(r, c)]
    return np.where(plan.owner < 0, np.nan, out).astype(np.float32)
