"""The state of tracking between two frames, as data with which another run goes on from there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frontend.corner_track import CornerTrack
from frontend.drift import Drift
from frontend.features import Features
from frontend.registration import Registration
from frontend.tracked import Matched, Tracked
from frontend.views import View


@dataclass(frozen=True)
class TrackedState:
    """A frame as tracking left it; its picture can be read again."""

    frame: int
    link: Registration | None
    corner_track: CornerTrack
    features: Features | None = None
    """Those of a frame that was matched by its features, else None."""
    on_floor: NDArray[np.bool_] | None = None

    @staticmethod
    def of(tracked: Tracked) -> TrackedState:
        """Return the state of a frame."""
        if isinstance(tracked, Matched):
            found = tracked.features, tracked.on_floor
            return TrackedState(tracked.frame, tracked.link, tracked.corner_track, *found)
        return TrackedState(tracked.frame, tracked.link, tracked.corner_track)

    def tracked(self, view_of: Callable[[int], View]) -> Tracked:
        """Return the frame; ``view_of`` gives the one view of each."""
        view = view_of(self.frame)
        if self.features is None or self.on_floor is None:
            return Tracked(view, self.link, self.corner_track)
        view.features = self.features
        return Matched(view, self.link, self.corner_track, self.on_floor)


@dataclass(frozen=True)
class Start:
    """The place where tracking begins: at the first frame, or behind the frames of an earlier run."""

    frame: int = 0
    number: int = -1
    """That of the last keyframe."""
    failures: int = 0
    """Frames in a row that were not registered."""
    last: Matched | None = None
    best: Tracked | None = None


@dataclass(frozen=True)
class TrackingState:
    """All that tracking knows before it looks at a frame."""

    frame: int
    """The frame that is looked at next; those before are not needed again, but for the ones below."""
    number: int
    """That of the last keyframe."""
    failures: int
    """Frames in a row that were not registered."""
    last: TrackedState
    """The last keyframe."""
    best: TrackedState | None
    """The last frame, where it still overlaps enough with the keyframe."""
    lines: tuple[tuple[int, Drift], ...] = ()
    """Frames that were followed by lines, with the drift at their times."""

    @staticmethod
    def of(
        frame: int,
        number: int,
        failures: int,
        last: Matched,
        best: Tracked | None,
        lines: tuple[tuple[int, Drift], ...],
    ) -> TrackingState:
        """Return the state before a frame."""
        kept = None if best is None else TrackedState.of(best)
        return TrackingState(frame, number, failures, TrackedState.of(last), kept, lines)

    def start(self, view_of: Callable[[int], View]) -> Start:
        """Return where tracking goes on; ``view_of`` gives the one view of each frame."""
        last = self.last.tracked(view_of)
        assert isinstance(last, Matched)
        best = None if self.best is None else self.best.tracked(view_of)
        return Start(self.frame, self.number, self.failures, last, best)
