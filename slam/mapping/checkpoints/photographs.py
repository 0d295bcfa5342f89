"""Checkpoints of photographs: what a search for features found, and the links of successive ones."""

from __future__ import annotations

from collections.abc import Callable

from frontend.camera import Camera
from frontend.features import FeatureConfig, Features
from frontend.photographs import SearchedPhotograph
from frontend.points import Points
from frontend.registration import Registration
from slam.core.checkpoints import Checkpoints, recall_as
from slam.core.packing import digest_of, pack
from slam.core.picture_content import content_key
from slam.core.streams import Frames, Image
from slam.mapping.checkpoints.registrations import RegistrationCheckpoints


class PhotographCheckpoints:
    """Features of photographs by the content of their files, and links of successive ones."""

    def __init__(
        self,
        checkpoints: Checkpoints,
        frames: Frames,
        camera: Camera,
        config: FeatureConfig,
        registrations: RegistrationCheckpoints,
    ) -> None:
        self._checkpoints, self._frames, self._registrations = checkpoints, frames, registrations
        self._settings = digest_of((camera, config)) if checkpoints.are_kept else b""
        self._keys: dict[int, bytes] = {}
        self._recalled = 0

    def recall(self, frame: int, mask: Image | None) -> SearchedPhotograph | None:
        """Return the result for a photograph with a mask; None where it is not known."""
        key = content_key(self._frames, frame) if self._checkpoints.are_kept else None
        if key is None:
            return None
        self._keys[frame] = digest_of((self._settings, key, mask))
        parts = Features, Points
        found = recall_as(SearchedPhotograph, self._checkpoints, "picture", self._keys[frame], parts)
        self._recalled += found is not None
        return found

    def keep(self, frame: int, found: SearchedPhotograph) -> None:
        """Keep the result for a photograph that was not known, with the mask that was asked for."""
        key = self._keys.pop(frame, None)
        if key is not None:
            self._checkpoints.keep("picture", key, pack(found))

    def link(
        self, number: int, before: Features, features: Features, work: Callable[[], Registration]
    ) -> Registration:
        """Return the link of two successive keyframes, the first of which has a number; by ``work`` where it
        is not known."""
        if not self._checkpoints.are_kept:
            return work()
        return self._registrations.by(number, number + 1, (before, features), work)

    def tell(self) -> None:
        """Say how many photographs an earlier run searched."""
        if self._recalled:
            total = len(self._frames)
            self._checkpoints.say(f"resumed: {self._recalled} of {total} photographs are searched")
