"""Dense heights of one tile of ground: pairs of pictures, their heights, and the median of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.mosaic.view import Lattice, MosaicView
from frontend.robust import NORMAL, robust_std
from frontend.surface.stereo import GroundPoints, Placed, ground_points, rectified

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]
Look = Callable[[MosaicView], "Placed | None"]
Sees = Callable[[MosaicView, Lattice], Mask]
Layer = tuple[Float32, Mask, float]
"""Heights (rows, cols) of the cells by one pair, NaN where it does not match, for each cell
`GroundPoints.range_in_view`, and the height in metres of one pixel of disparity."""
Offer = tuple[float, Mask, tuple[MosaicView, MosaicView]]
"""Value of a pair by its base, the nodes that both pictures see, and the pictures."""


@dataclass(frozen=True)
class Search:
    """Pairs of pictures to match, by their level base over the height: a climb shows hardly any height."""

    least: float
    best: float
    """Up to the best, precision grows with the base."""
    largest: float
    scales: tuple[int, ...]
    """Reductions of the pictures. What one does not match is left to the next."""


FIRST = Search(0.08, 0.3, 0.6, (1,))
"""Below the least base, `DISPARITY_STD_PX` is four pixels of height; above the largest, pictures of houses
differ too much to be matched."""
IN_HOLES = Search(FIRST.least / 2, FIRST.least, 2 * FIRST.least, (1, 2, 4))
"""Crowns of trees look alike from directions within an octave of the least base alone, and without details.
Their heights are less precise, so they are used where the first search found none."""
COARSEST = max(IN_HOLES.scales) / IN_HOLES.best
"""Largest difference of heights that agree, in pixels of the matched pictures."""
HOLE_CELLS = 16
"""Side of the smallest hole that is searched. Narrower ones are mostly ground hidden beside what is high."""
WANTED = 5
"""Number of pairs for each piece of ground: the median then resists two that are wrong."""
AGREEING = 2
"""Number of pairs that must agree on a height."""
COARSE = 4
"""Reduction of the pictures by which the range of heights is found first."""
DISPARITY_STD_PX = 1 / 3
"""Standard deviation of a disparity where no two pairs overlap, whose differences would tell it."""
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
    """(rows, cols) standard deviation, from the spread of the pairs and that of their disparities; NaN where
    the height is."""


def dense_heights(
    views: Sequence[MosaicView], sees: Sees, look: Look, lattice: Lattice, gsd_m: float
) -> DenseHeights:
    """Match the pairs of pictures that see a lattice of cells best, and return the median of their heights.

    Heights agree if they differ by less than a pixel ``gsd_m`` of the parallax over the best base.
    """
    unknown = np.full((lattice.rows, lattice.cols), np.nan, np.float32)
    dense = _searched(FIRST, views, sees, look, lattice, gsd_m, DenseHeights(unknown, unknown))
    hole = (~np.isfinite(dense.height_m)).astype(np.uint8)
    r, c = np.nonzero(cv2.morphologyEx(hole, cv2.MORPH_OPEN, np.ones((HOLE_CELLS, HOLE_CELLS), np.uint8)))
    if len(r) == 0:
        return dense
    # One rectangle around all holes: the pairs of a tile are mostly the same in all of them.
    box = _slice_around(r, lattice.rows), _slice_around(c, lattice.cols)
    x0_m, y0_m = lattice.x0_m + box[1].start * lattice.step_m, lattice.y0_m - box[0].start * lattice.step_m
    before = DenseHeights(dense.height_m[box], dense.std_m[box])
    around = Lattice(x0_m, y0_m, lattice.step_m, *before.height_m.shape)
    found = _searched(IN_HOLES, views, sees, look, around, gsd_m, before)
    height, std = dense.height_m.copy(), dense.std_m.copy()
    height[box], std[box] = found.height_m, found.std_m
    return DenseHeights(height, std)


def _slice_around(cells: NDArray[np.int64], of: int) -> slice:
    """Return the rows or columns of holes, with one on each side: its heights are those to continue."""
    return slice(max(int(cells.min()) - 1, 0), min(int(cells.max()) + 2, of))


def _searched(
    search: Search,
    views: Sequence[MosaicView],
    sees: Sees,
    look: Look,
    lattice: Lattice,
    gsd_m: float,
    before: DenseHeights,
) -> DenseHeights:
    """Return the heights of before, and by the pairs of one search where they are unknown.

    A coarser scale fills what finer ones do not know.
    """
    pairs, offered = _pairs(search, views, sees, lattice)
    layers: list[list[Layer]] = []
    for a, b in pairs:
        first, second = look(a), look(b)
        if first is not None and second is not None:
            layers.append(_pair_layers(first, second, lattice, gsd_m, search.scales))
    if not layers:
        return before
    height, std = before.height_m.copy(), before.std_m.copy()
    nodes = [np.arange(n) * NODES // max(lattice.rows, lattice.cols) for n in (lattice.rows, lattice.cols)]
    needed = np.clip(offered, 1, AGREEING)[np.ix_(*nodes)]
    for scale, of_scale in zip(search.scales, zip(*layers, strict=True), strict=True):
        heights, in_view, unit_m = (np.stack(part) for part in zip(*of_scale, strict=True))
        found = _agreed(heights, in_view, unit_m, scale * gsd_m / search.best, needed, before.height_m)
        unknown = ~np.isfinite(height)
        height[unknown], std[unknown] = found.height_m[unknown], found.std_m[unknown]
    return DenseHeights(height, std)


def _pairs(
    search: Search, views: Sequence[MosaicView], sees: Sees, lattice: Lattice
) -> tuple[list[tuple[MosaicView, MosaicView]], NDArray[np.int64]]:
    """Choose pairs greedily until each node of the tile has ``WANTED``, best base first.

    Return them, and how many of them see each node.
    """
    step = lattice.step_m * max(lattice.rows, lattice.cols) / NODES
    nodes = Lattice(lattice.x0_m + step / 2, lattice.y0_m - step / 2, step, NODES, NODES)
    over = _apart([(view, mask) for view in views if (mask := sees(view, nodes)).any()], search.least)
    offered: list[Offer] = []
    for i, (a, seen_a) in enumerate(over):
        for b, seen_b in over[i + 1 :]:
            height = min(a.height_m, b.height_m)
            ratio = float(np.linalg.norm((a.w_p_c_m - b.w_p_c_m)[:2])) / height
            both = seen_a & seen_b
            if search.least <= ratio <= search.largest and both.any():
                offered.append((min(ratio, search.best) / max(ratio, search.best), both, (a, b)))
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


def _apart(over: list[tuple[MosaicView, Mask]], least_base: float) -> list[tuple[MosaicView, Mask]]:
    """Return the views that see most, without those nearer to one of them than the least base.

    The number of views then depends on the area, not on how often it was flown over.
    """
    kept: list[tuple[MosaicView, Mask]] = []
    for view, mask in sorted(over, key=lambda seen: -int(np.count_nonzero(seen[1]))):
        at, least_m = view.w_p_c_m, least_base * view.height_m
        if all(np.linalg.norm(other.w_p_c_m - at) >= least_m for other, _ in kept):
            kept.append((view, mask))
    return kept


def _pair_layers(
    a: Placed, b: Placed, lattice: Lattice, gsd_m: float, scales: tuple[int, ...]
) -> list[Layer]:
    """Return the heights of the cells by one pair at each scale."""
    height = min(a.view.height_m, b.view.height_m)
    # The height of one disparity at a pixel of the ground.
    unit_m = gsd_m * height / float(np.linalg.norm(a.w_p_c_m - b.w_p_c_m))
    over = rectified(a, b, lattice, (LOW * height, HIGH * height), COARSE * gsd_m)
    coarse = np.zeros(0) if over is None else ground_points(a, b, over).w_p_m[:, 2]
    if len(coarse) == 0:
        unknown = np.full((lattice.rows, lattice.cols), np.nan, np.float32)
        return [(unknown, np.isfinite(unknown), scale * unit_m) for scale in scales]
    low, high = np.percentile(coarse, [TAIL_PERCENT, 100 - TAIL_PERCENT])
    margin = COARSE * unit_m
    layers = []
    for scale in scales:
        fine = rectified(a, b, lattice, (float(low - margin), float(high + margin)), scale * gsd_m)
        no_points = GroundPoints(np.zeros((0, 3)), np.zeros(0, bool))
        points = no_points if fine is None else ground_points(a, b, fine)
        layers.append((*_on_cells(points, lattice, scale), scale * unit_m))
    return layers


def _on_cells(points: GroundPoints, lattice: Lattice, scale: int) -> tuple[Float32, Mask]:
    """Return the height of the upper surface in each cell: the mean of the points near the highest.

    The second result is `GroundPoints.range_in_view` of the cells.

    Points of reduced pictures are farther apart: ``scale`` x ``scale`` cells have one height.
    """
    rows, cols, step = -(-lattice.rows // scale), -(-lattice.cols // scale), scale * lattice.step_m
    c = np.floor((points.w_p_m[:, 0] - lattice.x0_m + lattice.step_m / 2) / step)
    r = np.floor((lattice.y0_m + lattice.step_m / 2 - points.w_p_m[:, 1]) / step)
    inside = (r >= 0) & (r < rows) & (c >= 0) & (c < cols)
    cell = (r[inside] * cols + c[inside]).astype(np.int64)
    height = points.w_p_m[inside, 2]
    top = np.full(rows * cols, -np.inf)
    np.maximum.at(top, cell, height)
    near = height > top[cell] - step
    count = np.bincount(cell[near], minlength=len(top))
    total = np.bincount(cell[near], height[near], minlength=len(top))
    beside = np.bincount(cell[near], ~points.range_in_view[inside][near], minlength=len(top))
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)
    known, in_view = (
        np.repeat(np.repeat(part.reshape(rows, cols), scale, axis=0), scale, axis=1)
        for part in (mean, (count > 0) & (beside == 0))
    )
    return known[: lattice.rows, : lattice.cols], in_view[: lattice.rows, : lattice.cols]


def _agreed(
    layers: Float32,
    range_in_view: Mask,
    unit_m: Array,
    agree_m: float,
    needed: NDArray[np.int64],
    before_m: Float32,
) -> DenseHeights:
    """Return the median of the layers (p, rows, cols) and its standard deviation.

    ``unit_m`` (p,) is the height of one disparity of each.

    Of two middle values the one is taken with which more pairs agree: the mean of a roof and the ground would
    be neither. Where fewer than ``needed`` (rows, cols) pairs agree, the height is unknown.

    A height by one pair alone must continue those around it, as nothing else checks it: the heights
    ``before_m`` (rows, cols), NaN where unknown, and those that two pairs check. Where neither is known, a
    pair with its range of heights in view counts alone. A height by pairs none of which has its range in view
    must agree with the nearest one itself: all of them may be wrong in the same way.
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
    agrees = np.abs(layers - height) <= agree_m
    known, in_view = np.isfinite(height), (agrees & range_in_view).any(axis=0)
    checked = known & in_view & (support >= AGREEING)
    alone = known & in_view & ~checked
    # Pairs share pictures and the pattern of the ground, so their errors do not average out.
    pixel_m = np.sqrt(np.tensordot(unit_m**2, agrees, axes=1) / np.maximum(support, 1))
    within_m = agree_m + np.maximum(pixel_m, agree_m)
    counts = checked if checked.any() or np.isfinite(before_m).any() else in_view
    sure = np.where(np.isfinite(before_m), before_m, np.where(counts, height, np.nan))
    while (joins := alone & ~np.isfinite(sure) & _agree_with_nearest(height, sure, within_m)).any():
        sure[joins] = height[joins]
    beside = known & ~in_view & _agree_with_nearest(height, sure, within_m)
    height[~beside & ~(in_view & np.isfinite(sure))] = np.nan
    off = np.sort(np.abs(layers - height), axis=0)
    middle = np.maximum((count - 1) // 2, 0)
    spread = NORMAL * np.take_along_axis(off, middle[None], axis=0)[0]
    std = np.maximum(spread, _disparity_std_px(layers, unit_m) * pixel_m)
    return DenseHeights(height, np.where(np.isfinite(height), std, np.nan).astype(np.float32))


def _disparity_std_px(layers: Float32, unit_m: Array) -> float:
    """Return the standard deviation of a disparity, from the differences of layers (p, rows, cols)."""
    off_m = np.diff(layers, axis=0)
    off_px = off_m / np.hypot(unit_m[1:], unit_m[:-1])[:, None, None]
    known = np.isfinite(off_px)
    return robust_std(off_px[known]) if known.any() else DISPARITY_STD_PX


def _agree_with_nearest(height: Float32, sure: Float32, within_m: Array) -> Mask:
    """Return (rows, cols) whether a height agrees with the nearest one that is ``sure``, NaN where none is.

    ``within_m`` (rows, cols) is what both may be off by together.
    """
    known = np.isfinite(sure)
    if not known.any():
        return known
    _, label = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros(int(label.max()) + 1, np.float32)
    of_label[label[known]] = sure[known]
    return np.asarray(np.abs(height - of_label[label]) <= within_m)
