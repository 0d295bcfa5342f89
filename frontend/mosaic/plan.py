"""Plan of a mosaic: its grid on the floor, the pictures that it needs, and the owner of each cell.

The owner of a cell is the picture that sees it best: far from the picture's border, from above, at the
resolution of the mosaic. Owners are assigned once for the whole mosaic, so that a tile rendered alone equals
the same tile of the whole. A greedy cover selects pictures: one is kept only if it sees some ground clearly
better than those kept before. The work then depends on the area, not on the length of the flight. What stands
on the ground has one owner: `frontend.mosaic.structures`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.mosaic.canvas import CELL_PX, MosaicError, MosaicGrid, SquareGrid, grid_over
from frontend.mosaic.extent import CANVAS_RATIO, intersection, share_within, union
from frontend.mosaic.structures import own_whole
from frontend.mosaic.surface import Surface, ground_heights, ground_maps, ground_seen
from frontend.mosaic.view import Lattice, MosaicView, mosaic_view, visible

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

POINTS_PER_SIDE = 20
"""Approximate number of exposure samples along the side of a picture."""
SUFFICIENT_RATIO = 0.6
"""Ground is covered once a kept picture has at least this share of the best weight there."""
MIN_NEEDED_SHARE = 0.02
"""Smallest share of the cells it sees for which a kept picture must be needed."""
HIDDEN = np.float32(1e-6)
"""Factor on the weight of ground that is hidden, so that what no picture sees still has an owner."""
TOO_FAR = "so far away that it would take too many of the mosaic's pixels"
"""Why ground is not drawn that a picture shows beyond the extent of the mosaic."""


@dataclass(frozen=True, kw_only=True)
class MosaicPlan(MosaicGrid):
    """Plan of a mosaic, made before any picture is read."""

    camera: Camera
    views: tuple[MosaicView, ...]
    """Pictures that are needed, in the order of their poses."""
    owner: NDArray[np.int32]
    """(rows, cols) index in ``views`` of the owner of each cell; -1 where no picture sees the ground."""
    floor_z_m: float
    """Height of the floor, from which the heights of ``surface`` count."""
    redundant: int = 0
    """Number of usable pictures that are not needed."""
    left_out: dict[int, str] = field(default_factory=dict)
    """Pose number -> why its picture cannot be used."""
    beyond: Mapping[int, float] = field(default_factory=dict)
    """Pose number -> share of the ground in its picture that lies beyond the extent of the mosaic."""
    note: str = ""
    """One sentence about a choice made for the user; empty if there was none."""
    surface: Surface | None = None
    """Ground that is not flat; None for the floor alone."""
    bounds_m: Mapping[int, Array] = field(default_factory=dict)
    """Pose number -> bounds (4,) of the ground in its picture, where that is not all of the floor in it."""

    def all_views(self, w_T_b: Array) -> tuple[MosaicView, ...]:
        """Return the views of all pictures at poses (n, 4, 4) that can be used, needed or not."""
        views = (
            mosaic_view(self.camera, k, pose, self.floor_z_m, self.bounds_m.get(k))
            for k, pose in enumerate(np.asarray(w_T_b, dtype=float))
            if k not in self.left_out
        )
        return tuple(view for view in views if isinstance(view, MosaicView))

    def pixels(
        self, view: MosaicView, lattice: Lattice, hidden_too: bool = False
    ) -> tuple[Float32, Float32, Mask]:
        """Return the pixel (u, v) of the ground at each node, and whether the picture sees it.

        ``hidden_too``: whether ground counts as seen that higher ground hides.
        """
        u, v, seen = ground_seen(self.camera, view, lattice, self.surface, hidden_too)
        w, h = self.camera.size_px
        return u, v, seen & (u >= 0) & (u <= w - 1) & (v >= 0) & (v <= h - 1)

    @cached_property  # the sides of all views, and each view asks for it
    def sampling(self) -> SquareGrid:
        """Squares in whose centres the exposure is sampled, about ``POINTS_PER_SIDE`` along a picture's side.

        Their pitch is ``CELL_PX`` times a power of two, and they are aligned to the grid.
        """
        sides = [np.sqrt(np.prod(v.bounds_m[2:] - v.bounds_m[:2])) for v in self.views]
        cells = float(np.median(sides)) / self.gsd_m / POINTS_PER_SIDE / CELL_PX
        pitch = CELL_PX * 2 ** max(0, round(np.log2(cells)))
        row, col = -(self.first_row % pitch), -(self.first_col % pitch)
        return SquareGrid(pitch, row, col, -(-(self.height - row) // pitch), -(-(self.width - col) // pitch))


def plan_mosaic(
    camera: Camera,
    w_T_b: Array,
    floor_z_m: float = 0.0,
    gsd_m: float | None = None,
    max_pixels: int = 60_000_000,
    leave_out: Mapping[int, str] | None = None,
    unit: str = "m",
    surface: Surface | None = None,
    bounds_m: Mapping[int, Array] | None = None,
) -> MosaicPlan:
    """Plan the grid, the pictures and the owners for poses (n, 4, 4) over the floor z = floor_z_m.

    With a ``surface``, pictures in which higher ground hides a cell do not become its owner. ``bounds_m`` are
    those of the ground in each picture by the number of its pose; the default is those of the floor.

    ``gsd_m`` is the ground sample distance in m/pixel. If it is None, it is the median of the pictures' that
    look down, made coarser until the mosaic has at most ``max_pixels``. Far ground of tilted pictures is left
    out first: `frontend.mosaic.extent`. ``leave_out`` maps pose numbers of pictures that must not be used to
    the reasons. ``unit`` is the name of the unit of length in the texts.

    Raises ``MosaicError`` if no picture sees the floor or the given ``gsd_m`` needs too many pixels.
    """
    left_out, of_ground = dict(leave_out or {}), dict(bounds_m or {})
    views: list[MosaicView] = []
    for k, pose in enumerate(np.asarray(w_T_b, dtype=float)):
        if k in left_out:
            continue
        view = mosaic_view(camera, k, pose, floor_z_m, of_ground.get(k))
        if isinstance(view, str):
            left_out[k] = view
        else:
            views.append(view)
    views, distant = _without_distant_groups(views)
    left_out |= distant
    if not views:
        reasons = ", ".join(sorted(set(left_out.values()))) or "there are none"
        raise MosaicError(f"no picture can be put into a mosaic: {reasons}")
    canvas, extent, note = grid_over(views, gsd_m, max_pixels, unit)
    views, beyond = _within(views, extent)
    left_out |= {k: f"all ground that it shows is {TOO_FAR}" for k in beyond.keys() - {v.k for v in views}}
    of_ground |= {view.k: view.bounds_m for view in views if view.k in beyond}
    kept, owner = _owners(camera, views, canvas, surface)
    return MosaicPlan(
        **vars(canvas), camera=camera, views=kept, owner=owner, redundant=len(views) - len(kept),
        left_out=left_out, beyond=beyond, note=note, floor_z_m=floor_z_m, surface=surface,
        bounds_m=of_ground,
    )  # fmt: skip


def _within(views: list[MosaicView], extent_m: Array) -> tuple[list[MosaicView], dict[int, float]]:
    """Return the views of ground within an extent (4,), and the shares of ground beyond it by pose number."""
    within, beyond = list[MosaicView](), dict[int, float]()
    for view in views:
        bounds = intersection(view.bounds_m, extent_m)
        if not np.array_equal(bounds, view.bounds_m):
            beyond[view.k] = 1.0 - share_within(view, extent_m)
        if beyond.get(view.k, 0.0) < 1.0:
            within.append(replace(view, bounds_m=bounds))
    return within, beyond


def _weights(
    camera: Camera, view: MosaicView, lattice: Lattice, gsd_m: float, surface: Surface | None
) -> Float32:
    """Return the weight (rows, cols) of a picture in each cell, 0 where it does not see the cell.

    The weight is the product of a dome over the picture (1 in the centre, 0 at the border), the cosine of the
    angle off nadir, and the resolution relative to the mosaic's, at most 1.
    """
    height_m = ground_heights(surface, lattice)
    seen, nadir, resolution = visible(view, lattice, height_m)
    u, v = ground_maps(camera, view, lattice, height_m)
    if surface is not None:
        nadir = np.where(surface.hidden(view, lattice), HIDDEN * nadir, nadir)
    w, h = camera.size_px
    border = np.minimum(np.minimum(u, w - 1 - u), np.minimum(v, h - 1 - v))
    # A cell whose centre lies just outside may still have pixels inside.
    touches = seen & (border > -0.75 * lattice.step_m * resolution)
    dome = (4 / w * u * (1 - u / (w - 1))) * (4 / h * v * (1 - v / (h - 1)))
    inside = np.where(border > 1, dome, 1e-6 * np.exp(np.minimum(border - 1, 0)))
    return np.where(touches, inside * nadir * np.minimum(1, gsd_m * resolution), 0).astype(np.float32)


def _owners(
    camera: Camera, views: list[MosaicView], canvas: MosaicGrid, surface: Surface | None
) -> tuple[tuple[MosaicView, ...], NDArray[np.int32]]:
    """Return the pictures to keep, and the index of the owner of each cell.

    A greedy cover tries pictures by the number of cells where they have the best weight, largest first.
    """
    shape = canvas.cell_shape

    def weights_under(view: MosaicView) -> tuple[tuple[slice, slice], Float32]:
        where, lattice = canvas.cells_under(view)
        return where, _weights(camera, view, lattice, canvas.gsd_m, surface)

    best = np.zeros(shape, np.float32)
    first = np.full(shape, -1, np.int32)
    for i, view in enumerate(views):
        where, weight = weights_under(view)
        better = weight > best[where]
        best[where][better], first[where][better] = weight[better], i
    owned = np.bincount(first[first >= 0], minlength=len(views))

    kept: list[int] = []
    covered = np.zeros(shape, np.float32)
    owner = np.full(shape, -1, np.int32)
    for i in np.argsort(-owned, kind="stable")[: np.count_nonzero(owned)]:
        where, weight = weights_under(views[i])
        now = covered[where]
        needed = (weight >= SUFFICIENT_RATIO * best[where]) & (now < SUFFICIENT_RATIO * best[where])
        only = (weight > 0) & (now == 0)
        if only.any() or needed.sum() > MIN_NEEDED_SHARE * np.count_nonzero(weight):
            better = weight > now
            now[better], owner[where][better] = weight[better], i
            kept.append(int(i))
    # Sorted by pose: a change of rank must not change how other pictures overlap.
    kept.sort()
    number = np.full(len(views) + 1, -1, np.int32)
    number[kept] = np.arange(len(kept))
    used, owner = tuple(views[i] for i in kept), number[owner]
    if surface is None:
        return used, owner

    def shown(view: MosaicView, lattice: Lattice) -> Float32:
        weight = _weights(camera, view, lattice, canvas.gsd_m, surface)
        return np.where(weight > HIDDEN, weight, np.float32(0))

    return used, own_whole(owner, surface, canvas, used, shown)


def _without_distant_groups(views: list[MosaicView]) -> tuple[list[MosaicView], dict[int, str]]:
    """Leave out groups of pictures so far from the others that the mosaic would be mostly empty."""
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
    included: set[int] = set()
    for g in np.argsort(-np.bincount(of), kind="stable"):
        box = union(bounds[of == g])
        grown, area = union(np.array([canvas, box])), _area(box)
        if not included or _area(grown) <= CANVAS_RATIO * (parts + area):
            canvas, parts = grown, parts + area
            included.add(int(g))
    reason = "lies far from the rest"
    return (
        [v for v, g in zip(views, of, strict=True) if int(g) in included],
        {v.k: reason for v, g in zip(views, of, strict=True) if int(g) not in included},
    )


def _area(bounds: Array) -> float:
    return float(np.prod(bounds[2:] - bounds[:2]))
