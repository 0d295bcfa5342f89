"""How bright, how contrasty and how sharp the same points of the floor look from picture to picture.

A healthy camera shows a point alike in every picture. Of each pair of pictures seven figures are taken, each
the difference of a property t of the two pictures, y = t_i - t_j + noise. A mean effect gives t a shape
(vignetting, blur, a trend), a restless one (exposure) a variance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from frontend.robust import robust_std
from slam.criticism.camera.cells import BRIGHTEST, DARKEST, radius2
from slam.criticism.camera.feature_matches import FeatureMatches
from slam.criticism.camera.lens_shading_map import LensShadingMap, lens_shading_map

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

FIGURES = 7
BLUE, GREEN, RED, CONTRAST, SHARPNESS, SHADING, STAIN = range(FIGURES)
"""Logarithms of: the level of each colour, its spread over the floor beside its mean, the local variation
beside that; how much darker pictures are towards the corners; and share of the stain that other pictures
foretell."""
FEWEST = 8
"""Matches of a pair that its figures are taken from."""
LEAST_STD = np.array([0.002, 0.002, 0.002, 0.004, 0.008, 0.004, 0.004])
"""No figure of a pair is known better: pictures are rounded and compressed."""
WANDER = np.array([0.006, 0.006, 0.006, 0.004, 0.03, 0.003, 0.003])
"""Standard deviation of a healthy picture's properties: other floor points are visible, and moving objects
cover some."""
CLIP = 4.0
UNTOLD = 0.0, np.inf
"""A figure that a pair does not tell, and its standard deviation."""


@dataclass(frozen=True)
class Tones:
    """Figures of all pairs of pictures of a flight."""

    i: Ints
    """(p,) earlier picture."""
    j: Ints
    figures: Array
    """(p, 7)."""
    std: Array
    """(p, 7)."""
    outward: Array
    """(p,) how much farther from the middle the points lie in i than in j: mean difference of r^2."""
    zoom: Array
    """(p,) logarithm of how much larger the floor is in i than in j: by height, and by lean, as points go
    from the far edge of a picture to the near one."""
    depth: Array
    """(p, 3) logarithm of white over each colour's level: how much a gamma changes it."""
    stained: float
    """Root mean square of the stain that is foretold; a millionth where there is none."""


_WORKED_OUT: WeakKeyDictionary[FeatureMatches, Tones] = WeakKeyDictionary()
"""They are the same under every belief."""


def tones_of(matches: FeatureMatches) -> Tones:
    """The figures of every pair with enough matches; none of a flight whose pictures are lit in bands."""
    if matches not in _WORKED_OUT:
        _WORKED_OUT[matches] = _worked_out(matches)
    return _WORKED_OUT[matches]


def _nothing() -> Tones:
    nothing = np.zeros(0, dtype=np.int64)
    none = np.zeros((0, FIGURES))
    return Tones(
        i=nothing,
        j=nothing,
        figures=none,
        std=none,
        outward=np.zeros(0),
        zoom=np.zeros(0),
        depth=np.zeros((0, 3)),
        stained=0.0,
    )


def _worked_out(matches: FeatureMatches) -> Tones:
    if matches.uneven:
        return _nothing()
    key = matches.earlier * (len(matches.stamps_s) + 1) + matches.later
    order = np.argsort(key, kind="stable")
    bounds = np.flatnonzero(np.diff(key[order], prepend=-1, append=-1))
    stain = lens_shading_map(matches.camera, matches.cells)
    matches = _cleaned(matches, stain)
    rows, pairs, outward, zoom, depth = [], [], [], [], []
    shares = _shares(matches, stain)
    for begin, end in pairwise(bounds.tolist()):
        own = order[begin:end]
        share = shares.get((int(matches.earlier[own[0]]), int(matches.later[own[0]])), UNTOLD)
        found = _figures(matches, own, share)
        if found is not None:
            rows.append(found)
            pairs.append((matches.earlier[own[0]], matches.later[own[0]]))
            outward.append(_outward(matches, own).mean())
            zoom.append(np.log(_extent(matches.pixel_i[own]) / _extent(matches.pixel_j[own])))
            depth.append(_depth(matches, own))
    if not rows:
        return _nothing()
    index = np.array(pairs, dtype=np.int64)
    values, std = (np.array(part) for part in zip(*rows, strict=True))
    if matches.glares:
        std[:, [SHADING, STAIN]] = np.inf
    stained = max(float(np.sqrt(np.mean(stain.predicted_by_others**2))), 1e-6)
    seen = np.array(outward), np.array(zoom), np.array(depth)
    return Tones(index[:, 0], index[:, 1], values, std, *seen, stained)


def _usable(a: Array, b: Array) -> NDArray[np.bool_]:
    both = np.column_stack([a[:, :3], b[:, :3]])
    usable = (both > DARKEST).all(axis=1) & (both < BRIGHTEST).all(axis=1)
    return np.asarray(usable & (a[:, 3] > 1.0) & (b[:, 3] > 1.0))


def _cleaned(matches: FeatureMatches, stain: LensShadingMap) -> FeatureMatches:
    """As if the lens had no stain: what stays in the picture is no restless exposure."""
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
    # Seen through the same part of the lens: what is left is the whole picture's.
    photometric_score = np.exp(-values[SHADING] * away)
    grey_i, local_i = grey_i * photometric_score, a[:, 3] * photometric_score
    like = np.corrcoef(grey_i, grey_j)[0, 1]
    wider = float(np.log(np.std(grey_i) / np.std(grey_j)))
    of_wider = float(np.sqrt(max(1.0 - like**2, 1e-6) / m))
    values[CONTRAST] = wider - values[:3].mean()
    std[CONTRAST] = of_wider + std[:3].mean()
    detail, spread = _middle(np.log(local_i / b[:, 3]))
    values[SHARPNESS], std[SHARPNESS] = detail - wider, np.hypot(1.25 * spread / np.sqrt(m), of_wider)
    values[STAIN], std[STAIN] = share
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
    """Median and robust standard deviation."""
    middle = float(np.median(x))
    return middle, robust_std(x - middle)


def _outward(matches: FeatureMatches, own: Ints) -> Array:
    return radius2(matches.camera, matches.pixel_i[own]) - radius2(matches.camera, matches.pixel_j[own])


def _extent(pixel: Array) -> float:
    """How far points are spread, px."""
    return max(float(np.sqrt(np.var(pixel, axis=0).sum())), 1.0)


def _depth(matches: FeatureMatches, own: Ints) -> Array:
    level = np.median(np.concatenate([matches.tone_i[own, :3], matches.tone_j[own, :3]]), axis=0)
    return np.asarray(np.log(255.0 / np.maximum(level, 1.0)))


@dataclass(frozen=True)
class Weighed:
    """Score and information of one figure's mean shapes, and of a variance of it."""

    information: Array
    score: Array
    log_likelihood: float
    white: Array
    """(p,) figures over their standard deviations, whitened."""


def weigh(
    tones: Tones, figure: int, shapes: Array, ours: Array, nuisances: Array, variance: float, memory: Array,
    slow: Array,
) -> Weighed:  # fmt: skip
    """One figure against shapes of its property.

    ``shapes`` (p, d): change of the figure with each shape; ``ours`` (p,) what the belief holds of it;
    ``nuisances`` (p, q): shapes that healthy cameras have, one standard deviation of each; ``memory`` (n, n)
    correlation of a restless property between pictures, ``variance`` what the belief holds of it. The last
    column is its change; ``slow`` (p, s) are shapes that do not count as restless.
    """
    told = np.isfinite(tones.std[:, figure])
    shapes, nuisances, slow = shapes[told], nuisances[told], slow[told]
    n, p, d = len(memory), int(told.sum()), shapes.shape[1]
    if p == 0:
        return Weighed(np.zeros((d + 1, d + 1)), np.zeros(d + 1), 0.0, np.zeros(0))
    D = np.zeros((p, n))
    D[np.arange(p), tones.i[told]] += 1.0
    D[np.arange(p), tones.j[told]] -= 1.0
    y, std = (tones.figures[:, figure] - ours)[told], tones.std[told, figure]
    std = std * _scale(D, y, std)
    own = np.ones(p) if figure in (SHADING, STAIN) else None
    wander = WANDER[figure] ** 2 * (np.diag(own) if own is not None else D @ D.T)
    restless = D @ memory @ D.T
    V = np.diag(std**2) + wander + variance * restless + nuisances @ nuisances.T
    factor = cho_factor(V, lower=True)
    solved = cho_solve(factor, np.column_stack([shapes, y]))
    information, score = np.zeros((d + 1, d + 1)), np.zeros(d + 1)
    information[:d, :d] = shapes.T @ solved[:, :d]
    score[:d] = shapes.T @ solved[:, d]
    calm = cho_factor(V + 1e2 * slow @ slow.T, lower=True)
    spread, pulled = cho_solve(calm, restless), cho_solve(calm, y)
    information[d, d] = 0.5 * np.sum(spread * spread.T)
    score[d] = 0.5 * (pulled @ restless @ pulled - np.trace(spread))
    log_det = 2.0 * float(np.log(np.diag(factor[0])).sum())
    white = np.linalg.solve(np.tril(factor[0]), y)
    return Weighed(information, score, -0.5 * (float(y @ solved[:, d]) + log_det), white)


def _scale(D: Array, y: Array, std: Array) -> float:
    """How much noisier pairs are than their own matches say, from how pairs of the same pictures disagree."""
    weighted = D / std[:, None]
    solution = np.linalg.lstsq(weighted, y / std, rcond=1e-9)
    free = len(y) - int(solution[2])
    if free < 20:
        return 1.0
    left = y / std - weighted @ solution[0]
    return max(float(np.sqrt(left @ left / free)), 1.0)
