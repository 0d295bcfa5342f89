"""Floor points followed through all keyframes: pairwise matches joined into tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from backend.measurements import FloorTracks
from frontend.camera import Camera
from frontend.cells import cells, place_in_run
from frontend.points import Points
from frontend.registration import Registration

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrackConfig:
    """How many points are enough: the longest tracks, spread over each picture."""

    grids: tuple[tuple[int, int], ...] = ((8, 6), (6, 4), (4, 3))
    """Cells across and down a picture, one track a cell and picture; coarser where there are too many."""
    max_observations: int = 30_000
    """What the refinement is given at most, so that memory does not grow with the length of the flight."""
    least_a_keyframe: int = 12
    """Observations that each keyframe keeps all the same."""


@dataclass(frozen=True)
class _Observations:
    """Features that show the same point as some other, sorted by track and keyframe."""

    keyframe: NDArray[np.int64]
    track: NDArray[np.int64]
    points: Points

    def __len__(self) -> int:
        return len(self.track)

    def __getitem__(self, which: NDArray[np.int64] | NDArray[np.bool_]) -> _Observations:
        return _Observations(self.keyframe[which], self.track[which], self.points[which])

    @property
    def length(self) -> NDArray[np.int64]:
        """(m,) how many observations each one's track has."""
        return np.bincount(self.track)[self.track] if len(self) else self.track

    def cells(self, camera: Camera, grid: tuple[int, int]) -> NDArray[np.int64]:
        """Number of the cell of its picture that each lies in; no two pictures share one."""
        return self.keyframe * grid[0] * grid[1] + cells(self.points.pixel, camera.size_px, grid)


def join_tracks(
    points: Sequence[Points], registrations: Sequence[Registration], camera: Camera, config: TrackConfig
) -> FloorTracks:
    """Tracks from the inliers of all kept registrations.

    ``points``: those of each keyframe. A component that holds two features
    of one keyframe joins two different points: it is left out whole.
    """
    noise = _noise_of_keyframes(len(points), registrations)
    seen = _joined(points, registrations)
    for grid in config.grids:
        chosen = seen[np.isin(seen.track, _longest_of_cells(seen, camera, grid))]
        if len(chosen) <= config.max_observations:
            break
    else:
        # Laps over the same ground: a point is seen from everywhere. Each keyframe keeps some of its points.
        quota = max(config.least_a_keyframe, config.max_observations // max(1, len(points)))
        chosen = _first_of_each(chosen, camera, grid, quota)
        chosen = chosen[chosen.length >= 2]
    _, track = np.unique(chosen.track, return_inverse=True)
    std_px = noise[chosen.keyframe] * chosen.points.spread
    return FloorTracks(chosen.keyframe, track, chosen.points.pixel, std_px)


def _joined(points: Sequence[Points], registrations: Sequence[Registration]) -> _Observations:
    """All tracks whole, but those that hold two features of one keyframe."""
    start = np.concatenate([[0], np.cumsum([len(p) for p in points], dtype=np.int64)])
    keyframe = np.repeat(np.arange(len(points)), np.diff(start))
    part = _parts(start, registrations)
    node = np.flatnonzero(np.bincount(part)[part] >= 2)
    order = node[np.lexsort((keyframe[node], part[node]))]
    twice = (np.diff(part[order]) == 0) & (np.diff(keyframe[order]) == 0)
    broken = np.unique(part[order][1:][twice])
    order = order[~np.isin(part[order], broken)]
    if len(order) == 0:
        return _Observations(order, order, Points.alike(np.empty((0, 2))))
    every = Points(np.concatenate([p.pixel for p in points]), np.concatenate([p.spread for p in points]))
    return _Observations(keyframe[order], part[order], every[order])


def _parts(start: NDArray[np.int64], registrations: Sequence[Registration]) -> NDArray[np.int64]:
    """The connected part of each feature; a long flight has millions of matches, so they are kept small."""
    none = np.empty(0, np.int32)
    a = np.concatenate([none, *((start[r.i] + r.matches[:, 0]).astype(np.int32) for r in registrations)])
    b = np.concatenate([none, *((start[r.j] + r.matches[:, 1]).astype(np.int32) for r in registrations)])
    joined = coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(start[-1],) * 2)
    _, part = connected_components(joined, directed=False)
    return part.astype(np.int64)


def _longest_of_cells(seen: _Observations, camera: Camera, grid: tuple[int, int]) -> NDArray[np.int64]:
    """The longest track of each cell of each picture."""
    cell = seen.cells(camera, grid)
    order = np.lexsort((seen.track, -seen.length, cell))
    return np.unique(seen.track[order][place_in_run(cell[order]) == 0])


def _first_of_each(seen: _Observations, camera: Camera, grid: tuple[int, int], quota: int) -> _Observations:
    """What each keyframe keeps: the longest track of each cell, then the second longest."""
    cell, length = seen.cells(camera, grid), seen.length
    order = np.lexsort((seen.track, -length, cell))
    order = order[np.lexsort((-length[order], place_in_run(cell[order]), seen.keyframe[order]))]
    return seen[np.sort(order[place_in_run(seen.keyframe[order]) < quota])]


def _noise_of_keyframes(count: int, registrations: Sequence[Registration]) -> Array:
    """(n,) px: median noise of the registrations that each keyframe takes part in."""
    told: list[list[float]] = [[] for _ in range(count)]
    for r in registrations:
        told[r.i].append(r.noise_px)
        told[r.j].append(r.noise_px)
    overall = float(np.median([r.noise_px for r in registrations])) if registrations else 1.0
    return np.array([float(np.median(t)) if t else overall for t in told])
