"""Tracking: register each frame to the last keyframe; create a keyframe when their overlap becomes small.

Optical flow follows the pictures between keyframes. Features are matched where it does not settle the motion.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.corner_track import CornerTrack, expectations
from frontend.features import Extractor, Features
from frontend.flow import FlowTemplate
from frontend.gates import GateConfig, relative_change
from frontend.homography import HomographyConfig, transfer
from frontend.line_tracking import InstrumentMotion, LineTracker
from frontend.masking import unless_hidden
from frontend.motions import MOST_LEAD, Expectation, OtherMotion
from frontend.photographs import NO_SEARCH_CHECKPOINTS, Photograph, SearchCheckpoints, photographs
from frontend.registration import Registration, register
from frontend.tracked import IntermediateFrame, Keyframe, Matched, Tracked, on_floor
from frontend.tracking_state import Start, TrackingState
from frontend.views import SAME_PICTURE, Load, Masks, View, Views

Image = NDArray[np.uint8]
Picture = TypeVar("Picture", View, Photograph)

TOO_FEW = "too few features"
NOT_ALIGNED = "too few features, and its lines align with no other"
IsUrged = Callable[[Future[Features]], bool]
"""Function of the features of a keyframe that are being extracted; see `Tracker`."""
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
        is_urged: IsUrged = lambda features: False,
        motion: InstrumentMotion | None = None,
        by_instruments: bool = False,
    ) -> None:
        """``masks`` returns the mask of a frame number; 0 marks pixels to ignore. ``known`` returns the
        features of its whole picture, if they were extracted before. ``look_ahead``: see `Views`.
        ``is_urged`` waits for the features of a keyframe, and returns whether a picture waits before they are
        there: it is then followed from the keyframe before. ``by_instruments``: expect the floor where
        ``motion`` has it, instead of at constant velocity."""
        self.camera, self.extractor = camera, extractor
        self.homography, self.gates, self.config = homography, gates, config
        self._masks, self._known, self._is_urged = masks, known, is_urged
        self._corners = camera.undistort(camera.corners_px)
        at_once = extractor.config.searched_at_once(camera.size_px)
        self._views, self._unsettled = Views(self._extract, masks, camera.size_px, at_once, look_ahead), 0
        self._template: tuple[int, FlowTemplate] | None = None
        self._lines = LineTracker(camera, homography, gates, motion) if motion else None
        self.rejected: Counter[str] = Counter()
        self.dropped: dict[int, str] = {}
        """Number of each dropped frame -> reason."""
        self.frames = 0
        self._expected = expectations(motion if by_instruments else None, self._corners)
        self.moving: dict[int, OtherMotion] = {}
        """Frames with a motion other than that of the floor."""
        self.passed: list[IntermediateFrame] = []
        self.newest: IntermediateFrame | None = None
        """The newest frame that is registered to a keyframe."""

    def keyframes(
        self,
        images: Iterable[Image | None],
        start: Start = Start(),
        on_state: Callable[[Callable[[], TrackingState]], None] = lambda state: None,
    ) -> Iterator[Keyframe]:
        """Yield keyframes in order of time.

        ``images`` are those from the frame of the ``start`` on. ``on_state`` is told before each frame how to
        ask for the state there.
        """
        number, failures, last, best = start.number, start.failures, start.last, start.best
        coming: Tracked | None = None  # the next keyframe, while its features are extracted
        usable = self._usable(self._views.each(images, start.frame))
        views = self._with_last_of_equal(usable) if last is None else usable
        for view in chain(views, [None]):  # None: the flight ends
            if view is not None and last is not None and coming is None:
                lines = self._lines.state if self._lines else ()
                on_state(partial(TrackingState.of, view.frame, number, failures, last, best, lines))
            if last is None:
                if view is not None and (self._shows_lines(view) or self._has_features(view)):
                    last, number = self._first(view), number + 1
                    yield last.keyframe(None)
                continue
            if coming is not None and best is not None:
                followed = None
                if view is not None and not coming.view.has_features:
                    followed = self._by_flow(number, view, last, best.corner_track)
                if followed is not None:
                    self.passed.append(best.passed())
                    best, self.newest = followed, followed.passed()
                    continue
                settled, coming = self._settled(number, coming, last), None
                if settled is not None:
                    yield settled.keyframe(last)
                    best = best.seen_from(settled)
                    last, number = settled.as_last(), number + 1
            if view is None:
                break
            tracked, reason = self._track(number, view, last, (best or last).corner_track)
            if reason == TOO_FEW:
                self._drop(view.frame, reason)
                continue
            if best is not None and (tracked is None or self._overlap_is_small(tracked)):
                # The previous frame still overlapped enough: it becomes the keyframe.
                if tracked is not None and self._follow_on(best, tracked):
                    coming, best, self.newest, failures = best, tracked, tracked.passed(), 0
                    continue
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

    def resumed(self, state: TrackingState, load: Load) -> Start:
        """Return where tracking goes on from a state; ``load`` reads the pictures that it needs."""
        view_of = self._views.read_again(load)
        if self._lines is not None:
            self._lines.resume(state.lines, view_of)
        return state.start(view_of)

    def every(
        self, load: Load, count: int, checkpoints: SearchCheckpoints = NO_SEARCH_CHECKPOINTS
    ) -> Iterator[Keyframe]:
        """Yield each readable photograph as a keyframe, linked to the previous one where the two overlap.

        ``load`` returns the picture of each of ``count`` frames, or None; several are read at a time.
        """
        number = -1
        before: Features | None = None
        each = photographs(load, count, self.extractor, self.camera, self._masks, self._known, checkpoints)
        for photograph in self._usable(each):
            if not self._has_features(photograph):
                continue
            link, features = None, photograph.features
            if before is not None:
                link = checkpoints.link(number, before, features, partial(
                    register, number, number + 1, before, features, self.camera, self.homography, self.gates
                ))  # fmt: skip
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

    def _overlap_is_small(self, tracked: Tracked) -> bool:
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

    def _shows_lines(self, view: View) -> bool:
        """Return whether a picture with few features can be aligned by the lines that it shows."""
        return self._lines is not None and self._lines.template(view) is not None

    def _track(
        self, number: int, view: View, last: Matched, corner_track: CornerTrack
    ) -> tuple[Tracked | None, str]:
        """Register the picture to the last keyframe by flow, else by features; return the reason where that
        fails."""
        followed = self._by_flow(number, view, last, corner_track)
        if followed is not None:
            return followed, ""
        self._unsettled += 1
        self._views.ahead = self._unsettled > ONCE
        if len(view.features) < self.gates.min_inliers:
            link, reason = None, TOO_FEW
        else:
            link, reason = self._matched(number, view, last, self._expected(corner_track, view.frame))
        if link is None:
            aligned = self._aligned(number, view, last, corner_track)
            return aligned, NOT_ALIGNED if reason == TOO_FEW and self._shows_lines(view) else reason
        here = on_floor(view.features, link, self.camera)
        return Matched(view, link, self._continued(corner_track, view, link), here), ""

    def _by_flow(self, number: int, view: View, last: Matched, corner_track: CornerTrack) -> Tracked | None:
        """Register the picture to the last keyframe by flow; None where that does not settle it."""
        expected = self._expected(corner_track, view.frame)
        if not self.config.flow or expected is None:
            return None
        link = self._template_of(last).register(
            number, number + 1, view.image, view.mask, expected, self.homography, self.gates
        )
        if link is None or self._changes_too_much(link):
            return None
        self._unsettled, self._views.ahead = 0, False
        return Tracked(view, link, self._continued(corner_track, view, link))

    def _aligned(self, number: int, view: View, last: Matched, corner_track: CornerTrack) -> Matched | None:
        """Register the picture to the last keyframe by the lines that both show, where features are few."""
        found = self._lines.register(number, view, last.view, corner_track) if self._lines else None
        if found is None or self._changes_too_much(found[0]):
            return None
        return Matched(view, *found, np.ones(len(view.features), dtype=bool))

    def _follow_on(self, coming: Tracked, tracked: Tracked) -> bool:
        """Begin with the features of the next keyframe, and return whether the next picture should be
        followed from the keyframe before, as ``tracked``: it waits already."""
        if isinstance(coming, Matched) or isinstance(tracked, Matched):
            return False
        return self._is_urged(self._views.extract(coming.view))

    def _settled(self, number: int, tracked: Tracked, last: Matched) -> Matched | None:
        """Return the picture as registered by its features; None where that fails: it is dropped."""
        if isinstance(tracked, Matched):
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
        return Matched(
            view, link, corner_track.corrected(transfer(link.i_H_j, self._corners)),
            on_floor(view.features, link, self.camera),
        )  # fmt: skip

    def _matched(
        self, number: int, view: View, last: Matched, expected: Expectation | None
    ) -> tuple[Registration | None, str]:
        """Register the picture to the last keyframe by features; return the reason where that fails."""
        link = register(
            number, number + 1, last.features, view.features, self.camera, self.homography, self.gates,
            expected,
        )  # fmt: skip
        if not link.ok:
            return None, str(link.reason)
        if self._changes_too_much(link):
            return None, "change above gamma_2"
        if link.other is not None:
            self.moving[view.frame] = link.other
        return link, ""

    def _changes_too_much(self, link: Registration) -> bool:
        return relative_change(link.i_H_j, self.camera) > self.gates.max_relative_change

    def _continued(self, corner_track: CornerTrack, view: View, link: Registration) -> CornerTrack:
        corners_px, alone = transfer(link.i_H_j, self._corners), len(link.elsewhere) == 0
        return corner_track.then(view.frame, corners_px, link.lead, alone, self.camera.size_px[0])

    def _template_of(self, last: Matched) -> FlowTemplate:
        if self._template is None or self._template[0] != last.frame:
            self._template = last.frame, FlowTemplate.of(last.view.image, last.features, self.camera)
        return self._template[1]

    def _first(self, view: View) -> Matched:
        if self._lines is not None:
            self._lines.begin(view)
        every = np.ones(len(view.features), dtype=bool)
        return Matched(view, None, CornerTrack.begin(view.frame, self._corners), every)
