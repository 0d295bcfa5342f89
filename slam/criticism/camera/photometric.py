"""Photometric score: evidence of the pictures' tones for camera terms and for patterns without a term."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from slam.core.arrays import Array
from slam.criticism.camera.camera_path import CameraPath
from slam.criticism.kalman.filter_parameters import BLUR, GAIN, GAMMA, VIGNETTING
from slam.criticism.kalman.kernel_inputs import LikelihoodScore, Perturbation
from slam.data_quality.pictures.feature_matches import FeatureMatches
from slam.data_quality.pictures.tones import CONTRAST, SHADING, SHADING_MAP, SHARPNESS, Tones, tones_of

Entry = tuple[str, int]
"""Kind and entry of a perturbation."""
SHADING_PATTERN = "picture brightness ~ place in the picture"
VARIANCE_PATTERNS = "picture contrast, variances", "picture sharpness, variances"
"""Patterns that are variances: random differences between pictures."""
PICTURE_PATTERNS = (
    "picture brightness ~ time", "picture colour ~ time", "picture contrast ~ time",
    "picture sharpness ~ time", "picture brightness ~ height", SHADING_PATTERN, *VARIANCE_PATTERNS,
)  # fmt: skip
MEMORY_S = 1.0
"""Time constant of the automatic exposure that exposure_variation models."""
BLUR_DETAIL, BLUR_CONTRAST = 0.02, 0.01
"""Loss of the logarithm of local detail, and of contrast, for each square pixel of a small smear. Floors
differ, so it is known only to its own size."""
LARGE_SMEAR_PX2 = 2.0
"""Smear above which each further smear removes less of the remaining detail."""
BORDER = 0.35
"""Mean squared distance of a picture's matches from its centre, in squared half diagonals."""
SHADING_TOLERANCE, SHADING_MAP_TOLERANCE = 0.01, 0.005
"""Tolerated shading of a healthy lens: darkness of the corners, and root mean square of the shading map."""
OUTWARD_TOLERANCE = 0.02
"""Tolerated loss of brightness towards the corners, for points nearer them in one of two pictures."""
HEALTHY_STD = {CONTRAST: 0.02, SHARPNESS: 0.08}
"""Standard deviation of the logarithm between places of a healthy floor, whose detail varies."""
LAMPS_STD = 0.01
"""Standard deviation of the logarithm of brightness on floors that mirror lamps."""
SLOW_SHARPNESS = 0.3
"""Tolerated slow change of the logarithm of local detail over a flight, as the floor changes."""
TOLERANCE = {0: 0.03, 1: 0.03, 2: 0.03, CONTRAST: 0.2, SHARPNESS: 0.6}
"""Tolerated change of the logarithm for each unit of the logarithm of height, or of the floor's scale in the
picture. On the floors of two generators it is -0.2 in contrast and up to 0.9 in detail."""
WANDER = np.array([0.006, 0.006, 0.006, 0.004, 0.03, 0.003, 0.003])
"""Healthy standard deviation of a picture's properties: other floor points show, and objects move."""


def photometric_score(
    matches: FeatureMatches, camera: Array, along: CameraPath, directions: Sequence[Perturbation]
) -> LikelihoodScore:
    """Return score and information of the perturbations, 0 for those that tones cannot show."""
    total, path = LikelihoodScore.nothing(len(directions)), along
    every = tones_of(matches)
    tones = every.some(along.holds(every.i, every.j))
    tones = replace(tones, i=along.index(tones.i), j=along.index(tones.j))
    if len(tones.i) < 2:
        return total
    times, height = path.times_s, np.log(np.maximum(path.poses[:, 2], 0.05))
    speed2, elapsed = _speed2(matches, path), path.elapsed
    darker = 1.0 - BORDER * camera[VIGNETTING]
    memory = np.exp(-np.abs(times[:, None] - times) / MEMORY_S)

    def between(x: Array) -> Array:
        return np.asarray(x[tones.i] - x[tones.j])

    for figure in range(tones.figures.shape[1]):
        patterns: dict[Entry, Array] = {}
        predicted, slow = np.zeros(len(tones.i)), np.column_stack([between(elapsed), between(elapsed**2)])
        nearer = -tones.zoom if figure in (CONTRAST, SHARPNESS) else between(height)
        healthy = TOLERANCE.get(figure, 0.0) * nearer[:, None]
        variances: dict[Entry, float] = {}
        variance = HEALTHY_STD.get(figure, 0.0) ** 2
        if figure < CONTRAST:
            variance += LAMPS_STD**2 * matches.glares
            patterns["picture", 0] = between(elapsed)
            patterns["picture", 1] = (figure - 1) * between(elapsed)
            patterns["picture", 4] = between(height)
            # On levels between black and white a gamma acts like a gain.
            depth2 = float(np.mean(tones.depth[:, figure]) ** 2)
            variances = {("camera", GAIN): 1.0, ("camera", GAMMA): depth2}
            predicted = -camera[VIGNETTING] / darker * tones.outward
            healthy = np.column_stack([healthy, OUTWARD_TOLERANCE * tones.outward])
        elif figure == CONTRAST:
            patterns["picture", 2] = between(elapsed)
            patterns["camera", BLUR], predicted = _blurred(BLUR_CONTRAST, between, speed2, camera[BLUR])
            healthy = np.column_stack([healthy, predicted])
            contrast = PICTURE_PATTERNS.index(VARIANCE_PATTERNS[0])
            variances = {("camera", GAMMA): 1.0, ("picture", contrast): 1.0}
            # Automatic exposure may change the tone curve too.
            variance += camera[GAIN]
        elif figure == SHARPNESS:
            patterns["picture", 3] = between(elapsed)
            variances = {("picture", PICTURE_PATTERNS.index(VARIANCE_PATTERNS[1])): 1.0}
            patterns["camera", BLUR], predicted = _blurred(BLUR_DETAIL, between, speed2, camera[BLUR])
            healthy = np.column_stack([healthy, SLOW_SHARPNESS * slow, predicted])
        elif figure == SHADING:
            healthy = np.full((len(tones.i), 1), SHADING_TOLERANCE)
            patterns["camera", VIGNETTING] = np.full(len(tones.i), -1.0 / darker**2)
            predicted = np.full(len(tones.i), -camera[VIGNETTING] / darker)
        else:
            healthy = np.full((len(tones.i), 1), SHADING_MAP_TOLERANCE / tones.shading_map_rms)
            patterns["picture", PICTURE_PATTERNS.index(SHADING_PATTERN)] = np.ones(len(tones.i))
        table = np.column_stack(list(patterns.values()))
        variance += sum(share * camera[n] for (kind, n), share in variances.items() if kind == "camera")
        found = _weigh(tones, figure, table, predicted, healthy, variance, memory, slow)
        total += found.by(_columns(directions, patterns, variances))
    return total


def _columns(
    directions: Sequence[Perturbation], patterns: Iterable[Entry], variances: Mapping[Entry, float]
) -> Array:
    """Return (patterns + 1, directions) from directions to the columns of a fit: patterns, one variance."""
    own = [(direction.kind, direction.entry) for direction in directions]
    shares = [[float(entry == pattern) for entry in own] for pattern in patterns]
    return np.array([*shares, [variances.get(entry, 0.0) for entry in own]])


def _blurred(
    loss: float, between: Callable[[Array], Array], speed2: Array, exposure2: float
) -> tuple[Array, Array]:
    """Return the derivative of a figure in the squared exposure time, and its value at the present one."""
    smear = speed2 * exposure2 / LARGE_SMEAR_PX2
    own = -loss * LARGE_SMEAR_PX2 * np.log1p(smear)
    return between(-loss * speed2 / (1.0 + smear)), between(own)


def _speed2(matches: FeatureMatches, path: CameraPath) -> Array:
    """Return (n,) the mean square speed of points over the picture in (px/s)^2."""
    focal = float(np.mean(matches.camera.focal_px))
    height, yaw = np.maximum(path.poses[:, 2], 0.05), path.poses[:, 5]
    c, s = np.cos(yaw), np.sin(yaw)
    ahead = (c * path.rates[:, 0] + s * path.rates[:, 1]) / height - path.rates[:, 4]
    left = (c * path.rates[:, 1] - s * path.rates[:, 0]) / height + path.rates[:, 3]
    half2 = (np.hypot(*matches.camera.size_px) / 2) ** 2 * BORDER
    return np.asarray(focal**2 * (ahead**2 + left**2) + half2 * path.rates[:, 5] ** 2)


def _weigh(
    tones: Tones, figure: int, patterns: Array, predicted: Array, nuisances: Array, variance: float,
    memory: Array, slow: Array,
) -> LikelihoodScore:  # fmt: skip
    """Return score and information of patterns in one figure, and of a random property of the n pictures.

    ``patterns`` (p, d) are derivatives of the figure, and ``predicted`` (p,) is its value under the present
    parameters. ``nuisances`` (p, q) are patterns of healthy cameras, each of one standard deviation. The
    random property has the correlation ``memory`` (n, n) between pictures and the present ``variance``, whose
    score is the last entry. ``slow`` (p, s) are patterns that do not count as random.
    """
    measured = np.isfinite(tones.std[:, figure])
    patterns, nuisances, slow = patterns[measured], nuisances[measured], slow[measured]
    n, p, d = len(memory), int(measured.sum()), patterns.shape[1]
    if p == 0:
        return LikelihoodScore.nothing(d + 1)
    D = np.zeros((p, n))
    D[np.arange(p), tones.i[measured]] += 1.0
    D[np.arange(p), tones.j[measured]] -= 1.0
    y, std = (tones.figures[:, figure] - predicted)[measured], tones.std[measured, figure]
    std = std * _scale(D, y, std)
    own = np.ones(p) if figure in (SHADING, SHADING_MAP) else None
    wander = WANDER[figure] ** 2 * (np.diag(own) if own is not None else D @ D.T)
    random = D @ memory @ D.T
    V = np.diag(std**2) + wander + variance * random + nuisances @ nuisances.T
    factor = cho_factor(V, lower=True)
    solved = cho_solve(factor, np.column_stack([patterns, y]))
    information, score = np.zeros((d + 1, d + 1)), np.zeros(d + 1)
    information[:d, :d] = patterns.T @ solved[:, :d]
    score[:d] = patterns.T @ solved[:, d]
    calm = cho_factor(V + 1e2 * slow @ slow.T, lower=True)
    spread, pulled = cho_solve(calm, random), cho_solve(calm, y)
    information[d, d] = 0.5 * np.sum(spread * spread.T)
    score[d] = 0.5 * (pulled @ random @ pulled - np.trace(spread))
    log_det = 2.0 * float(np.log(np.diag(factor[0])).sum())
    return LikelihoodScore(information, score, -0.5 * (float(y @ solved[:, d]) + log_det))


def _scale(D: Array, y: Array, std: Array) -> float:
    """Return the ratio, at least 1, of the scatter of pairs of the same pictures to their own noise."""
    weighted = D / std[:, None]
    solution = np.linalg.lstsq(weighted, y / std, rcond=1e-9)
    free = len(y) - int(solution[2])
    if free < 20:
        return 1.0
    left = y / std - weighted @ solution[0]
    return max(float(np.sqrt(left @ left / free)), 1.0)
