"""Predicted matches of a planned flight: points of a bare floor at their predicted positions.

No picture is rendered. Points lie on a grid of the later picture and are transferred into the earlier one by
the predicted path; their tones are random. The information on an error depends on the positions of the points
and on their noise, not on the texture of the floor.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam.core.arrays import Array
from slam.criticism.camera.camera_path import MARGIN_S, camera_path
from slam.criticism.camera.lens import floor_of, pixels_of
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.readings import SLOPE_X, SLOPE_Y
from slam.criticism.kalman.record import Record
from slam.data_quality.pictures.cells import CELL_STEPS, Cells
from slam.data_quality.pictures.feature_matches import MATCHES, STEPS, FeatureMatches
from slam.data_quality.pictures.tones import FEWEST

GRID = round(np.sqrt(MATCHES))
BORDER_SHARE = 0.05
"""Smallest distance of a feature to the edge, as a share of the picture's width."""
LEVELS, DETAIL = (60.0, 180.0), (5.0, 20.0)
"""Ranges of a floor's grey levels, and of their standard deviation around a point."""
TONE_NOISE, CELL_NOISE = 0.02, 0.02
"""Relative noise of the tones of a point, and of a cell, from picture to picture."""


def planned_matches(
    record: Record, parameters: FilterParameters, like: FeatureMatches, seed: int = 0
) -> FeatureMatches:
    """Return matches of the flight of ``record``, with the rate and pixel noise of the matches ``like``."""
    every_s = float(np.median(np.diff(like.stamps_s)))
    stamps_s = np.arange(record.times_s[0] + MARGIN_S, record.times_s[-1] - MARGIN_S, every_s)
    along = camera_path(record, replace(like, stamps_s=stamps_s), parameters)
    path, shown = along.path, np.flatnonzero(along.inside)
    pairs = [(j - step, j) for j in range(len(shown)) for step in STEPS if j >= step]
    i, j = np.repeat(np.array(pairs, dtype=np.int64).reshape(-1, 2), GRID**2, axis=0).T
    grid = _grid(like)
    pixel_j = np.tile(grid, (len(pairs), 1))
    camera, slope = parameters.camera, parameters.sensor[[SLOPE_X, SLOPE_Y]]
    floor = floor_of(like.camera, camera, path.poses[j], pixel_j, slope)
    pixel_i = pixels_of(like.camera, camera, path.poses[i], floor)
    edge = 0.5 * grid.min(axis=0)
    kept = ((pixel_i > edge) & (pixel_i < like.camera.size_px - edge)).all(axis=1)
    # Pictures with too little overlap cannot be registered.
    kept &= np.repeat(kept.reshape(-1, GRID**2).sum(axis=1) >= FEWEST, GRID**2)
    i, j, pixel_i, pixel_j = i[kept], j[kept], pixel_i[kept], pixel_j[kept]
    rng = np.random.default_rng(seed)
    near = np.isin(j - i, CELL_STEPS)
    cells = Cells(
        shown[i[near]], shown[j[near]], pixel_i[near], pixel_j[near],
        rng.normal(0.0, CELL_NOISE, int(near.sum())),
    )  # fmt: skip
    tone = np.column_stack([rng.uniform(*LEVELS, (len(i), 3)), rng.uniform(*DETAIL, len(i))])
    tone_i, tone_j = (tone * (1.0 + TONE_NOISE * rng.standard_normal(tone.shape)) for _ in range(2))
    std_px = np.full(len(i), float(np.median(like.std_px)))
    return replace(
        like, stamps_s=stamps_s, earlier=shown[i], later=shown[j], pixel_i=pixel_i, pixel_j=pixel_j,
        std_px=std_px, tone_i=tone_i, tone_j=tone_j, cells=cells, taken=len(stamps_s), missing=0,
        lens_distortion=replace(like.lens_distortion, pictures=len(stamps_s)), flicker=0.0,
        moving_s=np.zeros(0), spots=np.zeros((0, 3)),
    )  # fmt: skip


def _grid(like: FeatureMatches) -> Array:
    """Return (GRID^2, 2) pixels of a grid over the picture."""
    width, height = like.camera.size_px
    edge = BORDER_SHARE * width
    x, y = np.linspace(edge, width - edge, GRID), np.linspace(edge, height - edge, GRID)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
