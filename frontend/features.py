"""Point features behind one interface: where they are, and what they look like."""

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
from frontend.rectified import rectifier
from frontend.robust import median

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

ORB_SCALE = 1.2
"""From one level of ORB's pyramid to the next."""
CROWDED = 0.68
"""Features crowd where the fullest third of the picture holds more than this share of them. On floors it
holds half to two thirds; then cells with less than half their even share are searched once more, and fuller
ones keep just that share."""
BARE_SHARE, USED_UP = 0.5, 0.9
COARSE_PX = 8.0
"""A spot of this diameter is known half as well, by variance, as a fine one of the same contrast."""
ALL_FEATURES = 100_000
"""More than any picture has."""
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

    points: Points
    descriptor: NDArray[Any]
    """(n, d) float32, or uint8 bit strings."""

    def __len__(self) -> int:
        return len(self.points)

    @property
    def pixel(self) -> Array:
        """(n, 2) where they lie, as in `Points`."""
        return self.points.pixel

    def __getitem__(self, which: NDArray[Any]) -> Features:
        return Features(self.points[which], self.descriptor[which])


@dataclass(frozen=True)
class _Detected:
    """Keypoints and descriptors of a detector."""

    points: list[cv2.KeyPoint]
    descriptor: NDArray[Any]

    def __getitem__(self, which: NDArray[np.int64]) -> _Detected:
        return _Detected([self.points[k] for k in which], self.descriptor[which])

    def cells(self, size_px: NDArray[np.int64]) -> NDArray[np.int64]:
        """The cell of the picture (width, height) in which each lies."""
        pixel = np.asarray(cv2.KeyPoint.convert(self.points), dtype=float).reshape(-1, 2)
        return cells(pixel, (int(size_px[0]), int(size_px[1])))

    def spread(self, size_px: NDArray[np.int64], quota: int, bare: Image) -> _Detected:
        """The strongest of each cell, at most ``quota``, without those where ``bare`` (h, w) is not 0."""
        order = _by_strength(self.points)
        cell = self.cells(size_px)[order]
        by_cell = np.argsort(cell, kind="stable")
        first = np.zeros(len(order), dtype=bool)
        first[by_cell[place_in_run(cell[by_cell]) < quota]] = True
        column, row = np.asarray(cv2.KeyPoint.convert(self.points)).reshape(-1, 2).astype(int).T
        return self[order[first & (bare[row, column][order] == 0)]]

    def with_others(self, others: _Detected, most: int) -> _Detected:
        """These, and the strongest of others until there are ``most``."""
        more = others[_by_strength(others.points)[: max(0, most - len(self.points))]]
        return _Detected(self.points + more.points, np.concatenate([self.descriptor, more.descriptor]))


@dataclass(frozen=True)
class _Tools:
    """OpenCV's objects."""

    detector: Any
    descriptor: Any
    """None where the detector describes too."""
    searcher: Any
    """A detector without a limit."""


class Extractor:
    """Detects and describes features; one object serves a whole flight, and several threads.

    Raises ``FeatureUnavailableError`` where the OpenCV build lacks the detector.
    """

    def __init__(self, config: FeatureConfig = FeatureConfig()) -> None:
        self.config = config
        self._own = threading.local()
        self._tools()

    def _tools(self) -> _Tools:
        """This thread's: OpenCV does not say which of its detectors two may share."""
        if not hasattr(self._own, "tools"):
            searcher, _ = _create(replace(self.config, max_features=ALL_FEATURES))
            self._own.tools = _Tools(*_create(self.config), searcher)
        tools: _Tools = self._own.tools
        return tools

    def __call__(self, image: Image, camera: Camera, mask: Image | None = None) -> Features:
        """Features of one picture, (h, w) grey or (h, w, 3) BGR uint8; ``mask`` is 0 where to look away.

        Raises ``TypeError`` or ``ValueError`` for an array that is no such picture.
        """
        _check_picture(image)
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
        full = np.array(grey.shape[::-1])
        size = np.rint(full * min(1.0, self.config.max_side_px / full.max())).astype(int)
        if size.min() < SMALLEST_PX:
            return self._nothing()
        if (size < full).any():
            grey = cv2.resize(grey, size.tolist(), interpolation=cv2.INTER_AREA)
            if mask is not None:
                mask = cv2.resize(mask, size.tolist(), interpolation=cv2.INTER_NEAREST)
        scale, first_px = full / size, np.zeros(2)
        if (ideal := rectifier(camera, (int(size[0]), int(size[1])))) is not None:
            grey, mask, first_px = ideal.picture(grey), ideal.mask(mask), ideal.first_px
            size = np.array(grey.shape[::-1])
            if size.min() < SMALLEST_PX:
                return self._nothing()
        found = self._strongest(grey, mask)
        if (bare := self._left_bare(found, size)) is not None:
            elsewhere = self._strongest(grey, bare if mask is None else np.minimum(bare, mask))
            crowd = found.spread(size, round(self.config.max_features / CELLS), bare)
            found = crowd.with_others(elsewhere, self.config.max_features)
        if len(found.points) == 0:
            return self._nothing()
        pixel = _positions(self.config.kind, found.points, size)
        # A reduced picture's pixel x covers full-size pixels around (x + 1/2) full / size - 1/2.
        pixel = (pixel + first_px + 0.5) * scale - 0.5
        spread = _spread(self.config.kind, found.points) * camera.magnification(pixel)
        return Features(Points(pixel, spread), _normalise(found.descriptor))

    def _strongest(self, grey: Image, mask: Image | None) -> _Detected:
        """At most ``max_features``, the strongest where the detector found more."""
        most, tools = self.config.max_features, self._tools()
        if tools.descriptor is None:
            points, descriptor = tools.detector.detectAndCompute(grey, mask)
        else:
            points, descriptor = tools.descriptor.compute(grey, tools.detector.detect(grey, mask))
        if mask is not None and len(points) < most // 2:
            # Detectors keep their strongest before they look at a mask: what it hides may have used them up.
            every = tools.searcher.detect(grey, mask)
            points = [every[k] for k in _by_strength(every)[:most]]
            points, descriptor = (tools.descriptor or tools.detector).compute(grey, points)
        if descriptor is None or len(points) == 0:
            return _Detected([], np.empty((0, self._width), self._dtype))
        found = _Detected(list(points), descriptor.reshape(len(points), -1))
        # Detectors treat their own limit loosely.
        return found[_by_strength(found.points)[:most]] if len(points) > most else found

    def _left_bare(self, found: _Detected, size: NDArray[np.int64]) -> Image | None:
        """Return a mask (h, w) of the area to search once more, if the strongest features crowd in one part.
        Otherwise a textured object, such as a landing gear, would leave no features to the floor. Return
        None if they do not crowd."""
        if len(found.points) < USED_UP * self.config.max_features:
            return None
        held = np.bincount(found.cells(size), minlength=CELLS)
        if np.sort(held)[-CELLS // 3 :].sum() <= CROWDED * held.sum():
            return None
        bare = held < BARE_SHARE * self.config.max_features / CELLS
        cell_of = np.where(bare, 255, 0).astype(np.uint8).reshape(GRID[::-1])
        return np.asarray(cv2.resize(cell_of, size.tolist(), interpolation=cv2.INTER_NEAREST), np.uint8)

    def _nothing(self) -> Features:
        return Features(Points.alike(np.empty((0, 2))), np.empty((0, self._width), self._dtype))

    @property
    def _width(self) -> int:
        return int((self._tools().descriptor or self._tools().detector).descriptorSize())

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
    """Places of all, the strongest first."""
    return np.argsort(-_each("response", points), kind="stable")


def _each(what: str, points: Sequence[cv2.KeyPoint]) -> Array:
    """(n,) one attribute of all."""
    return np.fromiter(map(attrgetter(what), points), float, len(points))


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
    if kind not in ("orb", "orb-teblid", "akaze"):
        return pixel
    level = np.array([p.octave for p in points])[:, None]
    if kind in ("orb", "orb-teblid"):
        nominal = np.float32(ORB_SCALE) ** level
        return (pixel / nominal + 0.5) * size_px / np.rint(size_px / nominal) - 0.5
    return np.asarray((pixel + 0.5) * size_px / (size_px // 2**level * 2**level) - 0.5)


def _spread(kind: FeatureKind, points: Sequence[cv2.KeyPoint]) -> Array:
    """(n,) standard deviation of each position over the median one of the picture.

    Noise moves a faint spot farther, and shading, or a neighbour, a coarse one. For SIFT the law was found
    from rendered pairs (`tests/benchmarks/registration.py`); of the others it is not known.
    """
    if kind != "sift":
        return np.ones(len(points))
    variance = (1.0 + (_each("size", points) / COARSE_PX) ** 2) / _each("response", points)
    return np.sqrt(variance / median(variance))


def _normalise(descriptor: NDArray[Any]) -> NDArray[Any]:
    """RootSIFT for float descriptors (Arandjelovic and Zisserman 2012): Hellinger distance by L2."""
    if descriptor.dtype == np.uint8:
        return descriptor
    root: NDArray[np.float32] = np.abs(descriptor)
    root /= root.sum(axis=1, keepdims=True) + 1e-12
    np.sqrt(root, out=root)
    root *= np.sign(descriptor)
    return root
