"""Rendering of a planned mosaic, tile by tile, in memory that does not grow with the number of pictures.

A tile depends on the plan alone. Each picture is reduced if the mosaic is coarser, and then warped to the
floor in one step that includes the lens distortion. Owners are refined from cells to pixels. Multi-band
blending covers a margin wide enough that the border of the tile is not visible.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.mosaic.blending import REACH_PX, MultiBand
from frontend.mosaic.canvas import CELL_PX, SOFT_CELLS, Tile
from frontend.mosaic.checkpoints import with_checkpoints
from frontend.mosaic.exposure import Exposure, Samples, estimate_exposure
from frontend.mosaic.pictures import BRIGHT, DARK, Pictures
from frontend.mosaic.plan import MosaicPlan
from frontend.mosaic.surface import ground_heights, ground_maps, ground_seen
from frontend.mosaic.view import Lattice
from frontend.mosaic.window import fingerprint, owners_around, window_of
from frontend.workers import Workers

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Image = NDArray[np.uint8]
Report = Callable[[str, int, int], None]
FindEarlierTile = Callable[[Tile, str], "Image | None"]
"""Returns the pixels of the tile with this fingerprint in an earlier mosaic, or None if there is none."""

MOST_TRIED = 8
"""Number of pictures in which hidden ground is looked for. Less vertical ones hide more."""


@dataclass(frozen=True)
class RenderedTile:
    """One rendered tile of the mosaic."""

    tile: Tile
    rgba: Image
    """(rows, cols, 4); alpha is 255 where a picture shows the floor and 0 elsewhere."""
    fingerprint: str
    """Digest of the tile's inputs: `frontend.mosaic.window`."""
    reused: bool = False
    """Whether the tile was taken from an earlier mosaic."""


@dataclass(frozen=True)
class _Exposed:
    """Inputs that the jobs of all pictures, or of all tiles, share."""

    plan: MosaicPlan
    pictures: Pictures
    exposure: Exposure | None = None


def measure_exposure(plan: MosaicPlan, pictures: Pictures, report: Report | None = None) -> Exposure:
    """Estimate gains and vignetting from all points that two or more of the plan's pictures see.

    Each picture is read once. Pictures that cannot be used are listed in ``pictures.unusable`` afterwards.
    """
    parts: list[tuple[Array, ...]] = []
    shared, count = _Exposed(plan, pictures), len(plan.views)
    if report:
        report("exposure", 0, count)
    checkpoints = pictures.checkpoints.stage("exposure", plan)
    for index, found in enumerate(with_checkpoints(checkpoints, _measured, shared, range(count))):
        if found is not None:
            digest, part = found
            pictures.seen(index, digest)
            parts.append(part)
        if report:
            report("exposure", index + 1, count)
    if not parts:
        return Exposure.neutral(len(plan.views))
    point, view, rho2, log_bgr = (np.concatenate(column) for column in zip(*parts, strict=True))
    samples = Samples(point.astype(np.int64), view.astype(np.int64), rho2, log_bgr)
    return estimate_exposure(samples, len(plan.views))


def _measured(shared: _Exposed, index: int) -> tuple[bytes, tuple[Array, ...]] | None:
    """Return digest and brightness of one picture; None if it is unusable."""
    picture = shared.pictures[index]
    return (
        None if picture is None else (shared.pictures.digest(index), _brightness(shared.plan, index, picture))
    )


def _brightness(plan: MosaicPlan, index: int, picture: Image) -> tuple[Array, ...]:
    """Return point, view, rho^2 and log brightness of one picture at the sampling points of the mosaic."""
    camera, view = plan.camera, plan.views[index]
    squares = plan.sampling
    (rows, cols), lattice = plan.squares_under(view, squares)
    u, v, seen = ground_seen(camera, view, lattice, plan.surface)
    sx, sy = picture.shape[1] / camera.size_px[0], picture.shape[0] / camera.size_px[1]
    side = int(np.clip(round(squares.pitch_px * plan.gsd_m / view.gsd_m * sx / 2), 3, 63)) | 1
    usable = cv2.inRange(picture, (DARK + 1,) * 3, (BRIGHT - 1,) * 3)
    mean = cv2.boxFilter(picture, cv2.CV_32F, (side, side))
    at = ((u + 0.5) * sx - 0.5, (v + 0.5) * sy - 0.5)
    bgr = cv2.remap(mean, *at, cv2.INTER_LINEAR)
    share = cv2.remap(cv2.boxFilter(usable, cv2.CV_32F, (side, side)), *at, cv2.INTER_LINEAR) / 255
    inside = np.minimum(
        np.minimum(at[0], picture.shape[1] - 1 - at[0]), np.minimum(at[1], picture.shape[0] - 1 - at[1])
    )
    good = seen & (inside >= side // 2) & (share > 0.9)
    r, c = np.nonzero(good)
    point = (r + rows.start) * squares.cols + c + cols.start
    log_bgr = np.log(np.maximum(bgr[good], 1.0).astype(float))
    return (
        point.astype(float),
        np.full(len(r), float(index)),
        _rho2(plan, u[good], v[good]).astype(float),
        log_bgr,
    )


def _rho2(plan: MosaicPlan, u: Float32, v: Float32) -> Float32:
    """Return the squared distance from the principal point; 1 at the farthest corner."""
    (cu, cv), corners = plan.camera.center_px, plan.camera.corners_px
    farthest = ((corners - (cu, cv)) ** 2).sum(axis=1).max()
    return np.asarray((((u - cu) ** 2 + (v - cv) ** 2) / farthest).astype(np.float32))


def render_tiles(
    plan: MosaicPlan,
    pictures: Pictures,
    exposure: Exposure,
    report: Report | None = None,
    earlier: FindEarlierTile | None = None,
    share: Workers | None = None,
) -> Iterator[RenderedTile]:
    """Yield all tiles of the plan, row by row. Tiles that ``earlier`` returns are not rendered again.

    ``share``: workers that render them, by default those of `frontend.workers`.
    """
    tiles, marks = list(plan.tiles), list[tuple[str, bool]]()

    def reused(tile: Tile) -> Image | None:
        mark = fingerprint(plan, tile, pictures.digest, exposure)
        old = earlier(tile, mark) if earlier else None
        marks.append((mark, old is not None))
        return old

    checkpoints = pictures.checkpoints.stage("tiles", plan, exposure)
    rendered = with_checkpoints(
        checkpoints, _rendered, _Exposed(plan, pictures, exposure), tiles, share, reused
    )
    if report:
        report("mosaic", 0, len(tiles))
    for done, (tile, rgba) in enumerate(zip(tiles, rendered, strict=True)):
        assert rgba is not None
        yield RenderedTile(tile, rgba, *marks[done])
        if report:
            report("mosaic", done + 1, len(tiles))


def _rendered(shared: _Exposed, tile: Tile) -> Image | None:
    """Return one tile; None if another process cannot read its pictures."""
    assert shared.exposure is not None
    rgba = render_tile(shared.plan, tile, shared.pictures, shared.exposure)
    return None if shared.pictures.lost else rgba


def render_tile(plan: MosaicPlan, tile: Tile, pictures: Pictures, exposure: Exposure) -> Image:
    """Return one tile (rows, cols, 4). Its pixels do not depend on which other tiles are rendered."""
    window = window_of(tile)
    owner = _pixel_owners(plan, window, pictures)
    inner = (slice(REACH_PX, REACH_PX + tile.rows), slice(REACH_PX, REACH_PX + tile.cols))
    rgba = np.zeros((tile.rows, tile.cols, 4), np.uint8)
    present = np.unique(owner[owner >= 0])
    if (owner[inner] >= 0).any():
        band = MultiBand(window.rows, window.cols)
        for index in present:
            mask = owner == index
            r0, r1, c0, c1 = _blending_bounds(mask)
            part = Tile(window.row + r0, window.col + c0, r1 - r0, c1 - c0)
            band.add(
                _warp(plan, int(index), part, pictures, exposure),
                mask[r0:r1, c0:c1].astype(np.float32),
                r0,
                c0,
            )
        bgr = cv2.convertScaleAbs(np.maximum(band.blend()[inner], 0.0))
        cv2.cvtColor(bgr, cv2.COLOR_BGR2RGBA, rgba)
        rgba[owner[inner] < 0] = 0
    return rgba


def _pixel_owners(plan: MosaicPlan, window: Tile, pictures: Pictures) -> NDArray[np.int32]:
    """Return (rows, cols) the index of the view that each pixel is taken from; -1 where none sees the floor.

    The cell owners are smoothed to soft memberships. The view with the largest membership wins among those
    that see the pixel.
    """
    cells = owners_around(plan, window)
    pad = SOFT_CELLS + 1
    owner = np.full((window.rows, window.cols), -1, np.int32)
    strongest = np.zeros(owner.shape, np.float32)
    side = 2 * SOFT_CELLS + 1
    for index in np.unique(cells[cells >= 0]):
        if pictures[index] is None:
            continue
        soft = cv2.GaussianBlur((cells == index).astype(np.float32), (side, side), 1.0)
        r, c = np.nonzero(soft)
        # One more cell on each side is needed for linear interpolation.
        r0, r1 = max(r.min() - 1, 0), min(r.max() + 2, soft.shape[0])
        c0, c1 = max(c.min() - 1, 0), min(c.max() + 2, soft.shape[1])
        size = ((c1 - c0) * CELL_PX, (r1 - r0) * CELL_PX)
        member = cv2.resize(soft[r0:r1, c0:c1], size, interpolation=cv2.INTER_LINEAR)
        top, left = (r0 - pad) * CELL_PX, (c0 - pad) * CELL_PX
        a, b = max(top, 0), min(top + size[1], window.rows)
        d, e = max(left, 0), min(left + size[0], window.cols)
        if a >= b or d >= e:
            continue
        member = member[a - top : b - top, d - left : e - left]
        lattice = plan.lattice(window.row + a, window.col + d, b - a, e - d)
        seen = plan.pixels(plan.views[index], lattice)[2]
        here = strongest[a:b, d:e]
        wins = seen & (member > here)
        here[wins] = member[wins]
        owner[a:b, d:e][wins] = index
    if plan.surface is not None:
        _own_the_rest(plan, window, cells, pictures, owner)
    return owner


def _own_the_rest(
    plan: MosaicPlan, window: Tile, cells: NDArray[np.int32], pictures: Pictures, owner: NDArray[np.int32]
) -> None:
    """Give pixels that are hidden from the owners of their cells to other pictures that see them, in place.

    Pictures from nearly above come first. What all of them see only hidden is taken from the first.
    """
    pad = SOFT_CELLS + 1
    inner = cells[pad:-pad, pad:-pad] >= 0
    shown = np.repeat(np.repeat(inner, CELL_PX, axis=0), CELL_PX, axis=1)
    for hidden_too in (False, True):
        r, c = np.nonzero((owner < 0) & shown)
        if len(r) == 0:
            return
        box = slice(r.min(), r.max() + 1), slice(c.min(), c.max() + 1)
        part = owner[box]
        lattice = plan.lattice(window.row + int(r.min()), window.col + int(c.min()), *part.shape)
        for index in _nearest_first(plan, lattice):
            missing = (part < 0) & shown[box]
            if not missing.any():
                break
            if pictures[index] is not None:
                part[missing & plan.pixels(plan.views[index], lattice, hidden_too)[2]] = index


def _nearest_first(plan: MosaicPlan, lattice: Lattice) -> list[int]:
    """Return the views whose bounds meet a lattice, from the most vertical view of its middle on."""
    far_m = lattice.step_m * np.array([lattice.cols, -lattice.rows])
    corner = np.array([lattice.x0_m, lattice.y0_m])
    off, over = [], []
    for index, view in enumerate(plan.views):
        west, south, east, north = view.bounds_m
        if (
            west < corner[0] + far_m[0]
            and east > corner[0]
            and south < corner[1]
            and north > corner[1] + far_m[1]
        ):
            over.append(index)
            off.append(float(np.linalg.norm(view.w_p_c_m[:2] - corner - far_m / 2)) / view.height_m)
    return [over[k] for k in np.argsort(off, kind="stable")[:MOST_TRIED]]


def _blending_bounds(mask: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Return first and last+1 row and column of the mask with its blending margin, in whole cells."""
    ends = []
    for axis in (1, 0):
        hit = np.flatnonzero(mask.any(axis=axis))
        first, last = hit[0] - REACH_PX, hit[-1] + 1 + REACH_PX
        size = mask.shape[1 - axis]
        ends += [max(first // CELL_PX * CELL_PX, 0), min(-(-last // CELL_PX) * CELL_PX, size)]
    return ends[0], ends[1], ends[2], ends[3]


def _warp(plan: MosaicPlan, index: int, part: Tile, pictures: Pictures, exposure: Exposure) -> Float32:
    """Return a picture (rows, cols, 3) BGR on the mosaic's pixels, exposure corrected, mirrored outside."""
    picture = pictures[index]
    assert picture is not None
    lattice = plan.lattice(part.row, part.col, part.rows, part.cols)
    u, v = ground_maps(plan.camera, plan.views[index], lattice, ground_heights(plan.surface, lattice))
    vignette = exposure.vignette.astype(np.float32)
    gain = exposure.gain[index].astype(np.float32)
    rho2 = _rho2(plan, u, v)
    sx, sy = picture.shape[1] / plan.camera.size_px[0], picture.shape[0] / plan.camera.size_px[1]
    at = (
        (u + np.float32(0.5)) * np.float32(sx) - np.float32(0.5),
        (v + np.float32(0.5)) * np.float32(sy) - np.float32(0.5),
    )
    warped = cv2.remap(picture, *at, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101).astype(np.float32)
    if vignette.any():
        inside = np.minimum(rho2, 1)[..., None]
        return np.asarray(warped * (gain * np.exp(inside * vignette[0] + inside**2 * vignette[1])))
    return np.asarray(warped * gain)
