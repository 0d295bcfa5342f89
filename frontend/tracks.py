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


def join_tracks(
    pixels: Sequence[Array], registrations: Sequence[Registration], camera: Camera, config: TrackConfig
) -> FloorTracks:
    """Tracks from the inliers of all kept registrations.

    ``pixels``: (n_k, 2) undistorted feature positions of each keyframe. A component that holds two features
    of one keyframe joins two different points: it is left out whole.
    """
    start = np.concatenate([[0], np.cumsum([len(p) for p in pixels], dtype=np.int64)])
    keyframe = np.repeat(np.arange(len(pixels)), np.diff(start))
    noise = _noise_of_keyframes(len(pixels), registrations)
    label = _parts(start, registrations)
    length = np.bincount(label)
    node = np.flatnonzero(length[label] >= 2)
    order = node[np.lexsort((keyframe[node], label[node]))]
    twice = (np.diff(label[order]) == 0) & (np.diff(keyframe[order]) == 0)
    broken = np.unique(label[order][1:][twice])
    order = order[~np.isin(label[order], broken)]
    pixel = np.concatenate(list(pixels))[order] if len(order) else np.empty((0, 2))
    for grid in config.grids:
        keep = np.isin(label[order], _choose(keyframe[order], label[order], length, pixel, camera, grid))
        if keep.sum() <= config.max_observations:
            break
    else:
        # Laps over the same ground: a point is seen from everywhere. Each keyframe keeps some of its points.
        quota = max(config.least_a_keyframe, config.max_observations // max(1, len(pixels)))
        kept = np.flatnonzero(keep)
        seen = label[order][kept]
        kept = kept[_first_of_each(keyframe[order][kept], seen, length, pixel[kept], camera, grid, quota)]
        kept = kept[np.bincount(label[order][kept], minlength=len(length))[label[order][kept]] >= 2]
        keep[:] = False
        keep[kept] = True
    _, track = np.unique(label[order][keep], return_inverse=True)
    k = keyframe[order][keep]
    return FloorTracks(k, track, pixel[keep], noise[k])


def _parts(start: NDArray[np.int64], registrations: Sequence[Registration]) -> NDArray[np.int64]:
    """The connected part of each feature; a long flight has millions of matches, so they are kept small."""
    none = np.empty(0, np.int32)
    a = np.concatenate([none, *((start[r.i] + r.matches[:, 0]).astype(np.int32) for r in registrations)])
    b = np.concatenate([none, *((start[r.j] + r.matches[:, 1]).astype(np.int32) for r in registrations)])
    joined = coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(start[-1],) * 2)
    _, part = connected_components(joined, directed=False)
    return part.astype(np.int64)


def _choose(
    keyframe: NDArray[np.int64],
    label: NDArray[np.int64],
    length: NDArray[np.int64],
    pixel: Array,
    camera: Camera,
    grid: tuple[int, int],
) -> NDArray[np.int64]:
    """Labels of the longest track of each cell of each picture."""
    cell = _cells(keyframe, pixel, camera, grid)
    order = np.lexsort((label, -length[label], cell))
    return np.unique(label[order][_place(cell[order]) == 0])


def _first_of_each(
    keyframe: NDArray[np.int64],
    label: NDArray[np.int64],
    length: NDArray[np.int64],
    pixel: Array,
    camera: Camera,
    grid: tuple[int, int],
    quota: int,
) -> NDArray[np.int64]:
    """Which observations each keyframe keeps: the longest track of each cell, then the second longest."""
    cell = _cells(keyframe, pixel, camera, grid)
    order = np.lexsort((label, -length[label], cell))
    order = order[np.lexsort((-length[label[order]], _place(cell[order]), keyframe[order]))]
    return np.sort(order[_place(keyframe[order]) < quota])


def _cells(
    keyframe: NDArray[np.int64], pixel: Array, camera: Camera, grid: tuple[int, int]
) -> NDArray[np.int64]:
    """Number of the cell of its picture that each observation lies in; no two pictures share one."""
    across, down = grid
    w, h = camera.size_px
    column = np.clip(pixel[:, 0] * across / w, 0, across - 1).astype(np.int64)
    row = np.clip(pixel[:, 1] * down / h, 0, down - 1).astype(np.int64)
    return (keyframe * down + row) * across + column


def _place(group: NDArray[np.int64]) -> NDArray[np.int64]:
    """Place of each entry in its run of equal ones: 0, 1, 2, ..."""
    begin = np.flatnonzero(np.diff(group, prepend=-1))
    return np.arange(len(group)) - np.repeat(begin, np.diff(begin, append=len(group)))


def _noise_of_keyframes(count: int, registrations: Sequence[Registration]) -> Array:
    """(n,) px: median noise of the registrations that each keyframe takes part in."""
    told: list[list[float]] = [[] for _ in range(count)]
    for r in registrations:
        told[r.i].append(r.noise_px)
        told[r.j].append(r.noise_px)
    overall = float(np.median([r.noise_px for r in registrations])) if registrations else 1.0
    return np.array([float(np.median(t)) if t else overall for t in told])
