"""Tracks of floor points through all keyframes, joined from pairwise matches."""

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
    """Selection of tracks: the longest ones, spread over each picture."""

    grids: tuple[tuple[int, int], ...] = ((8, 6), (6, 4), (4, 3))
    """Grids (columns, rows) with one track per cell and picture, from fine to coarse."""
    max_observations: int = 30_000
    """Largest number of observations, so that memory does not grow with the length of the flight."""
    least_a_keyframe: int = 12
    """Least number of observations that each keyframe keeps."""


_JOINED_AT_ONCE = 1_000
"""Registrations joined in one batch."""


@dataclass(frozen=True)
class _Observations:
    """Features with a match, sorted by track and keyframe.

    A long flight has a million of them: small integers save memory.
    """

    feature: NDArray[np.int32]
    """Feature number, counted through all keyframes."""
    keyframe: NDArray[np.int32]
    track: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.track)

    def __getitem__(self, which: NDArray[np.int64] | NDArray[np.bool_]) -> _Observations:
        return _Observations(self.feature[which], self.keyframe[which], self.track[which])

    @property
    def length(self) -> NDArray[np.int64]:
        """Return (m,) the number of observations of each one's track."""
        return np.bincount(self.track)[self.track]


def join_tracks(
    points: Sequence[Points], registrations: Sequence[Registration], camera: Camera, config: TrackConfig
) -> FloorTracks:
    """Join tracks from the inliers of all accepted registrations.

    ``points``: undistorted points of each keyframe; the tracks hold them as recorded. A component with two
    features of one keyframe joins two different points and is dropped.
    """
    noise = _noise_of_keyframes(len(points), registrations)
    start = np.cumsum([0, *(len(p) for p in points)])
    seen = _joined(start, registrations)
    for grid in config.grids:
        cell = _cells(points, camera, grid)
        chosen = seen[np.isin(seen.track, _longest_of_cells(seen, cell))]
        if len(chosen) <= config.max_observations:
            break
    else:
        # Repeated laps over the same ground make long tracks: each keyframe keeps a quota of its points.
        quota = max(config.least_a_keyframe, config.max_observations // max(1, len(points)))
        chosen = _first_of_each(chosen, cell, quota)
        chosen = chosen[chosen.length >= 2]
    _, track = np.unique(chosen.track, return_inverse=True)
    keyframe = chosen.keyframe.astype(np.int64)
    pixel, spread = np.empty((len(chosen), 2)), np.empty(len(chosen))
    for k in np.unique(keyframe).tolist():
        mine = keyframe == k
        seen_from_k = points[k][chosen.feature[mine] - start[k]]
        pixel[mine], spread[mine] = seen_from_k.pixel, seen_from_k.spread
    std_px = noise[keyframe] * spread / camera.magnification(pixel)
    return FloorTracks(keyframe, track, camera.recorded(pixel), std_px)


def _joined(start: NDArray[np.int64], registrations: Sequence[Registration]) -> _Observations:
    """Return all complete tracks except those with two features of one keyframe."""
    keyframe = np.repeat(np.arange(len(start) - 1, dtype=np.int32), np.diff(start))
    part = _components(start, registrations)
    feature = np.flatnonzero(np.bincount(part)[part] >= 2).astype(np.int32)
    feature = feature[np.argsort(part[feature], kind="stable")]
    seen = _Observations(feature, keyframe[feature], part[feature])
    twice = (np.diff(seen.track) == 0) & (np.diff(seen.keyframe) == 0)
    return seen[~np.isin(seen.track, seen.track[1:][twice])]


def _components(start: NDArray[np.int64], registrations: Sequence[Registration]) -> NDArray[np.int32]:
    """Return the connected component of each feature; ``start``: first feature number of each keyframe.

    A long flight has millions of matches, and scipy copies a graph several times: matches are joined in
    batches.
    """
    part = np.arange(start[-1], dtype=np.int32)
    for k in range(0, len(registrations), _JOINED_AT_ONCE):
        some = registrations[k : k + _JOINED_AT_ONCE]
        a = part[np.concatenate([start[r.i] + r.matches[:, 0] for r in some])]
        b = part[np.concatenate([start[r.j] + r.matches[:, 1] for r in some])]
        joined = coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(part.max() + 1,) * 2)
        _, merged = connected_components(joined, directed=False)
        part = merged[part]
    return part


def _cells(points: Sequence[Points], camera: Camera, grid: tuple[int, int]) -> NDArray[np.int32]:
    """Return the cell number of each feature; cell numbers differ between pictures."""
    none, count = np.empty(0, np.int32), grid[0] * grid[1]
    each = (cells(p.pixel, camera.size_px, grid) + k * count for k, p in enumerate(points))
    return np.concatenate([none, *(cell.astype(np.int32) for cell in each)])


def _longest_of_cells(seen: _Observations, cell: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the longest track of each cell of each picture, the first of equally long ones."""
    if len(seen) == 0:
        return np.empty(0, np.int64)
    tracks = int(seen.track.max()) + 1
    longest = np.full(int(cell.max()) + 1, -1)
    np.maximum.at(longest, cell[seen.feature], seen.length * tracks + (tracks - 1 - seen.track))
    return tracks - 1 - np.unique(longest[longest >= 0] % tracks)


def _first_of_each(seen: _Observations, cell: NDArray[np.int32], quota: int) -> _Observations:
    """Select ``quota`` observations per keyframe: the longest track of each cell, then the second longest."""
    cell_of, keyframe, length = (
        cell[seen.feature].astype(np.int64),
        seen.keyframe.astype(np.int64),
        seen.length,
    )
    order = np.lexsort((seen.track, -length, cell_of))
    order = order[np.lexsort((-length[order], place_in_run(cell_of[order]), keyframe[order]))]
    return seen[np.sort(order[place_in_run(keyframe[order]) < quota])]


def _noise_of_keyframes(count: int, registrations: Sequence[Registration]) -> Array:
    """Return (n,) the median noise in px of the registrations of each keyframe."""
    noise: list[list[float]] = [[] for _ in range(count)]
    for r in registrations:
        noise[r.i].append(r.noise_px)
        noise[r.j].append(r.noise_px)
    overall = float(np.median([r.noise_px for r in registrations])) if registrations else 1.0
    return np.array([float(np.median(t)) if t else overall for t in noise])
