"""Features that OpenCV detects and describes: ORB, TEBLID, AKAZE and SURF."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.detections import Described, Detections
from frontend.feature_kinds import FeatureKind

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

ORB_SCALE = 1.2
"""Scale factor from one level of ORB's pyramid to the next."""
EVERY = 100_000
"""Feature limit above the number in any picture."""


class FeatureUnavailableError(ValueError):
    """The installed OpenCV build does not contain the requested detector."""


@dataclass(frozen=True)
class _Pair:
    """OpenCV's objects of one thread."""

    detector: Any
    descriptor: Any


class OpenCvFeatures:
    """Detector and descriptor of one kind. One object may serve several threads.

    Raises ``FeatureUnavailableError`` if the OpenCV build lacks them.
    """

    def __init__(self, kind: FeatureKind) -> None:
        self._kind: FeatureKind = kind
        self._thread_local = threading.local()
        self._pair()

    def __reduce__(self) -> tuple[type[OpenCvFeatures], tuple[FeatureKind]]:
        return OpenCvFeatures, (self._kind,)

    def _pair(self) -> _Pair:
        """Return the objects of this thread, as OpenCV does not document which are thread-safe."""
        if not hasattr(self._thread_local, "pair"):
            self._thread_local.pair = _create(self._kind)
        pair: _Pair = self._thread_local.pair
        return pair

    @property
    def no_descriptors(self) -> NDArray[Any]:
        """(0, d) descriptors of no point."""
        width = int(self._pair().descriptor.descriptorSize())
        return np.empty((0, width), np.float32 if self._kind == "surf" else np.uint8)

    def __call__(self, grey: Image, mask: Image | None, limit: int) -> Described | None:
        """Return up to ``limit`` points of a grey picture where ``mask`` is not 0; None without any.

        All points are detected, since OpenCV limits their number before it masks them, and few are described.
        """
        pair = self._pair()
        every = list(pair.detector.detect(grey, mask))
        attributes = np.array([(p.size, p.angle, p.response) for p in every], dtype=float).reshape(-1, 3).T
        found = Detections.of(_pixels(every), attributes, grey.shape[::-1])
        chosen = [every[k] for k in found.strongest(limit).tolist()]
        points, descriptor = pair.descriptor.compute(grey, chosen)
        if descriptor is None or len(points) == 0:
            return None
        size_px, response = np.array([(p.size, p.response) for p in points], dtype=float).T
        pixel = _positions(self._kind, points, np.array(grey.shape[::-1]))
        return Described(pixel, size_px, response, descriptor.reshape(len(points), -1))


def _create(kind: FeatureKind) -> _Pair:
    """Return the objects for features of a kind."""
    api: Any = cv2  # the type stubs lack several creators
    if kind in ("orb", "orb-teblid"):
        orb = api.ORB_create(nfeatures=EVERY, scaleFactor=ORB_SCALE, fastThreshold=5)
        return _Pair(orb, orb if kind == "orb" else api.xfeatures2d.TEBLID_create(1.0))
    if kind == "akaze":
        akaze = api.xfeatures2d.AKAZE_create(threshold=2e-4)
        return _Pair(akaze, akaze)
    if kind == "surf":
        try:
            surf = api.xfeatures2d.SURF_create(hessianThreshold=100)
        except (AttributeError, cv2.error) as error:
            raise FeatureUnavailableError(
                "features 'surf': this OpenCV build lacks SURF (it was patented); use --features sift, "
                "or install an OpenCV built with OPENCV_ENABLE_NONFREE"
            ) from error
        return _Pair(surf, surf)
    raise FeatureUnavailableError(f"features {kind!r}: unknown; choose sift, orb, orb-teblid, akaze or surf")


def _pixels(points: Sequence[cv2.KeyPoint]) -> Array:
    """Return (n, 2) positions of points."""
    return np.asarray(cv2.KeyPoint.convert(points), dtype=float).reshape(-1, 2)


def _positions(kind: FeatureKind, points: Sequence[cv2.KeyPoint], size_px: NDArray[np.int64]) -> Array:
    """Return (n, 2) positions in a picture of size (w, h), corrected for the scales of OpenCV's pyramids.

    A level has a whole number of pixels, so its true scale is w / w_level, and pixel edges coincide, not
    centres. OpenCV multiplies by the nominal scale instead. ORB was off by 0.35 px on average and up to 2 px,
    AKAZE by 0.5 px per octave on pictures of odd size.
    """
    pixel = _pixels(points)
    if kind == "surf":
        return pixel
    level = np.array([p.octave for p in points])[:, None]
    if kind == "akaze":
        return np.asarray((pixel + 0.5) * size_px / (size_px // 2**level * 2**level) - 0.5)
    nominal = np.float32(ORB_SCALE) ** level
    return np.asarray((pixel / nominal + 0.5) * size_px / np.rint(size_px / nominal) - 0.5)
