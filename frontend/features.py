"""Point features behind one interface: where they are, and what they look like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
FeatureKind = Literal["sift", "orb", "orb-teblid", "akaze", "surf"]

ORB_SCALE = 1.2
"""From one level of ORB's pyramid to the next."""
SMALLEST_PX = 16
"""Narrower pictures have no features: some pyramids would have empty levels."""


class FeatureUnavailableError(ValueError):
    """The OpenCV build at hand does not hold the detector that was asked for."""


@dataclass(frozen=True)
class FeatureConfig:
    """Which features, how many, and on how large a picture."""

    kind: FeatureKind = "sift"
    max_features: int = 500
    """The strongest are kept. For pictures of up to 500 px; in wider ones the number grows with the width."""
    max_side_px: int = 1400
    """Larger pictures are reduced to this before detection; positions are given at full size."""

    def for_width(self, width_px: int) -> FeatureConfig:
        """The same for pictures of a given width."""
        width = min(width_px, self.max_side_px)
        return replace(self, max_features=int(self.max_features * max(1.0, width / 500)))


@dataclass(frozen=True)
class Features:
    """Features of one picture."""

    pixel: Array
    """(n, 2) undistorted pixel positions at full size."""
    descriptor: NDArray[Any]
    """(n, d) float32, or uint8 bit strings."""

    def __len__(self) -> int:
        return len(self.pixel)


class Extractor:
    """Detects and describes features; one object serves a whole flight.

    Raises ``FeatureUnavailableError`` where the OpenCV build lacks the detector.
    """

    def __init__(self, config: FeatureConfig = FeatureConfig()) -> None:
        self.config = config
        self._detector, self._descriptor = _create(config)

    def __call__(self, image: Image, camera: Camera, mask: Image | None = None) -> Features:
        """Features of one picture, (h, w) grey or (h, w, 3) BGR uint8; ``mask`` is 0 where to look away."""
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
        full = np.array(grey.shape[::-1])
        size = np.rint(full * min(1.0, self.config.max_side_px / full.max())).astype(int)
        if size.min() < SMALLEST_PX:
            return self._nothing()
        if (size < full).any():
            grey = cv2.resize(grey, size.tolist(), interpolation=cv2.INTER_AREA)
            if mask is not None:
                mask = cv2.resize(mask, size.tolist(), interpolation=cv2.INTER_NEAREST)
        if self._descriptor is None:
            points, descriptor = self._detector.detectAndCompute(grey, mask)
        else:
            points, descriptor = self._descriptor.compute(grey, self._detector.detect(grey, mask))
        if descriptor is None or len(points) == 0:
            return self._nothing()
        descriptor = descriptor.reshape(len(points), -1)
        if len(points) > self.config.max_features:  # detectors treat their own limit loosely
            response = np.fromiter((p.response for p in points), float, len(points))
            best = np.argsort(-response, kind="stable")[: self.config.max_features]
            points, descriptor = [points[k] for k in best], descriptor[best]
        pixel = _positions(self.config.kind, points, size)
        # A reduced picture's pixel x covers full-size pixels around (x + 1/2) full / size - 1/2.
        pixel = (pixel + 0.5) * full / size - 0.5
        return Features(camera.undistort(pixel), _normalise(descriptor))

    def _nothing(self) -> Features:
        width = (self._descriptor or self._detector).descriptorSize()
        return Features(np.empty((0, 2)), np.empty((0, width), self._dtype))

    @property
    def _dtype(self) -> type:
        return np.float32 if self.config.kind in ("sift", "surf") else np.uint8


def _create(config: FeatureConfig) -> tuple[Any, Any]:
    """Detector, and descriptor where it is another object."""
    api: Any = cv2  # the stubs lack several creators
    n = config.max_features
    if config.kind == "sift":
        # Low contrast threshold: dark floors; precise upscale: without it positions are biased by 1/4 px.
        return api.SIFT_create(
            nfeatures=n, contrastThreshold=0.01, edgeThreshold=12, enable_precise_upscale=True
        ), None
    if config.kind == "orb":
        return api.ORB_create(nfeatures=n, scaleFactor=ORB_SCALE, fastThreshold=5), None
    if config.kind == "orb-teblid":
        orb = api.ORB_create(nfeatures=n, scaleFactor=ORB_SCALE, fastThreshold=5)
        return orb, api.xfeatures2d.TEBLID_create(1.0)
    if config.kind == "akaze":
        return api.xfeatures2d.AKAZE_create(threshold=2e-4), None
    if config.kind == "surf":
        try:
            return api.xfeatures2d.SURF_create(hessianThreshold=100), None
        except (AttributeError, cv2.error) as error:
            raise FeatureUnavailableError(
                "features 'surf': this OpenCV build leaves SURF out (it was patented); use --features sift, "
                "or install an OpenCV built with OPENCV_ENABLE_NONFREE"
            ) from error
    raise FeatureUnavailableError(
        f"features {config.kind!r}: unknown; choose sift, orb, orb-teblid, akaze or surf"
    )


def _positions(kind: FeatureKind, points: Sequence[cv2.KeyPoint], size_px: NDArray[np.int64]) -> Array:
    """(n, 2) positions in a picture of size (w, h), corrected for how OpenCV leaves its pyramids.

    A level's size is a whole number of pixels, so its true scale is w / w_level, and pixel centres, not
    corners, lie on each other. OpenCV multiplies by the nominal scale instead: ORB was off by 0.35 px on
    average and up to 2 px, AKAZE by 0.5 px an octave on pictures of odd size; SIFT is right.
    """
    pixel = np.asarray(cv2.KeyPoint.convert(points), dtype=float).reshape(-1, 2)
    level = np.array([p.octave for p in points])[:, None]
    if kind in ("orb", "orb-teblid"):
        nominal = np.float32(ORB_SCALE) ** level
        return (pixel / nominal + 0.5) * size_px / np.rint(size_px / nominal) - 0.5
    if kind == "akaze":
        return (pixel + 0.5) * size_px / (size_px // 2**level * 2**level) - 0.5
    return pixel


def _normalise(descriptor: NDArray[Any]) -> NDArray[Any]:
    """RootSIFT for float descriptors (Arandjelovic and Zisserman 2012): Hellinger distance by L2."""
    if descriptor.dtype == np.uint8:
        return descriptor
    absolute = np.sqrt(np.abs(descriptor) / (np.abs(descriptor).sum(axis=1, keepdims=True) + 1e-12))
    return (np.sign(descriptor) * absolute).astype(np.float32)
