"""Checkpoints of tracking, which goes on where an earlier run was killed.

A stretch of tracking is kept every few seconds: its keyframes, and the state behind it. Each stretch is found
by a digest of the one before, so that a chain of them belongs to one run of tracking.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from frontend.corner_track import CornerTrack
from frontend.drift import Drift, DriftModel
from frontend.features import Features
from frontend.motions import OtherMotion
from frontend.points import Points
from frontend.registration import Registration
from frontend.tracked import IntermediateFrame
from frontend.tracking_state import Start, TrackedState, TrackingState
from slam.core.checkpoints import Checkpoints, recall_as
from slam.core.flight import Flight
from slam.core.packing import digest_of, pack
from slam.core.picture_content import content_key
from slam.core.streams import STREAMS
from slam.mapping.checkpoints.registrations import PARTS
from slam.mapping.tracked_pictures import TrackedPictures

EVERY_S = 15.0
"""Time between two stretches: a kill costs as much. A stretch of 320 x 240 pixels takes 0.1 s to keep."""


@dataclass(frozen=True)
class Stretch:
    """Results of tracking between two frames."""

    begin: int
    """First frame."""
    end: int
    """The frame behind the last one."""
    pictures: bytes
    """Digest of the content of its pictures."""
    features: tuple[Features, ...]
    """Those of the new keyframes."""
    frame_index: tuple[int, ...]
    links: tuple[Registration | None, ...]
    refused: tuple[Registration, ...]
    passed: tuple[IntermediateFrame, ...]
    dropped: dict[int, str]
    unreadable: dict[int, str]
    """Frames that could not be read, with the reason."""
    moving: dict[int, OtherMotion]
    rejected: dict[str, int]
    """Number of dropped frames by the reason, from the first frame on."""
    state: TrackingState | None
    """None behind the last frame."""


_PARTS = (
    TrackingState, TrackedState, CornerTrack, Drift, DriftModel, Features, Points, IntermediateFrame,
    Registration, *PARTS,
)  # fmt: skip
"""Classes that a stretch may hold."""


@dataclass
class _Done:
    """How much of the tracking is kept."""

    frame: int = 0
    keyframes: int = 0
    refused: int = 0
    passed: int = 0
    dropped: int = 0

    @staticmethod
    def of(tracked: TrackedPictures, frame: int) -> _Done:
        tracker = tracked.tracker
        counts = len(tracked.frame_index), len(tracked.refused), len(tracker.passed), len(tracker.dropped)
        return _Done(frame, *counts)


class TrackingCheckpoints:
    """The stretches of one pass over the frames of a flight."""

    def __init__(self, checkpoints: Checkpoints, flight: Flight, settings: object) -> None:
        """``settings``: camera and settings that tracking depends on, beside the flight's readings."""
        assert flight.frames is not None
        self._checkpoints, self._frames = checkpoints, flight.frames
        self._key: bytes | None = None
        """Key of the next stretch; None where none is kept."""
        if checkpoints.are_kept:
            readings = [getattr(flight, name) for name in STREAMS if name != "frames"]
            self._key = digest_of((settings, flight.frames.stamps_s, flight.frames.names, readings))
        self._moving: set[int] = set()
        self._done = _Done()
        self._kept_s = time.monotonic()

    def resume(self, empty: Callable[[], TrackedPictures]) -> tuple[TrackedPictures, Start | None]:
        """Return what an earlier run tracked, and where to go on; None where that was all."""
        tracked, state = empty(), None
        while self._key is not None and (stretch := self._next(self._key)) is not None:
            self._restore(stretch, tracked)
            state = stretch.state
            if state is None:
                self._tell(tracked, "all")
                return tracked, None
        if state is None:
            return tracked, Start()
        try:
            start = tracked.tracker.resumed(state, self._frames.load)
        except LookupError:  # a picture can no longer be read
            self._key = None
            return empty(), Start()
        self._tell(tracked, f"the first {state.frame}")
        return tracked, start

    def offer(self, tracked: TrackedPictures, state: Callable[[], TrackingState]) -> None:
        """Keep what was tracked, if that is due."""
        if self._key is not None and time.monotonic() - self._kept_s > EVERY_S:
            at = state()
            self._keep(tracked, at.frame, at)

    def end(self, tracked: TrackedPictures) -> None:
        """Keep what was tracked to the end."""
        if self._key is not None:
            self._keep(tracked, len(self._frames), None)

    def _tell(self, tracked: TrackedPictures, part: str) -> None:
        total, n = len(self._frames), len(tracked.frame_index)
        self._checkpoints.say(f"resumed: {part} of {total} pictures are tracked, with {n} keyframes")

    def _next(self, key: bytes) -> Stretch | None:
        """Return the stretch behind what is restored, if its pictures are as they were."""
        stretch = recall_as(Stretch, self._checkpoints, "track", key, _PARTS)
        if stretch is None:
            return None
        if stretch.pictures != self._content(stretch.begin, stretch.end, stretch.unreadable):
            self._checkpoints.say(f"pictures behind number {stretch.begin} have changed: tracked again")
            return None
        self._key = digest_of(stretch)
        return stretch

    def _restore(self, stretch: Stretch, tracked: TrackedPictures) -> None:
        tracker = tracked.tracker
        for features in stretch.features:
            tracked.store.append(features)
        tracked.frame_index += stretch.frame_index
        tracked.links += stretch.links
        tracked.refused += stretch.refused
        tracked.unreadable |= stretch.unreadable
        tracker.passed += stretch.passed
        tracker.dropped |= stretch.dropped
        tracker.moving |= stretch.moving
        tracker.rejected = Counter(stretch.rejected)
        tracker.frames = stretch.end
        self._moving = {*tracker.moving}
        self._done = _Done.of(tracked, stretch.end)

    def _keep(self, tracked: TrackedPictures, frame: int, state: TrackingState | None) -> None:
        assert self._key is not None
        tracker, done = tracked.tracker, self._done
        dropped = dict(list(tracker.dropped.items())[done.dropped :])
        unreadable = {k: why for k, why in self._frames.failures.items() if done.frame <= k < frame}
        moving = {k: other for k, other in tracker.moving.items() if k not in self._moving}
        pictures = self._content(done.frame, frame, unreadable)
        if pictures is None:
            self._key = None
            return
        new = range(done.keyframes, len(tracked.frame_index))
        stretch = Stretch(
            begin=done.frame, end=frame, pictures=pictures,
            features=tuple(tracked.store[k] for k in new),
            frame_index=tuple(tracked.frame_index[done.keyframes :]),
            links=tuple(tracked.links[done.keyframes :]), refused=tuple(tracked.refused[done.refused :]),
            passed=tuple(tracker.passed[done.passed :]), dropped=dropped, unreadable=unreadable,
            moving=moving, rejected=dict(tracker.rejected), state=state,
        )  # fmt: skip
        self._checkpoints.keep("track", self._key, pack(stretch))
        self._key = digest_of(stretch)
        self._moving, self._done = {*tracker.moving}, _Done.of(tracked, frame)
        self._kept_s = time.monotonic()

    def _content(self, begin: int, end: int, unreadable: Mapping[int, str]) -> bytes | None:
        """Return a digest of the content of pictures; None where that of one is not known that was read."""
        keys = [content_key(self._frames, k) for k in range(begin, end)]
        is_known = all(key is not None or k in unreadable for k, key in enumerate(keys, begin))
        return digest_of(keys) if is_known else None
