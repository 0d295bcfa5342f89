"""Misregistration of a map: displacement between two pictures of one piece of ground, laid over the map.

Each square of the mosaic is taken from the two pictures that see it best, over the map's surface. Phase
correlation gives the displacement of one against the other (Kuglin and Hines 1975, The phase correlation
image alignment method). A part of the displacement points along the *parallax*, the direction in which the
ground would move between the two pictures if it were higher. Only errors of the pictures' poses act across
it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.mosaic.canvas import SquareGrid
from frontend.mosaic.checkpoints import with_checkpoints
from frontend.mosaic.pictures import Pictures
from frontend.mosaic.plan import MosaicPlan
from frontend.mosaic.surface import ground_heights, ground_maps
from frontend.mosaic.view import Lattice, MosaicView, visible

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Report = Callable[[str, int, int], None]

SQUARE_PX = 64
"""Side of a square in pixels of the mosaic."""
SETTLED_PX = 0.5
"""A displacement is found if less than half a pixel is left after shifting the square by it."""


@dataclass(frozen=True)
class Misregistration:
    """Displacements of the second best picture against the best one, one row per square that two see."""

    shape: tuple[int, int]
    """Numbers of rows and columns of squares."""
    square: NDArray[np.int64]
    """(n, 2) row and column of each square that two pictures see whole."""
    shift_px: Array
    """(n, 2) displacement to the right and down, in pixels of the mosaic; NaN where none was found."""
    parallax_px_m: Array
    """(n, 2) displacement for a metre of height."""

    @property
    def found(self) -> NDArray[np.bool_]:
        """(n,) whether a displacement was found."""
        return np.asarray(np.isfinite(self.shift_px).all(axis=1))

    @property
    def compared(self) -> NDArray[np.bool_]:
        """(rows, columns) whether two pictures were compared in a square."""
        found = np.zeros(self.shape, bool)
        found[tuple(self.square.T)] = True
        return found

    @property
    def along_px(self) -> Array:
        """(n,) displacement along the parallax."""
        return np.asarray((self.shift_px * self._direction).sum(axis=1))

    @property
    def across_px(self) -> Array:
        """(n,) displacement across the parallax."""
        return np.asarray((self.shift_px[:, ::-1] * self._direction * (-1, 1)).sum(axis=1))

    def percentile_px(self, percent: float) -> float:
        """Return a percentile of the displacement's length over the squares where it was found."""
        length = np.linalg.norm(self.shift_px[self.found], axis=1)
        return float(np.percentile(length, percent)) if len(length) else float("nan")

    @property
    def _direction(self) -> Array:
        size = np.linalg.norm(self.parallax_px_m, axis=1, keepdims=True)
        return np.asarray(self.parallax_px_m / np.maximum(size, 1e-12))


@dataclass(frozen=True)
class _Compared:
    """Inputs that the jobs of all squares share."""

    plan: MosaicPlan
    pictures: Pictures


def measure_misregistration(
    plan: MosaicPlan, pictures: Pictures, report: Report | None = None
) -> Misregistration:
    """Measure the displacement in every square that two of the plan's pictures see whole."""
    squares = _squares(plan)
    best = _two_best(plan, squares)
    r, c = np.nonzero(best[1] >= 0)
    pair = best[:, r, c]
    # Squares of one pair follow one another, and a job has one best picture, so that few pictures are held
    # at a time.
    order = np.lexsort((pair[1], pair[0]))
    shift, parallax = np.full((len(r), 2), np.nan), np.empty((len(r), 2))
    rows = np.column_stack([pair.T, r, c])
    runs = np.split(order, np.flatnonzero(np.diff(pair[0, order])) + 1) if len(order) else []
    checkpoints = pictures.checkpoints.stage("misregistration", plan)
    measured = with_checkpoints(
        checkpoints, _measured, _Compared(plan, pictures), [rows[run] for run in runs]
    )
    done = 0
    for run, found in zip(runs, measured, strict=True):
        assert found is not None
        shift[run], parallax[run] = found[:, :2], found[:, 2:]
        done += len(run)
        if report:
            report("misregistration", done, len(order))
    return Misregistration((squares.rows, squares.cols), np.column_stack([r, c]), shift, parallax)


def _measured(shared: _Compared, squares: NDArray[np.int64]) -> Array | None:
    """Return (n, 4) displacement and parallax of squares (n, 4), each two views, row and column; None if
    another process cannot read their pictures."""
    plan, window = shared.plan, cv2.createHanningWindow((SQUARE_PX, SQUARE_PX), cv2.CV_32F)
    found = np.empty((len(squares), 4))
    for k, (a, b, row, col) in enumerate(squares.tolist()):
        lattice = plan.lattice(row * SQUARE_PX, col * SQUARE_PX, SQUARE_PX, SQUARE_PX)
        found[k, :2] = _displacement(plan, shared.pictures, a, b, lattice, window)
        found[k, 2:] = _parallax(plan, plan.views[a], plan.views[b], lattice)
    return None if shared.pictures.lost else found


def seen_by_two(plan: MosaicPlan) -> NDArray[np.bool_]:
    """Return (rows, columns) whether two of the plan's pictures see a square whole."""
    return np.asarray(_two_best(plan, _squares(plan))[1] >= 0)


def _squares(plan: MosaicPlan) -> SquareGrid:
    return SquareGrid(SQUARE_PX, 0, 0, plan.height // SQUARE_PX, plan.width // SQUARE_PX)


def _two_best(plan: MosaicPlan, squares: SquareGrid) -> NDArray[np.int32]:
    """Return (2, rows, cols) the views that see each square best, -1 where there are fewer.

    The best is that whose border is farthest from the square.
    """
    shape = (squares.rows, squares.cols)
    weight, best = np.zeros((2, *shape), np.float32), np.full((2, *shape), -1, np.int32)
    for index, view in enumerate(plan.views):
        where, lattice = plan.squares_under(view, squares)
        if 0 in (lattice.rows, lattice.cols):
            continue
        u, v, sees = plan.pixels(view, lattice)
        _, _, resolution = visible(view, lattice)
        w, h = plan.camera.size_px
        border = np.minimum(np.minimum(u, w - 1 - u), np.minimum(v, h - 1 - v))
        # Half a diagonal of the square in the picture, so that its corners are inside.
        whole = border > 0.75 * lattice.step_m * resolution
        now = np.where(sees & whole, border, 0).astype(np.float32)
        candidate = np.full(now.shape, index, np.int32)
        for rank in (0, 1):  # what is displaced from the first rank is offered to the second
            before, owner = weight[rank][where], best[rank][where]
            better = now > before
            now, before[better] = np.where(better, before, now), now[better]
            candidate, owner[better] = np.where(better, owner, candidate), candidate[better]
    return best


def _parallax(plan: MosaicPlan, a: MosaicView, b: MosaicView, lattice: Lattice) -> Array:
    """Return the displacement in pixels (right, down) of b against a for a metre of height."""
    middle = np.array([lattice.x0_m, lattice.y0_m]) + lattice.step_m * (lattice.rows - 1) / 2 * np.array(
        [1, -1]
    )
    slide = [(middle - view.w_p_c_m[:2]) / view.height_m for view in (a, b)]
    return np.asarray((slide[1] - slide[0]) * (1, -1) / plan.gsd_m)


def _displacement(
    plan: MosaicPlan, pictures: Pictures, a: int, b: int, lattice: Lattice, window: Float32
) -> Array:
    """Return the displacement of b against a in a square; NaN where it does not settle."""
    first = _patch(plan, pictures, a, lattice)
    total = np.zeros(2)
    for _ in range(3):
        x0_m, y0_m = lattice.x0_m + total[0] * lattice.step_m, lattice.y0_m - total[1] * lattice.step_m
        second = _patch(plan, pictures, b, Lattice(x0_m, y0_m, lattice.step_m, lattice.rows, lattice.cols))
        if first is None or second is None:
            break
        step = np.array(cv2.phaseCorrelate(first, second, window)[0])
        total = total + step
        if np.hypot(*step) < SETTLED_PX and not np.array_equal(step, total):
            return np.asarray(total)
    return np.full(2, np.nan)


def _patch(plan: MosaicPlan, pictures: Pictures, index: int, lattice: Lattice) -> Float32 | None:
    """Return the grey levels of a square in one picture; None where it is unusable or without contrast."""
    picture = pictures[index]
    if picture is None:
        return None
    u, v = ground_maps(plan.camera, plan.views[index], lattice, ground_heights(plan.surface, lattice))
    bgr = cv2.remap(picture, *scaled(plan, picture, u, v), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
    grey = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY).astype(np.float32)
    return grey if grey.min() < grey.max() else None


def scaled(plan: MosaicPlan, picture: NDArray[np.uint8], u: Float32, v: Float32) -> tuple[Float32, Float32]:
    """Return pixels of the camera as pixels of a reduced picture."""
    sx, sy = picture.shape[1] / plan.camera.size_px[0], picture.shape[0] / plan.camera.size_px[1]
    half = np.float32(0.5)
    return (u + half) * np.float32(sx) - half, (v + half) * np.float32(sy) - half
