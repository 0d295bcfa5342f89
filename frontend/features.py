"""Detection and description of point features behind one interface."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.cores import usable_cores
from frontend.detections import Described
from frontend.feature_kinds import FeatureKind
from frontend.opencv_features import OpenCvFeatures
from frontend.points import Points
from frontend.rectification import rectifier
from frontend.robust import median
from frontend.sift import Sift

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

COARSE_PX = 8.0
"""Diameter at which a feature has twice the position variance of a fine one of the same contrast."""
MOST_PX_AT_ONCE = 9_000_000
"""Pixels of the pictures that are searched at a time. A search takes 109 bytes a pixel at its peak: 1 GB."""
SMALLEST_PX = 16
"""Smallest side of a picture. Smaller pictures give no features, as some pyramids would have empty levels."""


@dataclass(frozen=True)
class FeatureConfig:
    """Kind of the features, their largest number, and the picture size for detection."""

    kind: FeatureKind = "sift"
    max_features: int = 500
    """Number of features kept, strongest first, in a picture up to 500 px wide. `for_width` scales it."""
    max_side_px: int = 1200
    """Larger pictures are reduced to this side before detection. Positions refer to the full size.
    The maps of `tests/benchmarks/caliterra.py` and `isfm.py` are as exact as with 1400, for three quarters of
    the time; with 1000, positions of the second that it does not use are off by 1.4 times as much."""

    def for_width(self, width_px: int) -> FeatureConfig:
        """Return the configuration with the feature limit scaled to the picture width."""
        width = min(width_px, self.max_side_px)
        return replace(self, max_features=int(self.max_features * max(1.0, width / 500)))

    def searched_at_once(self, size_px: tuple[int, int]) -> int:
        """Return how many pictures (width, height) are searched at a time: one on each core, within memory.

        OpenCV splits one picture badly among cores.
        """
        reduction = min(1.0, self.max_side_px / max(size_px))
        searched_px = max(1.0, size_px[0] * size_px[1] * reduction**2)
        return max(1, min(usable_cores(), int(MOST_PX_AT_ONCE / searched_px)))


@dataclass(frozen=True)
class Features:
    """Features of one picture."""

    points: Points
    descriptor: NDArray[Any]
    """(n, d) float32, or uint8 bit strings."""

    def __len__(self) -> int:
        return len(self.points)

    @property
    def pixel(self) -> Array:
        """(n, 2) pixel positions, as in `Points`."""
        return self.points.pixel

    def __getitem__(self, which: NDArray[Any]) -> Features:
        return Features(self.points[which], self.descriptor[which])


class FeatureSearch(Protocol):
    """A detector with its descriptor."""

    @property
    def no_descriptors(self) -> NDArray[Any]:
        """(0, d) descriptors of no point."""

    def __call__(self, grey: Image, mask: Image | None, limit: int) -> Described | None:
        """Return up to ``limit`` points of a grey picture where ``mask`` is not 0; None without any."""


class Extractor:
    """Detector and descriptor of features. One object may serve a whole flight and several threads.

    Raises ``FeatureUnavailableError`` if the OpenCV build lacks the detector.
    """

    def __init__(self, config: FeatureConfig = FeatureConfig()) -> None:
        self.config = config
        self._search: FeatureSearch = Sift() if config.kind == "sift" else OpenCvFeatures(config.kind)

    def __call__(self, image: Image, camera: Camera, mask: Image | None = None) -> Features:
        """Return the features of one picture, (h, w) grey or (h, w, 3) BGR uint8, of the camera's size or
        reduced.

        Pixels where ``mask``, of the camera's size, is 0 are ignored. Raises ``TypeError`` or ``ValueError``
        for any other array.
        """
        check_picture(image)
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
        full = np.array(camera.size_px)
        size = np.rint(full * min(1.0, self.config.max_side_px / full.max())).astype(int)
        if size.min() < SMALLEST_PX:
            return self._no_features()
        if grey.shape[::-1] != tuple(size):
            grey = cv2.resize(grey, size.tolist(), interpolation=cv2.INTER_AREA)
        if mask is not None and mask.shape[::-1] != tuple(size):
            mask = cv2.resize(mask, size.tolist(), interpolation=cv2.INTER_NEAREST)
        scale, first_px = full / size, np.zeros(2)
        if (ideal := rectifier(camera, (int(size[0]), int(size[1])))) is not None:
            grey, mask, first_px = ideal.picture(grey), ideal.mask(mask), ideal.first_px
            size = np.array(grey.shape[::-1])
            if size.min() < SMALLEST_PX:
                return self._no_features()
        found = self._search(np.asarray(grey, dtype=np.uint8), mask, self.config.max_features)
        if found is None:
            return self._no_features()
        # Pixel x of a reduced picture has its centre at full-size pixel (x + 1/2) full / size - 1/2.
        pixel = (found.pixel + first_px + 0.5) * scale - 0.5
        relative_std = _relative_std(self.config.kind, found) * camera.magnification(pixel)
        return Features(Points(pixel, relative_std), _normalise(found.descriptor))

    def _no_features(self) -> Features:
        return Features(Points.alike(np.empty((0, 2))), self._search.no_descriptors)


def check_picture(image: Any) -> None:
    """Raise ``TypeError`` or ``ValueError`` where an object is no 8-bit picture."""
    expected = "picture: expected an array of uint8, (h, w) grey or (h, w, 3) BGR"
    if not isinstance(image, np.ndarray):
        raise TypeError(f"{expected}, got {type(image).__name__}")
    if image.dtype != np.uint8:
        raise TypeError(f"{expected}, got {image.dtype}")
    if image.ndim not in (2, 3) or image.shape[2:] not in ((), (3,)):
        raise ValueError(f"{expected}, got shape {image.shape}")


def _relative_std(kind: FeatureKind, found: Described) -> Array:
    """Return (n,) the standard deviation of each position as a ratio to the median of the picture.

    Noise displaces faint features more. Shading and neighbouring features displace coarse features more. The
    law for SIFT was fitted to rendered pairs (`tests/benchmarks/registration.py`). It is unknown for the
    other kinds, which have the ratio 1.
    """
    if kind != "sift":
        return np.ones(len(found.pixel))
    variance = (1.0 + (found.size_px / COARSE_PX) ** 2) / found.response
    return np.asarray(np.sqrt(variance / median(variance)))


def _normalise(descriptor: NDArray[Any]) -> NDArray[Any]:
    """Return RootSIFT of float descriptors, whose L2 distance is the Hellinger distance.

    Bit strings are returned unchanged. Source: Arandjelovic and Zisserman 2012.
    """
    if descriptor.dtype == np.uint8:
        return descriptor
    root: NDArray[np.float32] = np.abs(descriptor)
    root /= root.sum(axis=1, keepdims=True) + 1e-12
    np.sqrt(root, out=root)
    root *= np.sign(descriptor)
    return root
