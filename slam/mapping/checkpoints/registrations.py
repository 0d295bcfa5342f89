"""Checkpoints of registrations: the comparisons of pairs of pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from backend.measurements import LinkCheck, Rejection
from frontend.camera import Camera
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig
from frontend.motions import OtherMotion
from frontend.registration import Registration
from slam.core.checkpoints import Checkpoints, recall_as
from slam.core.packing import digest_of, pack

PARTS = (Rejection, LinkCheck, OtherMotion)
"""Classes that a registration may hold."""


class RegistrationCheckpoints:
    """Registrations by digests of what they were made of."""

    def __init__(
        self, checkpoints: Checkpoints, camera: Camera, homography: HomographyConfig, gates: GateConfig
    ) -> None:
        self._checkpoints = checkpoints
        self._settings = digest_of((camera, homography, gates)) if checkpoints.are_kept else b""

    def recall(
        self, made_of: Mapping[tuple[int, int], object], total: int
    ) -> dict[tuple[int, int], Registration]:
        """Return the known registrations of pairs (i, j), and say how many of a ``total`` of pairs they are.

        ``made_of``: features of both keyframes, and the place that is expected, or digests of these.
        """
        each = {(i, j): self._recall(i, j, made) for (i, j), made in made_of.items()}
        found = {pair: registration for pair, registration in each.items() if registration is not None}
        if found:
            self._checkpoints.say(f"resumed: {len(found)} of {total} pairs of pictures are compared")
        return found

    def keep(self, registration: Registration, made_of: object) -> None:
        """Keep a registration; ``made_of`` as in `recall`."""
        if self._checkpoints.are_kept:
            self._checkpoints.keep("pair", self._key(made_of), pack(registration))

    def by(self, i: int, j: int, made_of: object, work: Callable[[], Registration]) -> Registration:
        """Return the registration of keyframe j to i, by ``work`` where it is not known."""
        found = self._recall(i, j, made_of)
        if found is None:
            found = work()
            self.keep(found, made_of)
        return found

    def _recall(self, i: int, j: int, made_of: object) -> Registration | None:
        if not self._checkpoints.are_kept:
            return None
        found = recall_as(Registration, self._checkpoints, "pair", self._key(made_of), PARTS)
        return None if found is None else replace(found, i=i, j=j)

    def _key(self, made_of: object) -> bytes:
        return digest_of((self._settings, made_of))
