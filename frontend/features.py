"""Detection and description of point features behind one interface."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.cores import usable_cores
from frontend.detections import Detections
from frontend.feature_kinds import FeatureKind
from frontend.gradient_histograms import descriptors
from frontend.points import Points
from frontend.rectification import rectifier
from frontend.robust import median
from frontend.scale_space import CONTRAST, EDGE_RATIO, ScaleSpace

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

ORB_SCALE = 1.2
"""Scale factor from one level of ORB's pyramid to the next."""
COARSE_PX = 8.0
"""Diameter at which a feature has twice the position variance of a fine one of the same contrast."""
EVERY = 100_000
"""Feature limit above the number in any picture."""
FINEST_OCTAVE = 0xFF
"""The octave of the doubled picture, -1, in the lowest byte of SIFT's ``KeyPoint.octave``. Given points of
coarser octaves alone, OpenCV describes them without doubling the picture: the descriptors differ slightly."""
LARGEST_BY_OPENCV_PX = 640
"""Longest side of the pictures that OpenCV's SIFT searches. `frontend.scale_space` takes 0.4 to 0.5 of its
time at 640 and 1200 px, and 0.6 to 0.7 at 320 px. Maps of video, whose pictures are small, have been measured
with OpenCV's alone."""
MOST_PX_AT_ONCE = 9_000_000
"""Pixels of the pictures that are searched at a time. A search takes 109 bytes a pixel at its peak: 1 GB."""
SMALLEST_PX = 16
"""Smallest side of a picture. Smaller pictures give no features, as some pyramids would have empty levels."""


class FeatureUnavailableError(ValueError):
    """The installed OpenCV build does not contain the requested detector."""


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


@dataclass(frozen=True)
class _Described:
    """Points of a searched picture that are kept, with their descriptors."""

    pixel: Array
    """(n, 2) in that picture."""
    size_px: Array
    """(n,) diameters."""
    response: Array
    """(n,) strengths."""
    descriptor: NDArray[Any]
    """(n, d) as they were found."""


@dataclass(frozen=True)
class _Detectors:
    """OpenCV's objects of one thread."""

    detector: Any
    descriptor: Any
    of_strongest: Any = None
    """SIFT that detects and describes the strongest points alone, with one pyramid of the picture; None for
    other kinds."""


class Extractor:
    """Detector and descriptor of features. One object may serve a whole flight and several threads.

    Raises ``FeatureUnavailableError`` if the OpenCV build lacks the detector.
    """

    def __init__(self, config: FeatureConfig = FeatureConfig()) -> None:
        self.config = config
        self._thread_local = threading.local()
        self._detectors()

    def __reduce__(self) -> tuple[type[Extractor], tuple[FeatureConfig]]:
        return Extractor, (self.config,)

    def _detectors(self) -> _Detectors:
        """Return the detectors of this thread, as OpenCV does not document which are thread-safe."""
        if not hasattr(self._thread_local, "detectors"):
            self._thread_local.detectors, self._thread_local.crowded = _create(self.config), False
        detectors: _Detectors = self._thread_local.detectors
        return detectors

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
        by_opencv = self.config.kind != "sift" or size.max() <= LARGEST_BY_OPENCV_PX
        search = self._by_opencv if by_opencv else self._in_scale_space
        scale, first_px = full / size, np.zeros(2)
        if (ideal := rectifier(camera, (int(size[0]), int(size[1])))) is not None:
            grey, mask, first_px = ideal.picture(grey), ideal.mask(mask), ideal.first_px
            size = np.array(grey.shape[::-1])
            if size.min() < SMALLEST_PX:
                return self._no_features()
        found = search(np.asarray(grey, dtype=np.uint8), mask)
        if found is None:
            return self._no_features()
        # Pixel x of a reduced picture has its centre at full-size pixel (x + 1/2) full / size - 1/2.
        pixel = (found.pixel + first_px + 0.5) * scale - 0.5
        relative_std = _relative_std(self.config.kind, found) * camera.magnification(pixel)
        return Features(Points(pixel, relative_std), _normalise(found.descriptor))

    def _in_scale_space(self, grey: Image, mask: Image | None) -> _Described | None:
        """Return the points of a grey picture that are kept, by SIFT; None without any."""
        space = ScaleSpace.of(grey)
        keypoints = space.keypoints()
        if mask is not None:
            column, row = np.rint(keypoints.pixel).astype(np.int64).T
            keypoints = keypoints[np.flatnonzero(mask[row, column])]
        attributes = np.stack([keypoints.size_px, keypoints.response])
        found = Detections.of(keypoints.pixel, attributes, grey.shape[::-1])
        kept = keypoints[found.strongest(self.config.max_features)]
        if len(kept) == 0:
            return None
        return _Described(kept.pixel, kept.size_px, kept.response, descriptors(space, kept))

    def _by_opencv(self, grey: Image, mask: Image | None) -> _Described | None:
        """Return the points of a grey picture that are kept, by OpenCV; None without any."""
        points, descriptor = self._points(grey, mask)
        if descriptor is None or len(points) == 0:
            return None
        size_px, _, response = _attributes(points)
        pixel = _positions(self.config.kind, points, np.array(grey.shape[::-1]))
        return _Described(pixel, size_px, response, descriptor.reshape(len(points), -1))

    def _points(self, grey: Image, mask: Image | None) -> tuple[Sequence[cv2.KeyPoint], Any]:
        """Return the points that are kept, and their descriptors (None without points)."""
        detectors, limit = self._detectors(), self.config.max_features
        # OpenCV masks points after it has limited their number. Neighbours of a crowded picture are crowded.
        if detectors.of_strongest is not None and mask is None and not self._thread_local.crowded:
            points, descriptor = detectors.of_strongest.detectAndCompute(grey, None)
            found = _detections(points, grey)
            if len(points) < limit or not found.are_crowded(limit):
                kept = found.strongest(limit)
                points = [points[k] for k in kept.tolist()]
                if any(point.octave & 0xFF == FINEST_OCTAVE for point in points):
                    return points, descriptor[kept]
        # All points are detected and few are described: that costs less than to search sparse cells again.
        every = list(detectors.detector.detect(grey, mask))
        found = _detections(every, grey)
        self._thread_local.crowded = found.are_crowded(limit)
        chosen = [every[k] for k in found.strongest(limit).tolist()]
        points, descriptor = detectors.descriptor.compute(grey, chosen)
        return points, descriptor

    def _no_features(self) -> Features:
        return Features(Points.alike(np.empty((0, 2))), np.empty((0, self._width), self._dtype))

    @property
    def _width(self) -> int:
        return int(self._detectors().descriptor.descriptorSize())

    @property
    def _dtype(self) -> type:
        return np.float32 if self.config.kind in ("sift", "surf") else np.uint8


def check_picture(image: Any) -> None:
    """Raise ``TypeError`` or ``ValueError`` where an object is no 8-bit picture."""
    expected = "picture: expected an array of uint8, (h, w) grey or (h, w, 3) BGR"
    if not isinstance(image, np.ndarray):
        raise TypeError(f"{expected}, got {type(image).__name__}")
    if image.dtype != np.uint8:
        raise TypeError(f"{expected}, got {image.dtype}")
    if image.ndim not in (2, 3) or image.shape[2:] not in ((), (3,)):
        raise ValueError(f"{expected}, got shape {image.shape}")


def _pixels(points: Sequence[cv2.KeyPoint]) -> Array:
    """Return (n, 2) positions of points."""
    return np.asarray(cv2.KeyPoint.convert(points), dtype=float).reshape(-1, 2)


def _attributes(points: Sequence[cv2.KeyPoint]) -> Array:
    """Return (3, n) size, angle and response of all points."""
    each = [(point.size, point.angle, point.response) for point in points]
    return np.array(each, dtype=float).reshape(-1, 3).T


def _detections(points: Sequence[cv2.KeyPoint], grey: Image) -> Detections:
    return Detections.of(_pixels(points), _attributes(points), grey.shape[::-1])


def _create(config: FeatureConfig) -> _Detectors:
    """Return the objects for the features of a configuration."""
    api: Any = cv2  # the type stubs lack several creators
    kind = config.kind
    if kind == "sift":
        return _Detectors(every := _sift(EVERY), every, _sift(config.max_features))
    if kind in ("orb", "orb-teblid"):
        orb = api.ORB_create(nfeatures=EVERY, scaleFactor=ORB_SCALE, fastThreshold=5)
        return _Detectors(orb, orb if kind == "orb" else api.xfeatures2d.TEBLID_create(1.0))
    if kind == "akaze":
        akaze = api.xfeatures2d.AKAZE_create(threshold=2e-4)
        return _Detectors(akaze, akaze)
    if kind == "surf":
        try:
            surf = api.xfeatures2d.SURF_create(hessianThreshold=100)
        except (AttributeError, cv2.error) as error:
            raise FeatureUnavailableError(
                "features 'surf': this OpenCV build lacks SURF (it was patented); use --features sift, "
                "or install an OpenCV built with OPENCV_ENABLE_NONFREE"
            ) from error
        return _Detectors(surf, surf)
    raise FeatureUnavailableError(f"features {kind!r}: unknown; choose sift, orb, orb-teblid, akaze or surf")


def _sift(limit: int) -> Any:
    """Return SIFT that keeps the ``limit`` strongest points of a picture."""
    # Without precise upscaling positions are off by 1/4 px.
    api: Any = cv2  # the type stubs lack several creators
    return api.SIFT_create(
        nfeatures=limit, contrastThreshold=CONTRAST, edgeThreshold=EDGE_RATIO, enable_precise_upscale=True
    )


def _positions(kind: FeatureKind, points: Sequence[cv2.KeyPoint], size_px: NDArray[np.int64]) -> Array:
    """Return (n, 2) positions in a picture of size (w, h), corrected for the scales of OpenCV's pyramids.

    A level has a whole number of pixels, so its true scale is w / w_level, and pixel edges coincide, not
    centres. OpenCV multiplies by the nominal scale instead. ORB was off by 0.35 px on average and up to 2 px,
    AKAZE by 0.5 px per octave on pictures of odd size. SIFT is correct.
    """
    pixel = _pixels(points)
    if kind not in ("orb", "orb-teblid", "akaze"):
        return pixel
    level = np.array([p.octave for p in points])[:, None]
    if kind in ("orb", "orb-teblid"):
        nominal = np.float32(ORB_SCALE) ** level
        return (pixel / nominal + 0.5) * size_px / np.rint(size_px / nominal) - 0.5
    return np.asarray((pixel + 0.5) * size_px / (size_px // 2**level * 2**level) - 0.5)


def _relative_std(kind: FeatureKind, found: _Described) -> Array:
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
