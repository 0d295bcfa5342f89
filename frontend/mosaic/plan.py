"""Where a mosaic lies on the floor, which pictures it needs, and which of them owns which piece of ground.

The owner of a piece of ground is the picture that sees it best: far from the picture's border, from
above, at the resolution of the mosaic. Owners are found once for the whole mosaic on a coarse lattice of
cells, so that a tile can be rendered alone and still equals the same tile of the whole. Of many pictures
of one spot (a hovering drone) only those are kept that see some ground clearly better than the ones kept
before (greedy cover), so that the work grows with the ground and not with the flight.

Pixel (r, c) of the mosaic has its centre at x = west_m + (c + 1/2) gsd_m, y = north_m - (r + 1/2) gsd_m.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.mosaic.view import Lattice, View, pixel_maps, view_of, visible

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]

CELL_PX = 16
"""Side of the cells in which owners are found; a power of two, as the blending pyramid wants it."""
TILE_PX = 1024
POINTS_A_SIDE = 20
"""Exposure is sampled on about this many points along the side of a picture."""
GOOD_ENOUGH = 0.6
"""A picture need not be kept for ground that a kept one sees at least this well, as a share of the best."""
WORTH_KEEPING = 0.02
"""Share of its own ground for which a picture must be needed to be kept."""
CANVAS_RATIO = 4.0
"""Pictures apart from the rest are left out where the canvas would grow beyond this many times its parts."""


class MosaicError(ValueError):
    """No mosaic can be made of this: one line that says why."""


@dataclass(frozen=True)
class Tile:
    """A rectangle of mosaic pixels."""

    row: int
    col: int
    """First pixel."""
    rows: int
    cols: int


@dataclass(frozen=True)
class MosaicPlan:
    """The mosaic before a single picture is read."""

    camera: Camera
    gsd_m: float
    west_m: float
    north_m: float
    """Outer corner of the first pixel."""
    width: int
    height: int
    """Pixels."""
    views: tuple[View, ...]
    """The pictures that are needed."""
    owner: NDArray[np.int32]
    """(rows, cols) of cells: which of ``views`` owns each; -1 where none sees the ground."""
    redundant: int = 0
    """Pictures that could be used and show nothing that the kept ones don't show as well."""
    left_out: dict[int, str] = field(default_factory=dict)
    """Pose number -> why its picture cannot be used."""
    note: str = ""
    """What was decided for the user, in one sentence; empty where nothing was."""
    tile_px: int = TILE_PX

    @property
    def tiles(self) -> Iterator[Tile]:
        """All tiles, row by row."""
        for row in range(0, self.height, self.tile_px):
            for col in range(0, self.width, self.tile_px):
                rows, cols = min(self.tile_px, self.height - row), min(self.tile_px, self.width - col)
                yield Tile(row, col, rows, cols)

    @property
    def sampling_px(self) -> int:
        """Pitch of the points at which pictures are compared for their exposure."""
        sides = [np.sqrt(np.prod(v.bounds_m[2:] - v.bounds_m[:2])) for v in self.views]
        return max(CELL_PX, round(float(np.median(sides)) / self.gsd_m / POINTS_A_SIDE))

    def cells_under(self, view: View) -> tuple[tuple[slice, slice], Lattice]:
        """The cells under a picture, and their middles."""
        return _cells_under(view, self.owner.shape, self.west_m, self.north_m, CELL_PX * self.gsd_m)

    def lattice(self, row: int, col: int, rows: int, cols: int) -> Lattice:
        """The pixel centres of a rectangle, which may reach beyond the mosaic."""
        x, y = self.west_m + (col + 0.5) * self.gsd_m, self.north_m - (row + 0.5) * self.gsd_m
        return Lattice(x, y, self.gsd_m, rows, cols)


def plan_mosaic(
    camera: Camera,
    w_T_b: Array,
    floor_z_m: float = 0.0,
    gsd_m: float | None = None,
    max_pixels: int = 60_000_000,
    leave_out: Mapping[int, str] | None = None,
) -> MosaicPlan:
    """Canvas, pictures and owners for poses (n, 4, 4) over the floor z = floor_z_m.

    ``gsd_m`` is the ground resolution in m/pixel; where none is given it is the median of what the pictures
    have, made coarser until the mosaic has at most ``max_pixels``. ``leave_out`` names pictures not to use,
    with reasons.

    Raises ``MosaicError`` where no picture sees the floor or a given ``gsd_m`` asks for over 4e9 pixels.
    """
    left_out = dict(leave_out or {})
    views: list[View] = []
    for k, pose in enumerate(np.asarray(w_T_b, dtype=float)):
        if k in left_out:
            continue
        view = view_of(camera, k, pose, floor_z_m)
        if isinstance(view, str):
            left_out[k] = view
        else:
            views.append(view)
    views, apart = _without_strays(views)
    left_out |= apart
    if not views:
        reasons = ", ".join(sorted(set(left_out.values()))) or "there are none"
        raise MosaicError(f"no picture can be put into a mosaic: {reasons}")
    gsd_m, west_m, north_m, width, height, note = _canvas(views, gsd_m, max_pixels)
    kept, owner = _owners(camera, views, gsd_m, west_m, north_m, width, height)
    return MosaicPlan(
        camera, gsd_m, west_m, north_m, width, height, kept, owner, len(views) - len(kept), left_out, note
    )


def _weights(camera: Camera, view: View, lattice: Lattice, gsd_m: float) -> Float32:
    """How well a picture sees each cell, 0 not at all.

    A dome over the picture (1 in the middle, 0 at the border), times the cosine off nadir, times the
    resolution as a share of the mosaic's, at most 1.
    """
    seen, nadir, resolution = visible(view, lattice)
    u, v = pixel_maps(camera, view, lattice)
    w, h = camera.size_px
    border = np.minimum(np.minimum(u, w - 1 - u), np.minimum(v, h - 1 - v))
    # A cell whose middle lies just outside may still have pixels inside.
    touches = seen & (border > -0.75 * lattice.step_m * resolution)
    dome = (4 / w * u * (1 - u / (w - 1))) * (4 / h * v * (1 - v / (h - 1)))
    inside = np.where(border > 1, dome, 1e-6 * np.exp(np.minimum(border - 1, 0)))
    return np.where(touches, inside * nadir * np.minimum(1, gsd_m * resolution), 0).astype(np.float32)


def _owners(
    camera: Camera, views: list[View], gsd_m: float, west_m: float, north_m: float, width: int, height: int
) -> tuple[tuple[View, ...], NDArray[np.int32]]:
    """The pictures to keep, and for each cell which of them owns it.

    A greedy cover: pictures are tried in the order of the ground that they see best.
    """
    step = CELL_PX * gsd_m
    shape = (-(-height // CELL_PX), -(-width // CELL_PX))

    def look(view: View) -> tuple[tuple[slice, slice], Float32]:
        where, lattice = _cells_under(view, shape, west_m, north_m, step)
        return where, _weights(camera, view, lattice, gsd_m)

    best = np.zeros(shape, np.float32)
    first = np.full(shape, -1, np.int32)
    for i, view in enumerate(views):
        where, weight = look(view)
        better = weight > best[where]
        best[where][better], first[where][better] = weight[better], i
    owned = np.bincount(first[first >= 0], minlength=len(views))

    kept: list[View] = []
    reached = np.zeros(shape, np.float32)
    owner = np.full(shape, -1, np.int32)
    for i in np.argsort(-owned, kind="stable")[: np.count_nonzero(owned)]:
        where, weight = look(views[i])
        now = reached[where]
        needed = (weight >= GOOD_ENOUGH * best[where]) & (now < GOOD_ENOUGH * best[where])
        only = (weight > 0) & (now == 0)
        if only.any() or needed.sum() > WORTH_KEEPING * np.count_nonzero(weight):
            better = weight > now
            now[better], owner[where][better] = weight[better], len(kept)
            kept.append(views[i])
    return tuple(kept), owner


def _cells_under(
    view: View, shape: tuple[int, ...], west_m: float, north_m: float, step_m: float
) -> tuple[tuple[slice, slice], Lattice]:
    west, south, east, north = view.bounds_m
    c0, r0 = max(0, int((west - west_m) / step_m)), max(0, int((north_m - north) / step_m))
    c1 = min(shape[1], int((east - west_m) / step_m) + 1)
    r1 = min(shape[0], int((north_m - south) / step_m) + 1)
    lattice = Lattice(west_m + (c0 + 0.5) * step_m, north_m - (r0 + 0.5) * step_m, step_m, r1 - r0, c1 - c0)
    return (slice(r0, r1), slice(c0, c1)), lattice


def _canvas(
    views: list[View], gsd_m: float | None, max_pixels: int
) -> tuple[float, float, float, int, int, str]:
    """Ground resolution, west and north end, width and height in pixels, and what to say about it."""
    bounds = np.array([v.bounds_m for v in views])
    (west, south), (east, north) = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
    area = float((east - west) * (north - south))
    note = ""
    if gsd_m is None:
        gsd_m = native = float(np.median([v.gsd_m for v in views]))
        if area / gsd_m**2 > max_pixels:
            # Whole pixels on all four sides may add a row and a column.
            gsd_m = float(np.sqrt(area / max_pixels)) * (1 + 4 / np.sqrt(max_pixels))
            note = (
                f"the pictures have {native:.3g} m/pixel; the mosaic has {gsd_m:.3g} m/pixel to stay below "
                f"{max_pixels / 1e6:.0f} megapixels"
            )
    elif area / gsd_m**2 > 4e9:
        raise MosaicError(
            f"{gsd_m:g} m/pixel would give {area / gsd_m**2:.2g} pixels over {east - west:.0f} x "
            f"{north - south:.0f} m; choose {np.sqrt(area / 4e9):.2g} m/pixel or coarser"
        )
    left, top = np.floor(west / gsd_m), np.ceil(north / gsd_m)
    width, height = int(np.ceil(east / gsd_m) - left), int(top - np.floor(south / gsd_m))
    return gsd_m, float(left * gsd_m), float(top * gsd_m), max(width, 1), max(height, 1), note


def _without_strays(views: list[View]) -> tuple[list[View], dict[int, str]]:
    """Leave out groups of pictures so far from the others that the canvas would be mostly empty."""
    if len(views) < 2:
        return views, {}
    bounds = np.array([v.bounds_m for v in views])
    side = float(np.percentile(bounds[:, 2:] - bounds[:, :2], 90))
    key = [tuple(c) for c in np.floor((bounds[:, :2] + bounds[:, 2:]) / (2 * side)).astype(np.int64).tolist()]
    graph = nx.Graph()
    graph.add_nodes_from(key)
    for x, y in list(graph):
        near = [(x + i, y + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        graph.add_edges_from(((x, y), other) for other in near if other in graph and other != (x, y))
    group = {node: g for g, nodes in enumerate(nx.connected_components(graph)) for node in nodes}
    of = np.array([group[c] for c in key])
    canvas, parts = np.array([np.inf, np.inf, -np.inf, -np.inf]), 0.0
    taken: set[int] = set()
    for g in np.argsort(-np.bincount(of), kind="stable"):
        box = _union(bounds[of == g])
        grown, area = _union(np.array([canvas, box])), _area(box)
        if not taken or _area(grown) <= CANVAS_RATIO * (parts + area):
            canvas, parts = grown, parts + area
            taken.add(int(g))
    reason = "lies far from the rest"
    return (
        [v for v, g in zip(views, of, strict=True) if int(g) in taken],
        {v.k: reason for v, g in zip(views, of, strict=True) if int(g) not in taken},
    )


def _union(bounds: Array) -> Array:
    return np.concatenate([bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)])


def _area(bounds: Array) -> float:
    return float(np.prod(bounds[2:] - bounds[:2]))
