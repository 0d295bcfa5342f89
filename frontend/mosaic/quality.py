"""How far each piece of a mosaic is to be trusted: how often it was seen, how well it is placed, how well
the pictures agree there. On the plan's cells, so that it costs little beside the mosaic itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frontend.mosaic.canvas import CELL_PX
from frontend.mosaic.exposure import Exposure
from frontend.mosaic.plan import MosaicPlan
from frontend.mosaic.view import Lattice, MosaicView, mosaic_view, pixel_maps, visible

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class MosaicQuality:
    """Rasters (rows, cols) over the cells of a plan, NaN where the mosaic is empty."""

    cell_m: float
    pictures: Float32
    """How many placed pictures see the middle of the cell."""
    position_std_m: Float32
    """Standard deviation of where the ground drawn there lies: root of the summed variances in x and y."""
    seam_share: Float32
    """Root mean square difference in brightness between two pictures of one point of the cell, exposure
    compensated, as a share of the brightness; NaN where no two were compared."""


def mosaic_quality(
    plan: MosaicPlan, exposure: Exposure, w_T_b: Array, covariances: Array, floor_z_m: float
) -> MosaicQuality:
    """For poses (n, 4, 4) with covariances (n, 6, 6), rotation first, right perturbation in body axes."""
    empty = plan.owner < 0
    pictures, std = np.zeros(plan.owner.shape, np.float32), np.full(plan.owner.shape, np.nan, np.float32)
    for k, pose in enumerate(np.asarray(w_T_b, dtype=float)):
        view = None if k in plan.left_out else mosaic_view(plan.camera, k, pose, floor_z_m)
        if isinstance(view, MosaicView):
            where, lattice = plan.cells_under(view)
            pictures[where] += _inside(plan, view, lattice)
    for index, view in enumerate(plan.views):
        where, lattice = plan.cells_under(view)
        mine = plan.owner[where] == index
        if mine.any():
            std[where][mine] = ground_std(view, w_T_b[view.k], covariances[view.k], lattice, floor_z_m)[mine]
    # Who owns a cell shows some of it, even where its middle lies just outside.
    pictures = np.where(empty, np.nan, np.maximum(pictures, 1)).astype(np.float32)
    return MosaicQuality(CELL_PX * plan.gsd_m, pictures, std, _seams(plan, exposure))


def _inside(plan: MosaicPlan, view: MosaicView, lattice: Lattice) -> NDArray[np.bool_]:
    seen, _, _ = visible(view, lattice)
    u, v = pixel_maps(plan.camera, view, lattice)
    w, h = plan.camera.size_px
    return seen & (u >= 0) & (u <= w - 1) & (v >= 0) & (v <= h - 1)


def ground_std(
    view: MosaicView, w_T_b: Array, covariance: Array, lattice: Lattice, floor_z_m: float
) -> Float32:
    """(rows, cols): how uncertain the place of what a picture shows at each node is, in metres.

    First order, as in Haralick 1996, Propagating covariance in computer vision.
    """
    x = lattice.x0_m + lattice.step_m * np.arange(lattice.cols)
    y = lattice.y0_m - lattice.step_m * np.arange(lattice.rows)
    p = np.stack(np.broadcast_arrays(x[None], y[:, None], floor_z_m), axis=-1)
    turned = np.kron(np.eye(2), w_T_b[:3, :3])
    C = turned @ covariance @ turned.T
    J = ground_jacobian(p, view.w_p_c_m, w_T_b[:3, 3])
    return np.asarray(np.sqrt(np.einsum("rcai,ij,rcaj->rc", J, C, J)).astype(np.float32))


def ground_jacobian(w_p: Array, w_p_c: Array, w_p_b: Array) -> Array:
    """(..., 2, 6) of where a camera at ``w_p_c`` (3,) shows floor points ``w_p`` (..., 3), by the pose of the
    body at ``w_p_b`` (3,): its turn and its step, both in world axes. Source: derived.

    The end of the ray moves with the body; along the ray it slides back to the floor.
    """
    ray, arm = w_p - w_p_c, w_p - w_p_b
    slide = -ray[..., :2] / ray[..., 2:]
    J = np.zeros((*w_p.shape[:-1], 2, 6))
    for a in range(2):
        along = np.zeros_like(w_p)
        along[..., a], along[..., 2] = 1.0, slide[..., a]
        J[..., a, :3], J[..., a, 3:] = np.cross(arm, along), along
    return J


def _seams(plan: MosaicPlan, exposure: Exposure) -> Float32:
    """The compared points' disagreement on the cells: each cell has that of the point nearest to it."""
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
