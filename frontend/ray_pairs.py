"""Directions in which a camera of unknown mount sees the same points in two pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.features import Extractor, FeatureConfig, Features
from frontend.matching import match

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_CONFIG = FeatureConfig(kind="sift", max_features=500, max_side_px=640)
"""Pictures are reduced. Points must be exact to a fraction of a pixel, or a turn about the vertical of the
picture looks like a way to the side."""
_THRESHOLD_PX = 3.0
"""Distance from its epipolar line at which a match is wrong, as for a homography (`HomographyConfig`)."""
LEAST_MATCHES = 20
"""Fewer matches are as likely to be chance: a homography and its gates need as many (`frontend.gates`)."""


@dataclass(frozen=True)
class RayPair:
    """Matched points of two pictures of one camera, as directions in camera axes."""

    i_ray: Array
    """(n, 3) with z = 1, in the first picture."""
    j_ray: Array
    """(n, 3) with z = 1, in the second one."""

    def __len__(self) -> int:
        return len(self.i_ray)

    def consistent(self, threshold: float) -> RayPair:
        """Return the matches that one motion of the camera explains within a threshold in rad, whatever the
        scene is.

        Source: Barath et al. 2020 (MAGSAC++), with the five-point algorithm of Nister 2004.
        """
        if len(self) < LEAST_MATCHES:
            return RayPair(self.i_ray[:0], self.j_ray[:0])
        params = cv2.UsacParams()
        params.threshold, params.confidence = threshold, 0.999
        params.maxIterations, params.randomGeneratorState = 1000, 0
        params.score, params.sampler = cv2.SCORE_METHOD_MAGSAC, cv2.SAMPLING_UNIFORM
        params.loMethod, params.loIterations, params.loSampleSize = cv2.LOCAL_OPTIM_SIGMA, 10, 50
        i, j = (np.ascontiguousarray(ray[:, :2]) for ray in (self.i_ray, self.j_ray))
        lens = (np.eye(3), np.eye(3), np.zeros(4), np.zeros(4))
        try:
            _, mask = cv2.findEssentialMat(i, j, *lens, params)
        except cv2.error:
            mask = None
        rows = np.zeros(len(self), dtype=bool) if mask is None else mask.ravel() > 0
        return RayPair(self.i_ray[rows], self.j_ray[rows])

    def spread(self, count: int) -> RayPair:
        """Return so many of the matches, evenly from their order; where there are fewer, some come twice."""
        rows = np.linspace(0, len(self) - 1, count).astype(int)
        return RayPair(self.i_ray[rows], self.j_ray[rows])


def ray_pairs(pictures: Sequence[Image | None], camera: Camera) -> list[tuple[int, RayPair]]:
    """Match the first of some pictures with each later one.

    Return the number of the later picture and the matches; pictures that are None, and pairs with few
    matches, are left out.
    """
    extract = Extractor(_CONFIG)
    seen: list[Features | None] = [None if p is None else extract(p, camera) for p in pictures]
    first, found = seen[0] if seen else None, []
    for k, later in enumerate(seen[1:], start=1):
        if first is None or later is None:
            continue
        rows = match(first, later)
        pair = RayPair(camera.rays(first.pixel[rows[:, 0]]), camera.rays(later.pixel[rows[:, 1]]))
        pair = pair.consistent(_THRESHOLD_PX / min(camera.focal_px))
        if len(pair) >= LEAST_MATCHES:
            found.append((k, pair))
    return found
