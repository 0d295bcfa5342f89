"""Dense heights of one tile of ground: pairs of pictures, their heights, and the median of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frontend.mosaic.view import Lattice, MosaicView
from frontend.surface.stereo import Placed, ground_points, rectified

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]
Look = Callable[[MosaicView], "Placed | None"]
Offer = tuple[float, Mask, tuple[MosaicView, MosaicView]]
"""Value of a pair by its base, the nodes that both pictures see, and the pictures."""

LEAST_BASE, BEST_BASE, LARGEST_BASE = 0.08, 0.3, 0.6
"""Level base over height: a climb shows hardly any height. Below the least, an error of a third of a pixel is
four pixels of height; above the largest, pictures of houses differ too much to be matched. Up to the best,
precision grows with it."""
WANTED = 5
"""Number of pairs for each piece of ground: the median then resists two that are wrong."""
AGREEING = 2
"""Number of pairs that must agree on a height."""
COARSE = 4
"""Reduction of the pictures by which the range of heights is found first."""
LOW, HIGH = -0.2, 0.5
"""Range of heights that is searched first, as shares of the camera's height."""
TAIL_PERCENT = 0.5
"""Share of the coarse heights at either end that may be wrong."""
NODES = 16
"""Nodes along the side of a tile, on which the overlap of pictures is counted."""


@dataclass(frozen=True)
class DenseHeights:
    """Heights of the cells of a tile."""

    height_m: Float32
    """(rows, cols) median over the pairs; NaN where none matched."""
    std_m: Float32
    """(rows, cols) standard deviation, from the spread of the pairs; NaN where no two agree."""


def dense_heights(
    views: Sequence[MosaicView], camera_sees: Callable[[MosaicView, Lattice], Mask], look: Look,
    lattice: Lattice, gsd_m: float,
) -> DenseHeights:  # fmt: skip
    """Match the pairs of pictures that see a lattice of cells best, and return the median of their heights.

    Heights agree if they differ by less than a pixel ``gsd_m`` of the parallax over the best base.
    """
    layers = []
    pairs, offered = _pairs(views, camera_sees, lattice)
    for a, b in pairs:
        first, second = look(a), look(b)
        if first is not None and second is not None:
            layers.append(_pair_heights(first, second, lattice, gsd_m))
    if not layers:
        unknown = np.full((lattice.rows, lattice.cols), np.nan, np.float32)
        return DenseHeights(unknown, unknown)
    nodes = [np.arange(n) * NODES // max(lattice.rows, lattice.cols) for n in (lattice.rows, lattice.cols)]
    needed = np.clip(offered, 1, AGREEING)[np.ix_(*nodes)]
    return _agreed(np.stack(layers), gsd_m / BEST_BASE, needed)


def _pairs(
    views: Sequence[MosaicView], sees: Callable[[MosaicView, Lattice], Mask], lattice: Lattice
) -> tuple[list[tuple[MosaicView, MosaicView]], NDArray[np.int64]]:
    """Choose pairs greedily until each node of the tile has ``WANTED``, best base first.

    Return them, and how many of them see each node.
    """
    step = lattice.step_m * max(lattice.rows, lattice.cols) / NODES
    nodes = Lattice(lattice.x0_m + step / 2, lattice.y0_m - step / 2, step, NODES, NODES)
    over = _apart([(view, mask) for view in views if (mask := sees(view, nodes)).any()])
    offered: list[Offer] = []
    for i, (a, seen_a) in enumerate(over):
        for b, seen_b in over[i + 1 :]:
            height = min(a.height_m, b.height_m)
            ratio = float(np.linalg.norm((a.w_p_c_m - b.w_p_c_m)[:2])) / height
            both = seen_a & seen_b
            if LEAST_BASE <= ratio <= LARGEST_BASE and both.any():
                offered.append((min(ratio, BEST_BASE) / max(ratio, BEST_BASE), both, (a, b)))
    chosen, count = [], np.zeros((NODES, NODES), np.int64)
    while offered:
        best, gain = _best(offered, count < WANTED)
        if gain < NODES:  # less than a row of nodes: only ground that could not be known without it counts
            best, gain = _best(offered, count < AGREEING)
        if gain == 0:
            break
        _, both, pair = offered.pop(best)
        count += both
        chosen.append(pair)
    return chosen, count


def _best(offered: list[Offer], wanting: Mask) -> tuple[int, float]:
    """Return the number of the pair that covers most of the wanting nodes, and its gain."""
    gain = [value * np.count_nonzero(both & wanting) for value, both, _ in offered]
    best = int(np.argmax(gain))
    return best, float(gain[best])


def _apart(over: list[tuple[MosaicView, Mask]]) -> list[tuple[MosaicView, Mask]]:
    """Return the views that see most, without those nearer to one of them than the least base.

    The number of views then depends on the area, not on how often it was flown over.
    """
    kept: list[tuple[MosaicView, Mask]] = []
    for view, mask in sorted(over, key=lambda seen: -int(np.count_nonzero(seen[1]))):
        at, least_m = view.w_p_c_m, LEAST_BASE * view.height_m
        if all(np.linalg.norm(other.w_p_c_m - at) >= least_m for other, _ in kept):
            kept.append((view, mask))
    return kept


def _pair_heights(a: Placed, b: Placed, lattice: Lattice, gsd_m: float) -> Float32:
    """Return the heights (rows, cols) of the cells by one pair; NaN where it does not match."""
    height = min(a.view.height_m, b.view.height_m)
    unknown = np.full((lattice.rows, lattice.cols), np.nan, np.float32)
    over = rectified(a, b, lattice, (LOW * height, HIGH * height), COARSE * gsd_m)
    coarse = np.zeros((0, 3)) if over is None else ground_points(a, b, over)
    if len(coarse) == 0:
        return unknown
    low, high = np.percentile(coarse[:, 2], [TAIL_PERCENT, 100 - TAIL_PERCENT])
    # The height of one disparity of the coarse pictures.
    margin = COARSE * gsd_m * height / float(np.linalg.norm(a.w_p_c_m - b.w_p_c_m))
    fine = rectified(a, b, lattice, (float(low - margin), float(high + margin)), gsd_m)
    return unknown if fine is None else _on_cells(ground_points(a, b, fine), lattice)


def _on_cells(points: Array, lattice: Lattice) -> Float32:
    """Return the height of the upper surface in each cell: the mean of the points near the highest."""
    c = np.floor((points[:, 0] - lattice.x0_m) / lattice.step_m + 0.5)
    r = np.floor((lattice.y0_m - points[:, 1]) / lattice.step_m + 0.5)
    inside = (r >= 0) & (r < lattice.rows) & (c >= 0) & (c < lattice.cols)
    cell = (r[inside] * lattice.cols + c[inside]).astype(np.int64)
    height = points[inside, 2]
    top = np.full(lattice.rows * lattice.cols, -np.inf)
    np.maximum.at(top, cell, height)
    near = height > top[cell] - lattice.step_m
    count = np.bincount(cell[near], minlength=len(top))
    total = np.bincount(cell[near], height[near], minlength=len(top))
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return mean.reshape(lattice.rows, lattice.cols).astype(np.float32)


def _agreed(layers: Float32, agree_m: float, needed: NDArray[np.int64]) -> DenseHeights:
    """Return the median of layers (k, rows, cols) and the standard deviation of one of them.

    Of two middle values the one is taken with which more pairs agree: the mean of a roof and the ground would
    be neither. Where fewer than ``needed`` (rows, cols) pairs agree, the height is
    unknown.
    """
    ordered = np.sort(layers, axis=0)  # NaN last
    count = np.isfinite(layers).sum(axis=0)
    height, support = np.full(count.shape, np.nan, np.float32), np.zeros(count.shape, int)
    for middle in (np.maximum((count - 1) // 2, 0), np.minimum(count // 2, len(layers) - 1)):
        value = np.take_along_axis(ordered, middle[None], axis=0)[0]
        agreeing = (np.abs(layers - value) <= agree_m).sum(axis=0)
        better = agreeing > support
        height[better], support[better] = value[better], agreeing[better]
    height[support < needed] = np.nan
    off = np.sort(np.abs(layers - height), axis=0)
    middle = np.maximum((count - 1) // 2, 0)
    # Pairs share pictures and the pattern of the ground, so their errors do not average out.
    spread = 1.4826 * np.take_along_axis(off, middle[None], axis=0)[0]
    return DenseHeights(height, np.where(support > 1, spread, np.nan).astype(np.float32))
