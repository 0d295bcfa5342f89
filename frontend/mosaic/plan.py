"""Position of a mosaic on the floor, the pictures that it needs, and the owner of each piece of ground.

The owner of a piece of ground is the picture that sees it best: far from the picture's border, from
above, at the resolution of the mosaic. Owners are found once for the whole mosaic on a coarse lattice of
cells, so that a tile can be rendered alone and still equals the same tile of the whole. Of many pictures
of one spot (a hovering drone) only those are kept that see some ground clearly better than the ones kept
before (greedy cover), so that the work grows with the ground and not with the flight.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.mosaic.canvas import CELL_PX, MosaicError, MosaicGrid, Squares, grid_over
from frontend.mosaic.view import Lattice, MosaicView, mosaic_view, pixel_maps, visible

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]

POINTS_A_SIDE = 20
"""Exposure is sampled on about this many points along the side of a picture."""
GOOD_ENOUGH = 0.6
"""A picture need not be kept for ground that a kept one sees at least this well, as a share of the best."""
WORTH_KEEPING = 0.02
"""Share of its own ground for which a picture must be needed to be kept."""
CANVAS_RATIO = 4.0
"""Pictures apart from the rest are left out where the canvas would grow beyond this many times its parts."""


@dataclass(frozen=True, kw_only=True)
class MosaicPlan(MosaicGrid):
    """The mosaic before a single picture is read."""

    camera: Camera
    views: tuple[MosaicView, ...]
    """The pictures that are needed, in the order of their poses."""
    owner: NDArray[np.int32]
    """(rows, cols) of cells: which of ``views`` owns each; -1 where none sees the ground."""
    redundant: int = 0
    """Pictures that could be used and show nothing that the kept ones don't show as well."""
    left_out: dict[int, str] = field(default_factory=dict)
    """Pose number -> why its picture cannot be used."""
    note: str = ""
    """One sentence about a choice made for the user; empty if there was none."""

    @property
    def sampling(self) -> Squares:
        """In whose middles pictures are compared for their exposure: about ``POINTS_A_SIDE`` along the side
        of a picture; doubled or halved, never shifted."""
        sides = [np.sqrt(np.prod(v.bounds_m[2:] - v.bounds_m[:2])) for v in self.views]
        cells = float(np.median(sides)) / self.gsd_m / POINTS_A_SIDE / CELL_PX
        pitch = CELL_PX * 2 ** max(0, round(np.log2(cells)))
        row, col = -(self.first_row % pitch), -(self.first_col % pitch)
        return Squares(pitch, row, col, -(-(self.height - row) // pitch), -(-(self.width - col) // pitch))


def plan_mosaic(
    camera: Camera,
    w_T_b: Array,
    floor_z_m: float = 0.0,
    gsd_m: float | None = None,
    max_pixels: int = 60_000_000,
    leave_out: Mapping[int, str] | None = None,
) -> MosaicPlan:
    """Plan the grid, the pictures and the owners for poses (n, 4, 4) over the floor z = floor_z_m.

    ``gsd_m`` is the ground resolution in m/pixel; where none is given it is the median of what the pictures
    have, made coarser until the mosaic has at most ``max_pixels``. ``leave_out`` names pictures not to use,
    with reasons.

    Raises ``MosaicError`` where no picture sees the floor or a given ``gsd_m`` asks for too many pixels.
    """
    left_out = dict(leave_out or {})
    views: list[MosaicView] = []
    for k, pose in enumerate(np.asarray(w_T_b, dtype=float)):
        if k in left_out:
            continue
        view = mosaic_view(camera, k, pose, floor_z_m)
        if isinstance(view, str):
            left_out[k] = view
        else:
            views.append(view)
    views, apart = _without_strays(views)
    left_out |= apart
    if not views:
        reasons = ", ".join(sorted(set(left_out.values()))) or "there are none"
        raise MosaicError(f"no picture can be put into a mosaic: {reasons}")
    canvas, note = grid_over(views, gsd_m, max_pixels)
    kept, owner = _owners(camera, views, canvas)
    return MosaicPlan(
        **vars(canvas), camera=camera, views=kept, owner=owner, redundant=len(views) - len(kept),
        left_out=left_out, note=note,
    )  # fmt: skip


def _weights(camera: Camera, view: MosaicView, lattice: Lattice, gsd_m: float) -> Float32:
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
    camera: Camera, views: list[MosaicView], canvas: MosaicGrid
) -> tuple[tuple[MosaicView, ...], NDArray[np.int32]]:
    """The pictures to keep, and for each cell which of them owns it.

    A greedy cover: pictures are tried in the order of the ground that they see best.
    """
    shape = canvas.cell_shape

    def look(view: MosaicView) -> tuple[tuple[slice, slice], Float32]:
        where, lattice = canvas.cells_under(view)
        return where, _weights(camera, view, lattice, canvas.gsd_m)

    best = np.zeros(shape, np.float32)
    first = np.full(shape, -1, np.int32)
    for i, view in enumerate(views):
        where, weight = look(view)
        better = weight > best[where]
        best[where][better], first[where][better] = weight[better], i
    owned = np.bincount(first[first >= 0], minlength=len(views))

    kept: list[int] = []
    reached = np.zeros(shape, np.float32)
    owner = np.full(shape, -1, np.int32)
    for i in np.argsort(-owned, kind="stable")[: np.count_nonzero(owned)]:
        where, weight = look(views[i])
        now = reached[where]
        needed = (weight >= GOOD_ENOUGH * best[where]) & (now < GOOD_ENOUGH * best[where])
        only = (weight > 0) & (now == 0)
        if only.any() or needed.sum() > WORTH_KEEPING * np.count_nonzero(weight):
            better = weight > now
            now[better], owner[where][better] = weight[better], i
            kept.append(int(i))
    # By pose, not by rank: a picture whose rank changes shall not change how others overlap.
    kept.sort()
    number = np.full(len(views) + 1, -1, np.int32)
    number[kept] = np.arange(len(kept))
    return tuple(views[i] for i in kept), number[owner]


def _without_strays(views: list[MosaicView]) -> tuple[list[MosaicView], dict[int, str]]:
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
