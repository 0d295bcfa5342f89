"""Results of one pass over the frames so far."""

from __future__ import annotations

from frontend.keyframes import Tracker
from frontend.registration import Registration
from frontend.store import FeatureStore
from frontend.tracked import Keyframe


class TrackedPictures:
    """The result of one pass over the frames: keyframes, in the order in which the tracker yields them."""

    def __init__(self, tracker: Tracker) -> None:
        self.tracker, self.store = tracker, FeatureStore()
        self.frame_index: list[int] = []
        self.links: list[Registration | None] = []
        self.refused: list[Registration] = []
        self.failures: dict[int, str] = {}
        """Frames that no picture was given for, with the reason."""
        self.unreadable: dict[int, str] = {}
        """Frames that an earlier run could not read, with the reason."""

    def add(self, keyframe: Keyframe) -> None:
        """Keep the next keyframe."""
        self.store.append(keyframe.features)
        self.frame_index.append(keyframe.frame)
        self.links.append(keyframe.link)
        self.refused += [keyframe.refused] if keyframe.refused is not None else []
