"""Registrations of pairs that an earlier run compared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from backend.measurements import LinkCheck, Rejection
from frontend.camera import Camera
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig
from frontend.registration import Registration
from slam.core.checkpoints import Checkpoints, recall_as
from slam.core.packing import digest_of, pack

PARTS = (Rejection, LinkCheck)
"""Classes that a registration may hold."""


class KeptRegistrations:
    """Registrations by digests of what they were made of."""

    def __init__(
        self, checkpoints: Checkpoints, camera: Camera, homography: HomographyConfig, gates: GateConfig
    ) -> None:
        self._checkpoints = checkpoints
        self._settings = digest_of((camera, homography, gates)) if checkpoints.are_kept else b""
        self.recalled = 0
        """Registrations that were recalled since the user was told."""

    def recall(self, i: int, j: int, made_of: object) -> Registration | None:
        """Return the registration of keyframe j to i; None where it is not known.

        ``made_of``: features of both keyframes, and the place that is expected, or digests of these.
        """
        if not self._checkpoints.are_kept:
            return None
        found = recall_as(Registration, self._checkpoints, "pair", self._key(made_of), PARTS)
        if found is None:
            return None
        self.recalled += 1
        return replace(found, i=i, j=j)

    def keep(self, registration: Registration, made_of: object) -> None:
        """Keep a registration; ``made_of`` as in `recall`."""
        if self._checkpoints.are_kept:
            self._checkpoints.keep("pair", self._key(made_of), pack(registration))

    def by(self, i: int, j: int, made_of: object, work: Callable[[], Registration]) -> Registration:
        """Return the registration of keyframe j to i, by ``work`` where it is not known."""
        found = self.recall(i, j, made_of)
        if found is None:
            found = work()
            self.keep(found, made_of)
        return found

    def tell(self, total: int) -> None:
        """Say how many of so many registrations were recalled since the last time."""
        if self.recalled:
            self._checkpoints.say(f"resumed: {self.recalled} of {total} pairs of pictures are compared")
        self.recalled = 0

    def _key(self, made_of: object) -> bytes:
        return digest_of((self._settings, made_of))
