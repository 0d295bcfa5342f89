"""Tracking: each frame registered to the last keyframe, a new one when too little of that is left in view."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.cells import cells
from frontend.corner_track import CornerTrack
from frontend.features import Extractor, Features
from frontend.gates import GateConfig, relative_change
from frontend.homography import HomographyConfig, transfer
from frontend.picture_check import unusable_reason
from frontend.registration import Registration, register

Image = NDArray[np.uint8]

SEARCHED_AT_ONCE, MOST_PX = 2, 500_000
"""Pictures of up to so many pixels are searched two at a time: OpenCV splits a small one badly among cores.
Larger ones it splits well, and each takes a lot of memory."""


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
class IntermediateFrame:
    """A frame that did not become a keyframe, as the keyframe before it sees it."""

    frame: int
    keyframe: int
    i_H_j: NDArray[np.float64]
    """(3, 3), j being the frame."""
    corner_covariance: NDArray[np.float64]
    """(8, 8) px², as in `frontend.registration`."""


@dataclass(frozen=True)
class _Tracked:
    """A tracked frame with all its features, also those on moving things: the next frame needs them to tell
    these from the floor."""

    frame: int
    features: Features
    link: Registration | None
    on_floor: NDArray[np.bool_]
    """(n,) features that the map gets."""
    trail: CornerTrack
    """This frame's place, and that of the one before, as the last keyframe sees them."""

    def as_last(self) -> _Tracked:
        """As the keyframe that later frames are registered to."""
        assert self.link is not None
        return replace(self, trail=self.trail.seen_from(self.link.i_H_j))

    def keyframe(self, last: _Tracked | None) -> Keyframe:
        """The frame as one that stays, with the features on the floor alone."""
        features, link = self.features, self.link
        if self.on_floor.all() and (last is None or last.on_floor.all()):
            return Keyframe(self.frame, features, link)
        if link is not None and last is not None:
            i, j = link.matches.T
            kept = last.on_floor[i] & self.on_floor[j]
            number_i, number_j = np.cumsum(last.on_floor) - 1, np.cumsum(self.on_floor) - 1
            matches = np.column_stack([number_i[i[kept]], number_j[j[kept]]])
            link = replace(link, matches=matches.astype(i.dtype), elsewhere=link.elsewhere[:0])
        on_floor = features[self.on_floor]
        return Keyframe(self.frame, on_floor, link)

    def passed(self) -> IntermediateFrame:
        """The frame as one that does not stay."""
        assert self.link is not None
        return IntermediateFrame(self.frame, self.link.i, self.link.i_H_j, self.link.corner_covariance)


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
        self._corners = camera.undistort(camera.corners_px)
        self.rejected: Counter[str] = Counter()
        self.frames = 0
        self.moving: set[int] = set()
        """Frames in which something moves otherwise than the floor."""
        self.passed: list[IntermediateFrame] = []

    def keyframes(self, images: Iterable[Image | None]) -> Iterator[Keyframe]:
        """Keyframes in order of time."""
        number = -1
        last: _Tracked | None = None
        best: _Tracked | None = None
        failures = 0
        for frame, features in self._seen(images):
            if last is None:
                last, number = self._first(frame, features), number + 1
                yield last.keyframe(None)
                continue
            tracked, reason = self._track(number, frame, last, features, (best or last).trail)
            if best is not None and (tracked is None or self._leaves(tracked)):
                # The frame before was still well in view: it becomes the keyframe.
                yield best.keyframe(last)
                last, number, best = best.as_last(), number + 1, None
                tracked, reason = self._track(number, frame, last, features, last.trail)
            elif best is not None:
                self.passed.append(best.passed())
            if tracked is None:
                self.rejected[reason] += 1
                failures += 1
                if failures > self.config.patience:
                    self.rejected["tracking started anew"] += 1
                    last, number, failures = self._first(frame, features), number + 1, 0
                    yield last.keyframe(None)
                continue
            failures, best = 0, tracked
        if best is not None and last is not None:
            yield best.keyframe(last)

    def _leaves(self, tracked: _Tracked) -> bool:
        assert tracked.link is not None
        # Which of two motions is the floor's is sure only while most of it is in view: so both count.
        return tracked.link.least_overlap < self.config.min_overlap

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
        width, height = self.camera.size_px
        ahead = SEARCHED_AT_ONCE if width * height <= MOST_PX else 1
        with ThreadPoolExecutor(ahead) as pool:
            for frame, image in enumerate(images):
                coming.append(pool.submit(self._features, frame, image, before))
                before = image if image is not None else before
                if len(coming) > ahead:
                    yield coming.popleft().result()
            while coming:
                yield coming.popleft().result()

    def _features(self, frame: int, image: Image | None, before: Image | None) -> Features | str:
        if image is None:
            return "unreadable"
        if reason := unusable_reason(image, self.camera.size_px):
            return reason
        features = self.extractor(image, self.camera, self.masks(frame))
        if len(features) >= self.gates.min_inliers and before is not None and np.array_equal(image, before):
            # A camera that hangs: its stamp goes on, and the place with it.
            return "same picture as the one before"
        return features

    def _track(
        self, number: int, frame: int, last: _Tracked, features: Features, trail: CornerTrack
    ) -> tuple[_Tracked | None, str]:
        """The frame as the last keyframe sees it, or why not."""
        link = register(
            number, number + 1, last.features, features, self.camera, self.homography, self.gates,
            trail.expected(frame),
        )  # fmt: skip
        if not link.ok:
            return None, link.reason
        if relative_change(link.i_H_j, self.camera) > self.gates.max_relative_change:
            return None, "change above gamma_2"
        on_floor = _on_floor(features, link, self.camera)
        if not on_floor.all():
            self.moving.add(frame)
        alone, width_px = len(link.elsewhere) == 0, self.camera.size_px[0]
        trail = trail.then(frame, transfer(link.i_H_j, self._corners), link.lead, alone, width_px)
        return _Tracked(frame, features, link, on_floor, trail), ""

    def _first(self, frame: int, features: Features) -> _Tracked:
        every = np.ones(len(features), dtype=bool)
        return _Tracked(frame, features, None, every, CornerTrack.begin(frame, self._corners))


def _on_floor(features: Features, link: Registration, camera: Camera) -> NDArray[np.bool_]:
    """All features but those where only what moves by itself was matched."""
    if len(link.elsewhere) == 0:
        return np.ones(len(features), dtype=bool)
    cell = cells(features.pixel, camera.size_px)
    other = np.setdiff1d(cell[link.elsewhere], cell[link.matches[:, 1]])
    kept = ~np.isin(cell, other)
    kept[link.elsewhere] = False
    return kept
