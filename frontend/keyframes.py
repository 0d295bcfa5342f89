"""Tracking: register each frame to the last keyframe; create a keyframe when their overlap becomes small.

Optical flow follows the pictures between keyframes. Features are matched where it does not settle the motion.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.cells import cells
from frontend.corner_track import CornerTrack
from frontend.features import Extractor, Features
from frontend.flow import FlowTemplate
from frontend.gates import GateConfig, relative_change
from frontend.homography import HomographyConfig, transfer
from frontend.masking import unless_hidden
from frontend.motions import MOST_LEAD, Expectation
from frontend.photographs import Photograph, photographs
from frontend.registration import Registration, register
from frontend.views import SAME_PICTURE, Load, Masks, View, Views

Image = NDArray[np.uint8]
Picture = TypeVar("Picture", View, Photograph)

TOO_FEW = "too few features"
ONCE = 1
"""After more pictures in a row that needed features, those of the next ones are extracted ahead."""


@dataclass(frozen=True)
class KeyframeConfig:
    """Parameters of keyframe selection."""

    min_overlap: float = 0.75
    """A new keyframe is created where the overlap with the last one is less than this."""
    patience: int = 5
    """Consecutive frames that may fail before tracking restarts without a link."""
    flow: bool = True
    """Whether optical flow follows the pictures between keyframes; else each is matched by its features."""


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
    image: Image | None = None
    """Its picture, where frames are tracked."""


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
    """A picture that is registered to the last keyframe."""

    view: View
    link: Registration | None
    corner_track: CornerTrack
    """Corners of this frame and of the previous one in the picture of the last keyframe."""

    @property
    def frame(self) -> int:
        return self.view.frame

    def passed(self) -> IntermediateFrame:
        """Return the frame as an intermediate frame."""
        assert self.link is not None
        return IntermediateFrame(self.frame, self.link.i, self.link.i_H_j, self.link.corner_covariance)


@dataclass(frozen=True)
class _Matched(_Tracked):
    """A picture that is registered by its features, those on moving objects included: the next frame needs
    them to separate the objects from the floor."""

    on_floor: NDArray[np.bool_]
    """(n,) whether each feature belongs to the floor and enters the map."""

    @property
    def features(self) -> Features:
        return self.view.features

    def as_last(self) -> _Matched:
        """Return the frame as the keyframe that later frames are registered to."""
        assert self.link is not None
        return replace(self, corner_track=self.corner_track.seen_from(self.link.i_H_j))

    def keyframe(self, last: _Matched | None) -> Keyframe:
        """Return the frame as a keyframe with the features on the floor only."""
        features, link = self.features, self.link
        if link is not None and last is not None and not (self.on_floor.all() and last.on_floor.all()):
            i, j = link.matches.T
            kept = last.on_floor[i] & self.on_floor[j]
            number_i, number_j = np.cumsum(last.on_floor) - 1, np.cumsum(self.on_floor) - 1
            matches = np.column_stack([number_i[i[kept]], number_j[j[kept]]])
            link = replace(link, matches=matches.astype(i.dtype), elsewhere=link.elsewhere[:0])
        on_floor = features if self.on_floor.all() else features[self.on_floor]
        return Keyframe(self.frame, on_floor, link, image=self.view.image)


class Tracker:
    """Select keyframes in one pass over the frames; ``rejected`` counts dropped frames by reason."""

    def __init__(
        self,
        camera: Camera,
        extractor: Extractor,
        homography: HomographyConfig,
        gates: GateConfig,
        config: KeyframeConfig,
        masks: Masks = lambda frame: None,
        known: Callable[[int], Features | None] = lambda frame: None,
        look_ahead: bool = True,
    ) -> None:
        """``masks`` returns the mask of a frame number; 0 marks pixels to ignore. ``known`` returns the
        features of its whole picture, if they were extracted before. ``look_ahead``: see `Views`."""
        self.camera, self.extractor = camera, extractor
        self.homography, self.gates, self.config = homography, gates, config
        self._masks, self._known = masks, known
        self._corners = camera.undistort(camera.corners_px)
        at_once = extractor.config.searched_at_once(camera.size_px)
        self._views, self._unsettled = Views(self._extract, masks, camera.size_px, at_once, look_ahead), 0
        self._template: tuple[int, FlowTemplate] | None = None
        self.rejected: Counter[str] = Counter()
        self.dropped: dict[int, str] = {}
        """Number of each dropped frame -> reason."""
        self.frames = 0
        self.moving: set[int] = set()
        """Frames with a motion other than that of the floor."""
        self.passed: list[IntermediateFrame] = []
        self.newest: IntermediateFrame | None = None
        """The newest frame that is registered to a keyframe."""

    def keyframes(self, images: Iterable[Image | None]) -> Iterator[Keyframe]:
        """Yield keyframes in order of time."""
        number, failures = -1, 0
        last: _Matched | None = None
        best: _Tracked | None = None
        for view in self._with_last_of_equal(self._usable(self._views.each(images))):
            if last is None:
                if self._has_features(view):
                    last, number = self._first(view), number + 1
                    yield last.keyframe(None)
                continue
            tracked, reason = self._track(number, view, last, (best or last).corner_track)
            if reason == TOO_FEW:
                self._drop(view.frame, reason)
                continue
            if best is not None and (tracked is None or self._overlap_is_small(tracked)):
                # The previous frame still overlapped enough: it becomes the keyframe.
                settled = self._settled(number, best, last)
                if settled is not None:
                    yield settled.keyframe(last)
                    last, number = settled.as_last(), number + 1
                    tracked, reason = self._track(number, view, last, last.corner_track)
                best = None
            elif best is not None:
                self.passed.append(best.passed())
            if tracked is None:
                self._drop(view.frame, reason)
                failures += 1
                if failures > self.config.patience:
                    self.rejected["tracking started anew"] += 1
                    last, number, failures = self._first(view), number + 1, 0
                    yield last.keyframe(None)
                continue
            failures, best, self.newest = 0, tracked, tracked.passed()
        if best is not None and last is not None:
            settled = self._settled(number, best, last)
            if settled is not None:
                yield settled.keyframe(last)

    def every(self, load: Load, count: int) -> Iterator[Keyframe]:
        """Yield each readable photograph as a keyframe, linked to the previous one where the two overlap.

        ``load`` returns the picture of each of ``count`` frames, or None; several are read at a time.
        """
        number = -1
        before: Features | None = None
        each = photographs(load, count, self.extractor, self.camera, self._masks, self._known)
        for photograph in self._usable(each):
            if not self._has_features(photograph):
                continue
            link, features = None, photograph.features
            if before is not None:
                link = register(
                    number, number + 1, before, features, self.camera, self.homography, self.gates
                )
            number, before = number + 1, features
            link, refused = (link, None) if link is None or link.ok else (None, link)
            yield Keyframe(photograph.frame, features, link, refused)

    def _with_last_of_equal(self, usable: Iterable[View]) -> Iterator[View]:
        """Yield the last picture too where all are equal: together with the first it shows the one place."""
        views: list[View] = []
        for view in usable:
            if len(views) < 2:
                views.append(view)
            yield view
        equal = [frame for frame, reason in self.dropped.items() if reason == SAME_PICTURE]
        if len(views) == 1 and equal:
            del self.dropped[equal[-1]]
            self.rejected[SAME_PICTURE] -= 1
            yield views[0].repeated(equal[-1])

    def _drop(self, frame: int, reason: str) -> None:
        self.rejected[reason] += 1
        self.dropped[frame] = reason

    def _overlap_is_small(self, tracked: _Tracked) -> bool:
        assert tracked.link is not None
        # The floor's motion is identified surely only while most of the floor is in view: both motions count.
        return tracked.link.least_overlap < self.config.min_overlap

    def _usable(self, each: Iterable[tuple[int, Picture | str]]) -> Iterator[Picture]:
        """Yield the pictures that can be searched for features; count the others."""
        readable = -1
        for frame, picture in each:
            self.frames += 1
            if isinstance(picture, str):
                # A picture without features says so each time it is repeated.
                repeated_blank = picture == SAME_PICTURE and self.dropped.get(readable) == TOO_FEW
                self._drop(frame, TOO_FEW if repeated_blank else picture)
            else:
                readable = frame
                yield picture

    def _extract(self, view: View) -> Features:
        known = unless_hidden(self._known(view.frame), view.mask, self.camera)
        return self.extractor(view.image, self.camera, view.mask) if known is None else known

    def _has_features(self, picture: View | Photograph) -> bool:
        """Return whether a picture has enough features; count it as dropped if it has not."""
        if len(picture.features) >= self.gates.min_inliers:
            return True
        self._drop(picture.frame, TOO_FEW)
        return False

    def _track(
        self, number: int, view: View, last: _Matched, corner_track: CornerTrack
    ) -> tuple[_Tracked | None, str]:
        """Register the picture to the last keyframe by flow, else by features; return the reason where that
        fails."""
        expected = corner_track.expected(view.frame)
        if self.config.flow and expected is not None:
            link = self._template_of(last).register(
                number, number + 1, view.image, view.mask, expected, self.homography, self.gates
            )
            if link is not None and not self._changes_too_much(link):
                self._unsettled, self._views.ahead = 0, False
                return _Tracked(view, link, self._continued(corner_track, view, link)), ""
        self._unsettled += 1
        self._views.ahead = self._unsettled > ONCE
        if len(view.features) < self.gates.min_inliers:
            return None, TOO_FEW
        link, reason = self._matched(number, view, last, expected)
        if link is None:
            return None, reason
        on_floor = _on_floor(view.features, link, self.camera)
        return _Matched(view, link, self._continued(corner_track, view, link), on_floor), ""

    def _settled(self, number: int, tracked: _Tracked, last: _Matched) -> _Matched | None:
        """Return the picture as registered by its features; None where that fails: it is dropped."""
        if isinstance(tracked, _Matched):
            return tracked
        view, corner_track = tracked.view, tracked.corner_track
        if not self._has_features(view):
            return None
        # The flow has followed the floor from the keyframe to here: no copy of it and no other motion counts.
        expected = Expectation(corner_track.corners_px[-1], MOST_LEAD)
        link, reason = self._matched(number, view, last, expected)
        if link is None:
            self._drop(view.frame, reason)
            return None
        return _Matched(
            view, link, corner_track.corrected(transfer(link.i_H_j, self._corners)),
            _on_floor(view.features, link, self.camera),
        )  # fmt: skip

    def _matched(
        self, number: int, view: View, last: _Matched, expected: Expectation | None
    ) -> tuple[Registration | None, str]:
        """Register the picture to the last keyframe by features; return the reason where that fails."""
        link = register(
            number, number + 1, last.features, view.features, self.camera, self.homography, self.gates,
            expected,
        )  # fmt: skip
        if not link.ok:
            return None, link.reason
        if self._changes_too_much(link):
            return None, "change above gamma_2"
        if len(link.elsewhere):
            self.moving.add(view.frame)
        return link, ""

    def _changes_too_much(self, link: Registration) -> bool:
        return relative_change(link.i_H_j, self.camera) > self.gates.max_relative_change

    def _continued(self, corner_track: CornerTrack, view: View, link: Registration) -> CornerTrack:
        corners_px, alone = transfer(link.i_H_j, self._corners), len(link.elsewhere) == 0
        return corner_track.then(view.frame, corners_px, link.lead, alone, self.camera.size_px[0])

    def _template_of(self, last: _Matched) -> FlowTemplate:
        if self._template is None or self._template[0] != last.frame:
            self._template = last.frame, FlowTemplate.of(last.view.image, last.features, self.camera)
        return self._template[1]

    def _first(self, view: View) -> _Matched:
        every = np.ones(len(view.features), dtype=bool)
        return _Matched(view, None, CornerTrack.begin(view.frame, self._corners), every)


def _on_floor(features: Features, link: Registration, camera: Camera) -> NDArray[np.bool_]:
    """Return (n,) whether a feature is on the floor: not in a cell where only another motion was matched."""
    if len(link.elsewhere) == 0:
        return np.ones(len(features), dtype=bool)
    cell = cells(features.pixel, camera.size_px)
    other = np.setdiff1d(cell[link.elsewhere], cell[link.matches[:, 1]])
    kept = ~np.isin(cell, other)
    kept[link.elsewhere] = False
    return kept
