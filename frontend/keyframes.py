"""Tracking: register each frame to the last keyframe; create a keyframe when their overlap becomes small."""

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

SAME_PICTURE = "same picture as the one before"
"""Reason to drop a picture that equals the one before, pixel by pixel."""
SEARCHED_AT_ONCE, MOST_PX = 2, 500_000
"""Features of pictures of up to ``MOST_PX`` are extracted two pictures at a time, because OpenCV splits small
pictures badly among cores. It splits larger ones well, and each needs much memory."""


@dataclass(frozen=True)
class KeyframeConfig:
    """Parameters of keyframe selection."""

    min_overlap: float = 0.75
    """A new keyframe is created where the overlap with the last one is less than this."""
    patience: int = 5
    """Consecutive frames that may fail before tracking restarts without a link."""


@dataclass(frozen=True)
class Keyframe:
    """A frame that is kept in the map."""

    frame: int
    """Number of the frame in the flight."""
    features: Features
    link: Registration | None
    """Registration to the previous keyframe (i = previous, j = this); None where tracking restarted."""
    refused: Registration | None = None
    """A rejected registration to the previous keyframe."""


@dataclass(frozen=True)
class IntermediateFrame:
    """A frame between keyframes, registered to the keyframe before it."""

    frame: int
    keyframe: int
    i_H_j: NDArray[np.float64]
    """(3, 3) homography; i is the keyframe, j the frame."""
    corner_covariance: NDArray[np.float64]
    """(8, 8) px², as in `frontend.registration`."""


@dataclass(frozen=True)
class _Tracked:
    """A tracked frame with all its features, including those on moving objects: the next frame needs them to
    separate the objects from the floor."""

    frame: int
    features: Features
    link: Registration | None
    on_floor: NDArray[np.bool_]
    """(n,) whether each feature belongs to the floor and enters the map."""
    corner_track: CornerTrack
    """Corners of this frame and of the previous one in the picture of the last keyframe."""

    def as_last(self) -> _Tracked:
        """Return the frame as the keyframe that later frames are registered to."""
        assert self.link is not None
        return replace(self, corner_track=self.corner_track.seen_from(self.link.i_H_j))

    def keyframe(self, last: _Tracked | None) -> Keyframe:
        """Return the frame as a keyframe with the features on the floor only."""
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
        """Return the frame as an intermediate frame."""
        assert self.link is not None
        return IntermediateFrame(self.frame, self.link.i, self.link.i_H_j, self.link.corner_covariance)


class Tracker:
    """Select keyframes in one pass over the frames; ``rejected`` counts dropped frames by reason."""

    def __init__(
        self,
        camera: Camera,
        extractor: Extractor,
        homography: HomographyConfig,
        gates: GateConfig,
        config: KeyframeConfig,
        masks: Callable[[int], Image | None] = lambda frame: None,
    ) -> None:
        """``masks`` returns the mask of a frame number; 0 marks pixels to ignore."""
        self.camera, self.extractor = camera, extractor
        self.homography, self.gates, self.config, self.masks = homography, gates, config, masks
        self._corners = camera.undistort(camera.corners_px)
        self.rejected: Counter[str] = Counter()
        self.dropped: dict[int, str] = {}
        """Number of each dropped frame -> reason."""
        self.frames = 0
        self.moving: set[int] = set()
        """Frames with a motion other than that of the floor."""
        self.passed: list[IntermediateFrame] = []

    def keyframes(self, images: Iterable[Image | None]) -> Iterator[Keyframe]:
        """Yield keyframes in order of time."""
        number = -1
        last: _Tracked | None = None
        best: _Tracked | None = None
        failures = 0
        for frame, features in self._with_last_of_equal(self._seen(images)):
            if last is None:
                last, number = self._first(frame, features), number + 1
                yield last.keyframe(None)
                continue
            tracked, reason = self._track(number, frame, last, features, (best or last).corner_track)
            if best is not None and (tracked is None or self._overlap_is_small(tracked)):
                # The previous frame still overlapped enough: it becomes the keyframe.
                yield best.keyframe(last)
                last, number, best = best.as_last(), number + 1, None
                tracked, reason = self._track(number, frame, last, features, last.corner_track)
            elif best is not None:
                self.passed.append(best.passed())
            if tracked is None:
                self._drop(frame, reason)
                failures += 1
                if failures > self.config.patience:
                    self.rejected["tracking started anew"] += 1
                    last, number, failures = self._first(frame, features), number + 1, 0
                    yield last.keyframe(None)
                continue
            failures, best = 0, tracked
        if best is not None and last is not None:
            yield best.keyframe(last)

    def _with_last_of_equal(self, seen: Iterable[tuple[int, Features]]) -> Iterator[tuple[int, Features]]:
        """Yield the last picture too where all are equal: together with the first it shows the one place."""
        features: list[Features] = []
        for frame, extracted in seen:
            if len(features) < 2:
                features.append(extracted)
            yield frame, extracted
        equal = [frame for frame, reason in self.dropped.items() if reason == SAME_PICTURE]
        if len(features) == 1 and equal:
            del self.dropped[equal[-1]]
            self.rejected[SAME_PICTURE] -= 1
            yield equal[-1], features[0]

    def _drop(self, frame: int, reason: str) -> None:
        self.rejected[reason] += 1
        self.dropped[frame] = reason

    def _overlap_is_small(self, tracked: _Tracked) -> bool:
        assert tracked.link is not None
        # The floor's motion is identified surely only while most of the floor is in view: both motions count.
        return tracked.link.least_overlap < self.config.min_overlap

    def every(self, images: Iterable[Image | None]) -> Iterator[Keyframe]:
        """Yield each readable picture as a keyframe, linked to the previous one where the two overlap."""
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
        """Yield numbers and features of frames with enough features; count the others."""
        for frame, features in enumerate(self._extracted(images)):
            self.frames += 1
            if isinstance(features, str):
                self._drop(frame, features)
            elif len(features) < self.gates.min_inliers:
                self._drop(frame, "too few features")
            else:
                yield frame, features

    def _extracted(self, images: Iterable[Image | None]) -> Iterator[Features | str]:
        """Yield features of each frame, or the reason for having none; extraction runs ahead of matching."""
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
            # A frozen camera: time and position advance, the picture does not.
            return SAME_PICTURE
        return features

    def _track(
        self, number: int, frame: int, last: _Tracked, features: Features, corner_track: CornerTrack
    ) -> tuple[_Tracked | None, str]:
        """Register the frame to the last keyframe; return the reason where that fails."""
        link = register(
            number, number + 1, last.features, features, self.camera, self.homography, self.gates,
            corner_track.expected(frame),
        )  # fmt: skip
        if not link.ok:
            return None, link.reason
        if relative_change(link.i_H_j, self.camera) > self.gates.max_relative_change:
            return None, "change above gamma_2"
        on_floor = _on_floor(features, link, self.camera)
        if not on_floor.all():
            self.moving.add(frame)
        alone, width_px = len(link.elsewhere) == 0, self.camera.size_px[0]
        corner_track = corner_track.then(
            frame, transfer(link.i_H_j, self._corners), link.lead, alone, width_px
        )
        return _Tracked(frame, features, link, on_floor, corner_track), ""

    def _first(self, frame: int, features: Features) -> _Tracked:
        every = np.ones(len(features), dtype=bool)
        return _Tracked(frame, features, None, every, CornerTrack.begin(frame, self._corners))


def _on_floor(features: Features, link: Registration, camera: Camera) -> NDArray[np.bool_]:
    """Return (n,) whether a feature is on the floor: not in a cell where only another motion was matched."""
    if len(link.elsewhere) == 0:
        return np.ones(len(features), dtype=bool)
    cell = cells(features.pixel, camera.size_px)
    other = np.setdiff1d(cell[link.elsewhere], cell[link.matches[:, 1]])
    kept = ~np.isin(cell, other)
    kept[link.elsewhere] = False
    return kept
