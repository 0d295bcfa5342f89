"""Directions in which a camera of unknown mount sees the same points in two pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.features import Extractor, FeatureConfig, Features
from frontend.homography import HomographyConfig
from frontend.matching import match

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_CONFIG = FeatureConfig(kind="sift", max_features=500, max_side_px=320)
"""Pictures are reduced. Points must be exact to a fraction of a pixel, or a turn about the vertical of the
picture looks like a way to the side."""
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

    def consistent(self, threshold_rad: float) -> RayPair:
        """Return the matches that one motion of the camera explains, whatever the scene is."""
        rows = self.essential(threshold_rad)[1]
        return RayPair(self.i_ray[rows], self.j_ray[rows])

    def essential(self, threshold_rad: float) -> tuple[Array | None, NDArray[np.bool_]]:
        """Return the essential matrix (3, 3) of most matches, and which of them (n,) agree; None without one.

        Source: Barath et al. 2020 (MAGSAC++), with the five-point algorithm of Nister 2004.
        """
        nothing = None, np.zeros(len(self), dtype=bool)
        if len(self) < LEAST_MATCHES:
            return nothing
        params = cv2.UsacParams()
        params.threshold, params.confidence = threshold_rad, 0.999
        params.maxIterations, params.randomGeneratorState = 1000, 0
        params.score, params.sampler = cv2.SCORE_METHOD_MAGSAC, cv2.SAMPLING_UNIFORM
        params.loMethod, params.loIterations, params.loSampleSize = cv2.LOCAL_OPTIM_SIGMA, 10, 50
        lens = (np.eye(3), np.eye(3), np.zeros(4), np.zeros(4))
        try:
            found, mask = cv2.findEssentialMat(self.flat[0], self.flat[1], *lens, params)
        except cv2.error:
            return nothing
        if found is None or found.shape != (3, 3) or mask is None:
            return nothing
        return np.asarray(found), mask.ravel() > 0

    @property
    def flat(self) -> tuple[Array, Array]:
        """x and y (n, 2) of the directions in both pictures."""
        return np.ascontiguousarray(self.i_ray[:, :2]), np.ascontiguousarray(self.j_ray[:, :2])

    def spread(self, count: int) -> RayPair:
        """Return so many of the matches, evenly from their order; where there are fewer, some come twice."""
        rows = np.linspace(0, len(self) - 1, count).astype(int)
        return RayPair(self.i_ray[rows], self.j_ray[rows])


def threshold_rad(camera: Camera) -> float:
    """Return how far a match may be from where a motion puts it: as far as from a homography."""
    return HomographyConfig().for_width(camera.size_px[0]).threshold_px / min(camera.focal_px)


def ray_pairs(
    pictures: Sequence[Image | None], camera: Camera, successive: bool = False
) -> list[tuple[int, RayPair]]:
    """Match the first of some pictures with each later one, or each with the next if they are ``successive``.

    Return the number of the later picture and the matches that one motion explains; pictures that are None,
    and pairs with few matches, are left out.
    """
    extract = Extractor(_CONFIG)
    seen: list[Features | None] = [None if p is None else extract(p, camera) for p in pictures]
    found = []
    for k in range(1, len(seen)):
        first, later = seen[k - 1 if successive else 0], seen[k]
        if first is None or later is None:
            continue
        rows = match(first, later)
        pair = RayPair(camera.rays(first.pixel[rows[:, 0]]), camera.rays(later.pixel[rows[:, 1]]))
        pair = pair.consistent(threshold_rad(camera))
        if len(pair) >= LEAST_MATCHES:
            found.append((k, pair))
    return found
