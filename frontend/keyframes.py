"""Tracking: each frame registered to the last keyframe, a new one when too little of that is left in view."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.features import Extractor, Features
from frontend.gates import GateConfig, relative_change
from frontend.homography import HomographyConfig
from frontend.objection import objection
from frontend.registration import Registration, register

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class KeyframeConfig:
    """When a frame becomes a keyframe."""

    min_overlap: float = 0.75
    """A frame that shares less than this with the last keyframe makes a new one."""
    patience: int = 5
    """Frames in a row that may fail before tracking starts anew without a link."""


@dataclass(frozen=True)
class Keyframe:
    """A frame that stays in the map."""

    frame: int
    """Number of the frame in the flight."""
    features: Features
    link: Registration | None
    """Registration to the previous keyframe (i = previous, j = this); None where tracking started anew."""
    refused: Registration | None = None
    """A registration to the previous keyframe that did not hold."""


@dataclass(frozen=True)
class _Tracked:
    frame: int
    features: Features
    link: Registration


class Tracker:
    """Goes through the frames once; ``rejected`` counts what was dropped, by reason."""

    def __init__(
        self,
        camera: Camera,
        extractor: Extractor,
        homography: HomographyConfig,
        gates: GateConfig,
        config: KeyframeConfig,
        masks: Callable[[int], Image | None] = lambda frame: None,
    ) -> None:
        """``masks``: of each frame by its number, 0 where to look away."""
        self.camera, self.extractor = camera, extractor
        self.homography, self.gates, self.config, self.masks = homography, gates, config, masks
        self.rejected: Counter[str] = Counter()
        self.frames = 0

    def keyframes(self, images: Iterable[Image | None]) -> Iterator[Keyframe]:
        """Keyframes in order of time."""
        number = -1
        last: Keyframe | None = None
        best: _Tracked | None = None
        failures = 0
        for frame, features in self._seen(images):
            if last is None:
                last, number = Keyframe(frame, features, None), number + 1
                yield last
                continue
            tracked, reason = self._track(number, frame, last, features)
            if (tracked is None or tracked.link.overlap < self.config.min_overlap) and best is not None:
                # The frame before was still well in view: it becomes the keyframe.
                last, number, best = Keyframe(best.frame, best.features, best.link), number + 1, None
                yield last
                tracked, reason = self._track(number, frame, last, features)
            if tracked is None:
                self.rejected[reason] += 1
                failures += 1
                if failures > self.config.patience:
                    self.rejected["tracking started anew"] += 1
                    last, number, failures = Keyframe(frame, features, None), number + 1, 0
                    yield last
                continue
            failures, best = 0, tracked
        if best is not None:
            yield Keyframe(best.frame, best.features, best.link)

    def every(self, images: Iterable[Image | None]) -> Iterator[Keyframe]:
        """Each readable picture as a keyframe, linked to the one before where the two overlap."""
        number = -1
        before: Features | None = None
        for frame, features in self._seen(images):
            link = None
            if before is not None:
                link = register(
                    number, number + 1, before, features, self.camera, self.homography, self.gates
                )
            number, before = number + 1, features
            if link is None or link.ok:
                yield Keyframe(frame, features, link)
            else:
                yield Keyframe(frame, features, None, refused=link)

    def _seen(self, images: Iterable[Image | None]) -> Iterator[tuple[int, Features]]:
        """Frames with enough features, and their numbers; the others are counted."""
        for frame, features in enumerate(self._extracted(images)):
            self.frames += 1
            if isinstance(features, str):
                self.rejected[features] += 1
            elif len(features) < self.gates.min_inliers:
                self.rejected["too few features"] += 1
            else:
                yield frame, features

    def _extracted(self, images: Iterable[Image | None]) -> Iterator[Features | str]:
        """Features of each frame, or why there are none; the next ones are found while these are matched."""
        coming: deque[Future[Features | str]] = deque()
        before: Image | None = None
        with ThreadPoolExecutor(1) as pool:
            for frame, image in enumerate(images):
                coming.append(pool.submit(self._features, frame, image, before))
                before = image if image is not None else before
                if len(coming) > 1:
                    yield coming.popleft().result()
            while coming:
                yield coming.popleft().result()

    def _features(self, frame: int, image: Image | None, before: Image | None) -> Features | str:
        if image is None:
            return "unreadable"
        if reason := objection(image, self.camera.size_px):
            return reason
        features = self.extractor(image, self.camera, self.masks(frame))
        if len(features) >= self.gates.min_inliers and before is not None and np.array_equal(image, before):
            # A camera that hangs: its stamp goes on, and the place with it.
            return "same picture as the one before"
        return features

    def _track(
        self, number: int, frame: int, last: Keyframe, features: Features
    ) -> tuple[_Tracked | None, str]:
        """The frame as the last keyframe sees it, or why not."""
        link = register(number, number + 1, last.features, features, self.camera, self.homography, self.gates)
        if not link.ok:
            return None, link.reason
        if relative_change(link.i_H_j, self.camera) > self.gates.max_relative_change:
            return None, "change above gamma_2"
        return _Tracked(frame, features, link), ""
