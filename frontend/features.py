"""Detection and description of point features behind one interface."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.cells import COUNT as CELLS
from frontend.cells import GRID, cells, place_in_run
from frontend.feature_kinds import FeatureKind
from frontend.points import Points
from frontend.rectification import rectifier
from frontend.robust import median

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

ORB_SCALE = 1.2
"""Scale factor from one level of ORB's pyramid to the next."""
CROWDING_SHARE = 0.68
"""Features are crowded if the fullest third of the cells holds more than this share of them. On floors it
holds half to two thirds. In crowded pictures, cells with less than half of an even share are searched again,
and fuller cells keep only an even share."""
SPARSE_CELL_RATIO, LIMIT_REACHED_RATIO = 0.5, 0.9
COARSE_PX = 8.0
"""Diameter at which a feature has twice the position variance of a fine one of the same contrast."""
ALL_FEATURES = 100_000
"""Feature limit above the number in any picture."""
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
    max_side_px: int = 1400
    """Larger pictures are reduced to this side before detection. Positions refer to the full size."""

    def for_width(self, width_px: int) -> FeatureConfig:
        """Return the configuration with the feature limit scaled to the picture width."""
        width = min(width_px, self.max_side_px)
        return replace(self, max_features=int(self.max_features * max(1.0, width / 500)))


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
class _Detections:
    """Key points of one detector with their descriptors."""

    points: list[cv2.KeyPoint]
    descriptor: NDArray[Any]

    def __getitem__(self, which: NDArray[np.int64]) -> _Detections:
        return _Detections([self.points[k] for k in which], self.descriptor[which])

    def cells(self, size_px: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return (n,) the cell of each point in a picture of (width, height) ``size_px``."""
        pixel = np.asarray(cv2.KeyPoint.convert(self.points), dtype=float).reshape(-1, 2)
        return cells(pixel, (int(size_px[0]), int(size_px[1])))

    def limit_per_cell(self, size_px: NDArray[np.int64], quota: int, sparse: Image) -> _Detections:
        """Return the ``quota`` strongest points of each cell, none where ``sparse`` (h, w) is set."""
        order = _by_strength(self.points)
        cell = self.cells(size_px)[order]
        by_cell = np.argsort(cell, kind="stable")
        first = np.zeros(len(order), dtype=bool)
        first[by_cell[place_in_run(cell[by_cell]) < quota]] = True
        column, row = np.asarray(cv2.KeyPoint.convert(self.points)).reshape(-1, 2).astype(int).T
        return self[order[first & (sparse[row, column][order] == 0)]]

    def fill_up(self, others: _Detections, limit: int) -> _Detections:
        """Return these points and the strongest of the others, up to ``limit`` points in total."""
        more = others[_by_strength(others.points)[: max(0, limit - len(self.points))]]
        return _Detections(self.points + more.points, np.concatenate([self.descriptor, more.descriptor]))


@dataclass(frozen=True)
class _OpenCVDetectors:
    """OpenCV objects of one thread."""

    detector: Any
    descriptor: Any
    """None if the detector also computes descriptors."""
    unlimited: Any
    """Detector without a limit on the number of features."""


class Extractor:
    """Detector and descriptor of features. One object may serve a whole flight and several threads.

    Raises ``FeatureUnavailableError`` if the OpenCV build lacks the detector.
    """

    def __init__(self, config: FeatureConfig = FeatureConfig()) -> None:
        self.config = config
        self._thread_local = threading.local()
        self._detectors()

    def _detectors(self) -> _OpenCVDetectors:
        """Return the OpenCV objects of this thread, as OpenCV does not document which are thread-safe."""
        if not hasattr(self._thread_local, "detectors"):
            unlimited, _ = _create(replace(self.config, max_features=ALL_FEATURES))
            self._thread_local.detectors = _OpenCVDetectors(*_create(self.config), unlimited)
        detectors: _OpenCVDetectors = self._thread_local.detectors
        return detectors

    def __call__(self, image: Image, camera: Camera, mask: Image | None = None) -> Features:
        """Return the features of one picture, (h, w) grey or (h, w, 3) BGR uint8.

        Pixels where ``mask`` (h, w) is 0 are ignored. Raises ``TypeError`` or ``ValueError`` for any other
        array.
        """
        _check_picture(image)
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
        full = np.array(grey.shape[::-1])
        size = np.rint(full * min(1.0, self.config.max_side_px / full.max())).astype(int)
        if size.min() < SMALLEST_PX:
            return self._no_features()
        if (size < full).any():
            grey = cv2.resize(grey, size.tolist(), interpolation=cv2.INTER_AREA)
            if mask is not None:
                mask = cv2.resize(mask, size.tolist(), interpolation=cv2.INTER_NEAREST)
        scale, first_px = full / size, np.zeros(2)
        if (ideal := rectifier(camera, (int(size[0]), int(size[1])))) is not None:
            grey, mask, first_px = ideal.picture(grey), ideal.mask(mask), ideal.first_px
            size = np.array(grey.shape[::-1])
            if size.min() < SMALLEST_PX:
                return self._no_features()
        found = self._strongest(grey, mask)
        if (sparse := self._sparse_area(found, size)) is not None:
            others = self._strongest(grey, sparse if mask is None else np.minimum(sparse, mask))
            crowded = found.limit_per_cell(size, round(self.config.max_features / CELLS), sparse)
            found = crowded.fill_up(others, self.config.max_features)
        if len(found.points) == 0:
            return self._no_features()
        pixel = _positions(self.config.kind, found.points, size)
        # Pixel x of a reduced picture has its centre at full-size pixel (x + 1/2) full / size - 1/2.
        pixel = (pixel + first_px + 0.5) * scale - 0.5
        relative_std = _relative_std(self.config.kind, found.points) * camera.magnification(pixel)
        return Features(Points(pixel, relative_std), _normalise(found.descriptor))

    def _strongest(self, grey: Image, mask: Image | None) -> _Detections:
        """Return the strongest features, at most ``max_features``."""
        limit, cv = self.config.max_features, self._detectors()
        if cv.descriptor is None:
            points, descriptor = cv.detector.detectAndCompute(grey, mask)
        else:
            points, descriptor = cv.descriptor.compute(grey, cv.detector.detect(grey, mask))
        if mask is not None and len(points) < limit // 2:
            # Detectors apply their limit before the mask, so masked features may have used up the limit.
            all_points = cv.unlimited.detect(grey, mask)
            points = [all_points[k] for k in _by_strength(all_points)[:limit]]
            points, descriptor = (cv.descriptor or cv.detector).compute(grey, points)
        if descriptor is None or len(points) == 0:
            return _Detections([], np.empty((0, self._width), self._dtype))
        found = _Detections(list(points), descriptor.reshape(len(points), -1))
        # Detectors may exceed their own limit.
        return found[_by_strength(found.points)[:limit]] if len(points) > limit else found

    def _sparse_area(self, found: _Detections, size: NDArray[np.int64]) -> Image | None:
        """Return the mask (h, w) of sparse cells to search again, or None if features are not crowded.

        A textured object, such as a landing gear or a passer-by, could otherwise use up the limit and leave
        no features for the floor.
        """
        if len(found.points) < LIMIT_REACHED_RATIO * self.config.max_features:
            return None
        count = np.bincount(found.cells(size), minlength=CELLS)
        if np.sort(count)[-CELLS // 3 :].sum() <= CROWDING_SHARE * count.sum():
            return None
        sparse = count < SPARSE_CELL_RATIO * self.config.max_features / CELLS
        cell_mask = np.where(sparse, 255, 0).astype(np.uint8).reshape(GRID[::-1])
        return np.asarray(cv2.resize(cell_mask, size.tolist(), interpolation=cv2.INTER_NEAREST), np.uint8)

    def _no_features(self) -> Features:
        return Features(Points.alike(np.empty((0, 2))), np.empty((0, self._width), self._dtype))

    @property
    def _width(self) -> int:
        return int((self._detectors().descriptor or self._detectors().detector).descriptorSize())

    @property
    def _dtype(self) -> type:
        return np.float32 if self.config.kind in ("sift", "surf") else np.uint8


def _check_picture(image: Any) -> None:
    expected = "picture: expected an array of uint8, (h, w) grey or (h, w, 3) BGR"
    if not isinstance(image, np.ndarray):
        raise TypeError(f"{expected}, got {type(image).__name__}")
    if image.dtype != np.uint8:
        raise TypeError(f"{expected}, got {image.dtype}")
    if image.ndim not in (2, 3) or image.shape[2:] not in ((), (3,)):
        raise ValueError(f"{expected}, got shape {image.shape}")


def _by_strength(points: Sequence[cv2.KeyPoint]) -> NDArray[np.int64]:
    """Return (n,) the indices of the points, strongest first."""
    return np.argsort(-_attribute("response", points), kind="stable")


def _attribute(name: str, points: Sequence[cv2.KeyPoint]) -> Array:
    """Return (n,) one attribute of all points."""
    return np.fromiter(map(attrgetter(name), points), float, len(points))


def _create(config: FeatureConfig) -> tuple[Any, Any]:
    """Return the detector, and the descriptor if it is a separate object, else None."""
    api: Any = cv2  # the type stubs lack several creators
    n = config.max_features
    if config.kind == "sift":
        # Dark floors need a low contrast threshold. Without precise upscaling positions are off by 1/4 px.
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
                "features 'surf': this OpenCV build lacks SURF (it was patented); use --features sift, "
                "or install an OpenCV built with OPENCV_ENABLE_NONFREE"
            ) from error
    raise FeatureUnavailableError(
        f"features {config.kind!r}: unknown; choose sift, orb, orb-teblid, akaze or surf"
    )


def _positions(kind: FeatureKind, points: Sequence[cv2.KeyPoint], size_px: NDArray[np.int64]) -> Array:
    """Return (n, 2) positions in a picture of size (w, h), corrected for the scales of OpenCV's pyramids.

    A level has a whole number of pixels, so its true scale is w / w_level, and pixel edges coincide, not
    centres. OpenCV multiplies by the nominal scale instead. ORB was off by 0.35 px on average and up to 2 px,
    AKAZE by 0.5 px per octave on pictures of odd size. SIFT is correct.
    """
    pixel = np.asarray(cv2.KeyPoint.convert(points), dtype=float).reshape(-1, 2)
    if kind not in ("orb", "orb-teblid", "akaze"):
        return pixel
    level = np.array([p.octave for p in points])[:, None]
    if kind in ("orb", "orb-teblid"):
        nominal = np.float32(ORB_SCALE) ** level
        return (pixel / nominal + 0.5) * size_px / np.rint(size_px / nominal) - 0.5
    return np.asarray((pixel + 0.5) * size_px / (size_px // 2**level * 2**level) - 0.5)


def _relative_std(kind: FeatureKind, points: Sequence[cv2.KeyPoint]) -> Array:
    """Return (n,) the standard deviation of each position as a ratio to the median of the picture.

    Noise displaces faint features more. Shading and neighbouring features displace coarse features more. The
    law for SIFT was fitted to rendered pairs (`tests/benchmarks/registration.py`). It is unknown for the
    other kinds, which have the ratio 1.
    """
    if kind != "sift":
        return np.ones(len(points))
    variance = (1.0 + (_attribute("size", points) / COARSE_PX) ** 2) / _attribute("response", points)
    return np.sqrt(variance / median(variance))


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
