"""Photometric score: evidence of the pictures' tones on the camera's terms and on patterns without a term."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.criticism.camera.feature_matches import FeatureMatches
from slam.criticism.camera.tones import CONTRAST, FIGURES, SHADING, SHARPNESS, Tones, tones_of, weigh
from slam.criticism.kalman.camera_parameters import BLUR, GAIN, GAMMA, VIGNETTING
from slam.criticism.kalman.perturbations import Perturbation
from slam.criticism.kalman.smoothing import SmoothedPath

Array = NDArray[np.float64]

STAINED = "picture brightness ~ place in the picture"
RESTLESS = "picture contrast, restless", "picture sharpness, restless"
"""Variances: pictures differ by it and nothing tells how."""
PICTURE_SHAPES = (
    "picture brightness ~ time", "picture colour ~ time", "picture contrast ~ time",
    "picture sharpness ~ time", "picture brightness ~ height", STAINED, *RESTLESS,
)  # fmt: skip
MEMORY_S = 1.0
"""Time constant of the automatic exposure that exposure_variation models."""
BLUR_DETAIL, BLUR_CONTRAST = 0.02, 0.01
"""Loss of the logarithm of local detail, and of contrast, for each square pixel of a small smear: known to
its own size, as floors have it."""
LARGE_SMEAR_PX2 = 2.0
"""Smear above which each further smear removes less of the remaining detail."""
BORDER = 0.35
"""r^2 in half diagonals where a picture's matches lie, in the mean."""
SHADING_TOLERANCE, STAIN_TOLERANCE = 0.01, 0.005
"""Tolerated shading of a healthy lens: darkness of the corners, and root mean square of the shading map."""
OUTWARD_TOLERANCE = 0.02
"""Brightness that corners may lack: what lies farther out in one of two pictures tells nothing by that."""
HEALTHY_STD = {CONTRAST: 0.02, SHARPNESS: 0.08}
"""Standard deviation of the logarithm from place to place: floors differ in detail, at each height."""
LAMPS_STD = 0.01
"""Standard deviation of the logarithm of brightness where the floor mirrors lamps, which light the points
too."""
SLOW_SHARPNESS = 0.3
"""Change of the logarithm of local detail over a flight that a floor's other places may make."""
TOLERANCE = {0: 0.03, 1: 0.03, 2: 0.03, CONTRAST: 0.2, SHARPNESS: 0.6}
"""Change of the logarithm for each of the height's, or of how large the floor is in the picture: on floors of
two generators -0.2 in contrast and up to 0.9 in detail."""


@dataclass(frozen=True)
class PhotometricScore:
    """Score and information of some directions."""

    information: Array
    score: Array
    log_likelihood: float


def photometric_score(
    matches: FeatureMatches,
    camera: Array,
    path: SmoothedPath,
    inside: NDArray[np.bool_],
    directions: Sequence[Perturbation],
) -> PhotometricScore:
    """Score and information of the directions that tones can tell of; 0 for all others."""
    total = _Total(directions)
    tones = _within(tones_of(matches), inside)
    if len(tones.i) < 2:
        return total.shades()
    times, height = path.times_s, np.log(np.maximum(path.poses[:, 2], 0.05))
    speed2 = _speed2(matches, path)
    elapsed = path.elapsed
    memory = np.exp(-np.abs(times[:, None] - times) / MEMORY_S)

    def between(x: Array) -> Array:
        return np.asarray(x[tones.i] - x[tones.j])

    for figure in range(FIGURES):
        shapes: dict[tuple[str, int], Array] = {}
        ours, slow = np.zeros(len(tones.i)), np.column_stack([between(elapsed), between(elapsed**2)])
        nearer = -tones.zoom if figure in (CONTRAST, SHARPNESS) else between(height)
        healthy = TOLERANCE.get(figure, 0.0) * nearer[:, None]
        restless: dict[tuple[str, int], float] = {}
        held = HEALTHY_STD.get(figure, 0.0) ** 2
        if figure < CONTRAST and matches.glares:
            held += LAMPS_STD**2
        if figure < CONTRAST:
            shapes["picture", 0] = between(elapsed)
            shapes["picture", 1] = (figure - 1) * between(elapsed)
            shapes["picture", 4] = between(height)
            # Between black and white a gamma makes brighter or darker as a gain does.
            depth2 = float(np.mean(tones.depth[:, figure]) ** 2)
            restless = {("camera", GAIN): 1.0, ("camera", GAMMA): depth2}
            darker = 1.0 - BORDER * camera[VIGNETTING]
            ours = -camera[VIGNETTING] / darker * tones.outward
            healthy = np.column_stack([healthy, OUTWARD_TOLERANCE * tones.outward])
        elif figure == CONTRAST:
            shapes["picture", 2] = between(elapsed)
            shapes["camera", BLUR], ours = _blurred(BLUR_CONTRAST, between, speed2, camera[BLUR])
            healthy = np.column_stack([healthy, ours])
            restless = {("camera", GAMMA): 1.0, ("picture", PICTURE_SHAPES.index(RESTLESS[0])): 1.0}
            # An exposure that seeks its level may bend the tone curve as it goes.
            held += camera[GAIN]
        elif figure == SHARPNESS:
            shapes["picture", 3] = between(elapsed)
            restless = {("picture", PICTURE_SHAPES.index(RESTLESS[1])): 1.0}
            shapes["camera", BLUR], ours = _blurred(BLUR_DETAIL, between, speed2, camera[BLUR])
            healthy = np.column_stack([healthy, SLOW_SHARPNESS * slow, ours])
        elif figure == SHADING:
            healthy = np.full((len(tones.i), 1), SHADING_TOLERANCE)
            darker = 1.0 - BORDER * camera[VIGNETTING]
            shapes["camera", VIGNETTING] = np.full(len(tones.i), -1.0 / darker**2)
            ours = np.full(len(tones.i), -camera[VIGNETTING] / darker)
        else:
            healthy = np.full((len(tones.i), 1), STAIN_TOLERANCE / tones.stained)
            shapes["picture", PICTURE_SHAPES.index(STAINED)] = np.ones(len(tones.i))
        table = np.column_stack(list(shapes.values()))
        held += sum(share * camera[entry] for (kind, entry), share in restless.items() if kind == "camera")
        found = weigh(tones, figure, table, ours, healthy, held, memory, slow)
        parts = _variance_shares(len(shapes), list(restless.values()))
        keys = [*shapes, *restless]
        total.add(keys, parts.T @ found.information @ parts, found.score @ parts, found.log_likelihood)
    return total.shades()


def _variance_shares(patterns: int, shares: list[float]) -> Array:
    """Map all entries to the columns of a fit: the patterns, and one variance that several entries share."""
    parts = np.zeros((patterns + 1, patterns + len(shares)))
    parts[:patterns, :patterns] = np.eye(patterns)
    parts[-1, patterns:] = shares
    return parts


def _blurred(
    loss: float, between: Callable[[Array], Array], speed2: Array, exposure2: float
) -> tuple[Array, Array]:
    """Change of a figure with the square of the exposure, and what it already has of it."""
    smear = speed2 * exposure2 / LARGE_SMEAR_PX2
    own = -loss * LARGE_SMEAR_PX2 * np.log1p(smear)
    return between(-loss * speed2 / (1.0 + smear)), between(own)


class _Total:
    """Sums over the figures."""

    def __init__(self, directions: Sequence[Perturbation]) -> None:
        self._place: dict[tuple[str, int], int] = {(d.kind, d.entry): k for k, d in enumerate(directions)}
        self._information = np.zeros((len(directions), len(directions)))
        self._score, self._nats = np.zeros(len(directions)), 0.0

    def add(self, keys: Sequence[tuple[str, int]], information: Array, score: Array, nats: float) -> None:
        own = [k for k, key in enumerate(keys) if key in self._place]
        at = [self._place[keys[k]] for k in own]
        self._information[np.ix_(at, at)] += information[np.ix_(own, own)]
        self._score[at] += score[own]
        self._nats += nats

    def shades(self) -> PhotometricScore:
        return PhotometricScore(self._information, self._score, self._nats)


def _within(tones: Tones, inside: NDArray[np.bool_]) -> Tones:
    kept = inside[tones.i] & inside[tones.j]
    place = np.cumsum(inside) - 1
    return Tones(
        i=place[tones.i[kept]], j=place[tones.j[kept]], figures=tones.figures[kept], std=tones.std[kept],
        outward=tones.outward[kept], zoom=tones.zoom[kept], depth=tones.depth[kept], stained=tones.stained,
    )  # fmt: skip


def _speed2(matches: FeatureMatches, path: SmoothedPath) -> Array:
    """(n,) mean square speed of points over the picture in px/s."""
    focal = float(np.mean(matches.camera.focal_px))
    height, yaw = np.maximum(path.poses[:, 2], 0.05), path.poses[:, 5]
    c, s = np.cos(yaw), np.sin(yaw)
    ahead = (c * path.rates[:, 0] + s * path.rates[:, 1]) / height - path.rates[:, 4]
    left = (c * path.rates[:, 1] - s * path.rates[:, 0]) / height + path.rates[:, 3]
    half2 = (np.hypot(*matches.camera.size_px) / 2) ** 2 * BORDER
    return np.asarray(focal**2 * (ahead**2 + left**2) + half2 * path.rates[:, 5] ** 2)
