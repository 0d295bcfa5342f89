"""Differences in brightness, contrast and sharpness of the same floor points between pictures.

A healthy camera shows a point alike in every picture. Each pair of pictures gives seven figures. Each is the
difference of a property t of the two pictures, y = t_i - t_j + noise. A systematic effect (vignetting, blur,
a trend) gives t a pattern; a random one (exposure) gives it a variance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from frontend.robust import robust_std
from slam.data_quality.pictures.cells import BRIGHTEST, DARKEST, radius2
from slam.data_quality.pictures.feature_matches import FeatureMatches
from slam.data_quality.pictures.lens_shading_map import LensShadingMap, lens_shading_map

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

FIGURES = 7
BLUE, GREEN, RED, CONTRAST, SHARPNESS, SHADING, SHADING_MAP = range(FIGURES)
"""Logarithms of the level of each colour, of the contrast over the floor divided by the level, and of the
local detail divided by the contrast; the loss of brightness towards the corners; and the amplitude of the
lens shading map that other pictures predict."""
FEWEST = 8
"""Least number of matches for the figures of a pair."""
LEAST_STD = np.array([0.002, 0.002, 0.002, 0.004, 0.008, 0.004, 0.004])
"""Least standard deviation of each figure, as pictures are rounded and compressed."""
CLIP = 4.0
NOT_MEASURED = 0.0, np.inf
"""Value and standard deviation of a figure that a pair does not show."""


@dataclass(frozen=True)
class Tones:
    """Figures of all pairs of pictures of a flight."""

    i: Ints
    """(p,) index of the earlier picture."""
    j: Ints
    """(p,) index of the later picture."""
    figures: Array
    """(p, 7) values."""
    std: Array
    """(p, 7) standard deviations; infinite where a pair does not show a figure."""
    outward: Array
    """(p,) mean difference between i and j of the points' r^2, with r in half diagonals from the centre."""
    zoom: Array
    """(p,) logarithm of the floor's scale in i over that in j, which height and tilt change."""
    depth: Array
    """(p, 3) logarithm of white over each colour's level, the derivative of the logarithm in gamma."""
    shading_map_rms: float
    """Root mean square of the lens shading map that other pictures predict, at least 1e-6."""

    def some(self, kept: NDArray[np.bool_]) -> Tones:
        """Return only the pairs of the mask (p,)."""
        of_pairs = ("i", "j", "figures", "std", "outward", "zoom", "depth")
        return replace(self, **{name: getattr(self, name)[kept] for name in of_pairs})


_WORKED_OUT: WeakKeyDictionary[FeatureMatches, Tones] = WeakKeyDictionary()
"""Tones of each flight's matches; they do not depend on the filter parameters."""


def tones_of(matches: FeatureMatches) -> Tones:
    """Return the figures of every pair with enough matches; none if the pictures show flicker bands."""
    if matches not in _WORKED_OUT:
        _WORKED_OUT[matches] = _worked_out(matches)
    return _WORKED_OUT[matches]


def _worked_out(matches: FeatureMatches) -> Tones:
    rows: list[tuple[object, ...]] = []
    if matches.uneven:
        return _joined(rows, 0.0)
    key = matches.earlier * (len(matches.stamps_s) + 1) + matches.later
    order = np.argsort(key, kind="stable")
    bounds = np.flatnonzero(np.diff(key[order], prepend=-1, append=-1))
    stain = lens_shading_map(matches.camera, matches.cells)
    matches = _cleaned(matches, stain)
    shares = _shares(matches, stain)
    for begin, end in pairwise(bounds.tolist()):
        own = order[begin:end]
        i, j = int(matches.earlier[own[0]]), int(matches.later[own[0]])
        found = _figures(matches, own, shares.get((i, j), NOT_MEASURED))
        if found is not None:
            outward = _outward(matches, own).mean()
            zoom = np.log(_extent(matches.pixel_i[own]) / _extent(matches.pixel_j[own]))
            rows.append((i, j, *found, outward, zoom, _depth(matches, own)))
    tones = _joined(rows, max(float(np.sqrt(np.mean(stain.predicted_by_others**2))), 1e-6))
    if matches.glares:
        tones.std[:, [SHADING, SHADING_MAP]] = np.inf
    return tones


def _joined(rows: Sequence[tuple[object, ...]], shading_map_rms: float) -> Tones:
    """Return the tones of pairs, each with its pictures and its values in the order of the fields."""
    index = np.array([row[:2] for row in rows], dtype=np.int64).reshape(-1, 2)
    columns = (np.array([row[k] for row in rows], dtype=np.float64) for k in range(2, 7))
    figures, std, outward, zoom, depth = columns
    return Tones(
        index[:, 0], index[:, 1], figures.reshape(-1, FIGURES), std.reshape(-1, FIGURES), outward, zoom,
        depth.reshape(-1, 3), shading_map_rms,
    )  # fmt: skip


def _usable(a: Array, b: Array) -> NDArray[np.bool_]:
    both = np.column_stack([a[:, :3], b[:, :3]])
    usable = (both > DARKEST).all(axis=1) & (both < BRIGHTEST).all(axis=1)
    return np.asarray(usable & (a[:, 3] > 1.0) & (b[:, 3] > 1.0))


def _cleaned(matches: FeatureMatches, stain: LensShadingMap) -> FeatureMatches:
    """Return the matches without the lens shading map, which would pass for random exposure."""
    return replace(
        matches,
        tone_i=matches.tone_i * np.exp(-stain.at(matches.pixel_i))[:, None],
        tone_j=matches.tone_j * np.exp(-stain.at(matches.pixel_j))[:, None],
    )


def _figures(matches: FeatureMatches, own: Ints, share: tuple[float, float]) -> tuple[Array, Array] | None:
    a, b = matches.tone_i[own], matches.tone_j[own]
    usable = _usable(a, b)
    if usable.sum() < FEWEST:
        return None
    grey_i, grey_j = a[usable, :3].mean(axis=1), b[usable, :3].mean(axis=1)
    ratio = np.log(grey_i / grey_j)
    middle, spread = _middle(ratio)
    alike = np.abs(ratio - middle) < CLIP * max(spread, 0.01)
    if alike.sum() < FEWEST:
        return None
    a, b, own = a[usable][alike], b[usable][alike], own[usable][alike]
    grey_i, grey_j, ratio = grey_i[alike], grey_j[alike], ratio[alike]
    m = len(own)
    values, std = np.empty(FIGURES), np.empty(FIGURES)
    for colour in range(3):
        values[colour], spread = _middle(np.log(a[:, colour] / b[:, colour]))
        std[colour] = 1.25 * spread / np.sqrt(m)
    outward = _outward(matches, own)
    away = outward - outward.mean()
    values[SHADING] = float(away @ ratio / max(away @ away, 1e-9))
    std[SHADING] = float(np.std(ratio)) / np.sqrt(max(away @ away, 1e-9))
    # Without the shading, the rest is a property of the whole picture.
    without_shading = np.exp(-values[SHADING] * away)
    grey_i, local_i = grey_i * without_shading, a[:, 3] * without_shading
    like = np.corrcoef(grey_i, grey_j)[0, 1]
    wider = float(np.log(np.std(grey_i) / np.std(grey_j)))
    of_wider = float(np.sqrt(max(1.0 - like**2, 1e-6) / m))
    values[CONTRAST] = wider - values[:3].mean()
    std[CONTRAST] = of_wider + std[:3].mean()
    detail, spread = _middle(np.log(local_i / b[:, 3]))
    values[SHARPNESS], std[SHARPNESS] = detail - wider, np.hypot(1.25 * spread / np.sqrt(m), of_wider)
    values[SHADING_MAP], std[SHADING_MAP] = share
    return values, np.hypot(std, LEAST_STD)


def _shares(matches: FeatureMatches, stain: LensShadingMap) -> dict[tuple[int, int], tuple[float, float]]:
    """Compute the shares of each pair of pictures whose cells are compared."""
    cells = matches.cells
    outward = radius2(matches.camera, cells.pixel_i) - radius2(matches.camera, cells.pixel_j)
    return {
        (int(cells.earlier[run.start]), int(cells.later[run.start])): _share(
            stain.predicted_by_others[run], cells.ratio[run], outward[run]
        )
        for run in cells.runs
        if run.stop - run.start >= FEWEST
    }


def _share(predicted_by_others: Array, ratio: Array, outward: Array) -> tuple[float, float]:
    """Return the amplitude of the predicted pattern beside a vignette, and its standard deviation."""
    free = np.column_stack([np.ones_like(outward), outward])
    both = np.column_stack([predicted_by_others, ratio])
    away, left = (both - free @ np.linalg.lstsq(free, both, rcond=None)[0]).T
    weight = max(float(away @ away), 1e-12)
    return float(away @ left) / weight, float(np.std(left)) / np.sqrt(weight)


def _middle(x: Array) -> tuple[float, float]:
    """Return the median and the robust standard deviation."""
    middle = float(np.median(x))
    return middle, robust_std(x - middle)


def _outward(matches: FeatureMatches, own: Ints) -> Array:
    return radius2(matches.camera, matches.pixel_i[own]) - radius2(matches.camera, matches.pixel_j[own])


def _extent(pixel: Array) -> float:
    """Return the spread of points in px, at least 1."""
    return max(float(np.sqrt(np.var(pixel, axis=0).sum())), 1.0)


def _depth(matches: FeatureMatches, own: Ints) -> Array:
    level = np.median(np.concatenate([matches.tone_i[own, :3], matches.tone_j[own, :3]]), axis=0)
    return np.asarray(np.log(255.0 / np.maximum(level, 1.0)))
