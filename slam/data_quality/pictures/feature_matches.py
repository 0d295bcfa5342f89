"""Feature matches between a flight's pictures: the same points of the floor in two pictures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.cores import in_threads
from frontend.features import Extractor, FeatureConfig, Features
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig, transfer
from frontend.registration import Registration, register
from slam.core.flight import Flight
from slam.core.progress import Progress, Tally, silent
from slam.core.streams import Frame
from slam.data_quality.lost_pictures import missing
from slam.data_quality.pictures.cells import CELL_STEPS, MOST_PAIRS, Cells, compared
from slam.data_quality.pictures.cross_check import confirmed
from slam.data_quality.pictures.flicker import LEAST_FLICKER, flicker_of
from slam.data_quality.pictures.highlights import are_lamps, dimmed, spots
from slam.data_quality.pictures.lens_distortion_map import LensDistortionMap, PairMatches, lens_distortion_map
from slam.data_quality.pictures.moving_objects import has_moving_object
from slam.data_quality.pictures.overlaid import Image, overlaid, reduced

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SHORTEST_S = 0.2
"""Least interval between pictures: between nearer ones the motion is too small."""
WORKERS = 2
STEPS = (1, 2, 4, 8)
"""Each picture is matched with the pictures this many before it."""
FEATURES = FeatureConfig(max_features=300)
MATCHES = 24
"""Number of matches of a pair, evenly spaced; more add nothing about the path between two pictures."""
BEYOND = 3.5
"""Matches farther from the pair's homography than this many standard deviations are rejected."""
PATCH = (7, 7)
"""Size in px of the window around a point for its local contrast."""
LEAST_PX = 0.08
"""Least standard deviation of a feature's position in px."""


_Shot = tuple[float, Features, Array]
"""Stamp of a picture, its features and their tones."""


@dataclass(frozen=True, eq=False)
class FeatureMatches:
    """Points of the floor that two pictures of a flight share, with the results computed from them."""

    camera: Camera
    stamps_s: Array
    """(n,) stamps of the pictures that were matched."""
    earlier: Ints
    """(m,) index of picture i of each match."""
    later: Ints
    """(m,) index of picture j of each match."""
    pixel_i: Array
    """(m, 2) undistorted pixels in picture i."""
    pixel_j: Array
    std_px: Array
    """(m,) standard deviation of one coordinate of pixel_i minus its prediction from pixel_j."""
    tone_i: Array
    """(m, 4) mean level around the point in blue, green and red, and standard deviation of the grey levels.
    """
    tone_j: Array
    missing: int
    """Number of pictures missing from the regular stamps."""
    taken: int
    """Number of all pictures, matched or not."""
    lens_distortion: LensDistortionMap
    """Local distortions of the lens."""
    cells: Cells
    """Brightness ratios of overlaid pictures."""
    flicker: float = 0.0
    """Change of brightness along rows or columns in most pairs of pictures (see ``flicker``)."""
    moving_s: Array = field(default_factory=lambda: np.zeros(0))
    """(k,) stamps of pictures in which an object has moved over the floor since the picture before."""
    spots: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(k, 3) for each pair of pictures with bright spots that do not move with the floor: number that lag
    behind it, number of the others, and strength of the lagging ones."""

    def some(self, kept: NDArray[np.bool_]) -> FeatureMatches:
        """Return a copy with only the matches of the mask (m,)."""
        of_matches = ("earlier", "later", "pixel_i", "pixel_j", "std_px", "tone_i", "tone_j")
        return replace(self, **{name: getattr(self, name)[kept] for name in of_matches})

    @property
    def uneven(self) -> bool:
        """Whether the light changes within the pictures, so that neither brightness nor moving objects are
        evidence."""
        return self.flicker >= LEAST_FLICKER

    @property
    def glares(self) -> bool:
        """Whether the floor mirrors lamps, whose light would pass for lens shading."""
        return are_lamps(self.spots) and not self.lens_distortion.notable


def match_all_pictures(flights: Sequence[Flight], progress: Progress = silent) -> list[FeatureMatches | None]:
    """Match the pictures of several flights, two flights at a time."""
    pictures = Tally(progress, "pictures", sum(len(f.frames) for f in flights if f.frames is not None))
    pairs = Tally(progress, "pairs of pictures")
    before = cv2.getNumThreads()
    # The pictures are small, so threads within one of them would only wait for each other.
    cv2.setNumThreads(1)
    try:
        return in_threads(lambda flight: _looked_at(flight, pictures, pairs), flights, WORKERS)
    finally:
        cv2.setNumThreads(before)


def _shots_of(frames: Iterable[Frame], camera: Camera) -> tuple[list[_Shot], list[Image], list[Image]]:
    """Return the readable pictures, at most one each `SHORTEST_S`, and their dimmed and reduced images."""
    extract = Extractor(FEATURES.for_width(camera.size_px[0]))
    shots: list[_Shot] = []
    dims: list[Image] = []
    greys: list[Image] = []
    for frame in frames:
        if shots and frame.stamp_s - shots[-1][0] < SHORTEST_S:
            continue
        image = frame.read()
        if image is None or image.shape[1::-1] != camera.size_px:
            continue
        points = extract(image, camera)
        dims.append(dimmed(image))
        greys.append(reduced(image))
        shots.append((frame.stamp_s, points, _tones(image, camera.project(camera.rays(points.pixel)))))
    return shots, dims, greys


def _looked_at(flight: Flight, pictures: Tally, pairs: Tally) -> FeatureMatches | None:
    camera, frames = flight.camera, flight.frames
    if camera is None or frames is None or len(frames) < 2:
        return None
    shots, dims, greys = _shots_of(pictures.each(frames), camera)
    robust = HomographyConfig().for_width(camera.size_px[0])
    near = [(j - step, j) for j in range(len(shots)) for step in STEPS if j >= step]
    registered = {
        (i, j): pair for i, j in pairs.each(near)
        if (pair := register(i, j, shots[i][1], shots[j][1], camera, robust, GateConfig())).ok
    }  # fmt: skip
    kept = confirmed({key: pair.i_H_j for key, pair in registered.items()}, camera)
    if not kept:
        return None
    registered = {key: registered[key] for key in sorted(kept)}
    i_H_j = {key: pair.i_H_j for key, pair in registered.items()}
    found: list[tuple[Array, ...]] = []
    for k, ((i, j), pair) in enumerate(registered.items()):
        good, std = _chosen(pair, shots[i][1].pixel, shots[j][1].pixel)
        index = np.tile([[k, i, j]], (len(good), 1))
        found.append((index, std, *_picked(pair, good, shots[i], shots[j])))
    index, std, a, b, tone_a, tone_b = (np.concatenate(part) for part in zip(*found, strict=True))
    pair_of, earlier, later = index.T
    matches = PairMatches(
        pair=pair_of,
        earlier=earlier,
        later=later,
        pixel_i=a,
        pixel_j=b,
        std_px=std,
        i_H_j=np.stack(list(i_H_j.values())),
    )
    lens_distortion = lens_distortion_map(camera, len(shots), matches)
    stamps_s = np.array([shot[0] for shot in shots])
    moving, cells = _laid_over(greys, i_H_j, camera)
    seen = [spots(dims[i], dims[j], a_H_b, camera) for (i, j), a_H_b in i_H_j.items()]
    bright = [(s.lagging, s.others, s.strength) for s in seen if s.lagging or s.others]
    return FeatureMatches(
        camera=camera,
        stamps_s=stamps_s,
        earlier=earlier,
        later=later,
        pixel_i=a,
        pixel_j=b,
        std_px=std,
        tone_i=tone_a,
        tone_j=tone_b,
        missing=missing(frames.stamps_s),
        taken=len(frames),
        lens_distortion=lens_distortion,
        cells=cells,
        flicker=flicker_of(camera, cells),
        moving_s=stamps_s[moving],
        spots=np.array(bright).reshape(-1, 3),
    )


def _laid_over(
    greys: Sequence[Image], i_H_j: Mapping[tuple[int, int], Array], camera: Camera
) -> tuple[Ints, Cells]:
    """Results for pairs of pictures: matches, cells, spots and pictures with moving objects."""
    apart = [(i, j) for i, j in i_H_j if j - i in CELL_STEPS]
    chosen = set(apart[:: max(-(-len(apart) // MOST_PAIRS), 1)])
    moving, cells = [], []
    for i, j in apart:
        laid = overlaid(greys[i], greys[j], i_H_j[i, j], camera)
        if j == i + 1 and has_moving_object(greys[i], laid, camera):
            moving.append(j)
        if (i, j) in chosen:
            cells.append((i, j, compared(greys[i], laid)))
    return np.array(moving, dtype=np.int64), Cells.of(cells)


def _chosen(pair: Registration, pixel_i: Array, pixel_j: Array) -> tuple[Ints, Array]:
    """Return some of a pair's inliers of its homography, and their noise in px."""
    a, b = pixel_i[pair.matches[:, 0]], pixel_j[pair.matches[:, 1]]
    std = max(pair.noise_px, LEAST_PX) * np.sqrt(1.0 + _stretch(pair.i_H_j, b))
    good = np.flatnonzero(np.linalg.norm(a - transfer(pair.i_H_j, b), axis=1) < BEYOND * std)
    good = good[np.linspace(0, len(good) - 1, min(MATCHES, len(good))).astype(np.int64)]
    return good, std[good]


def _picked(pair: Registration, good: Ints, a: _Shot, b: _Shot) -> tuple[Array, Array, Array, Array]:
    """Return the pixels in i and j and the tones in i and j of some matches."""
    of_i, of_j = pair.matches[good, 0], pair.matches[good, 1]
    return a[1].pixel[of_i], b[1].pixel[of_j], a[2][of_i], b[2][of_j]


def _tones(image: Image, pixel: Array) -> Array:
    """Return (n, 4) levels of three colours around points, and the local standard deviation of grey."""
    colour = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image
    mean = cv2.blur(colour, (3, 3)).astype(np.float64)
    grey = cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY).astype(np.float64)
    variance = cv2.blur(grey**2, PATCH) - cv2.blur(grey, PATCH) ** 2
    x = np.clip(np.rint(pixel[:, 0]), 0, grey.shape[1] - 1).astype(np.int64)
    y = np.clip(np.rint(pixel[:, 1]), 0, grey.shape[0] - 1).astype(np.int64)
    return np.column_stack([mean[y, x], np.sqrt(np.maximum(variance[y, x], 0.0))])


def _stretch(i_H_j: Array, pixel: Array) -> Array:
    """Return (n,) the mean squared size in i of a pixel of j."""
    ahead, beside = transfer(i_H_j, pixel + [0.5, 0.0]), transfer(i_H_j, pixel + [0.0, 0.5])
    before, behind = transfer(i_H_j, pixel - [0.5, 0.0]), transfer(i_H_j, pixel - [0.0, 0.5])
    return np.asarray(0.5 * (((ahead - before) ** 2).sum(axis=1) + ((beside - behind) ** 2).sum(axis=1)))
