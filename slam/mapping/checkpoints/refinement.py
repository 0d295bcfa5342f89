"""Checkpoints of a refinement: the minima of its rounds."""

from __future__ import annotations

from backend.bundle.checkpoints import PlainMinimum, PlainValues
from slam.core.checkpoints import Checkpoints, recall_as
from slam.core.packing import digest_of, pack


class RefinementCheckpoints:
    """Minima by digests of what they are made of."""

    def __init__(self, checkpoints: Checkpoints) -> None:
        self._checkpoints = checkpoints
        self._is_told = False

    def recall(self, made_of: object) -> PlainMinimum | None:
        """Return a minimum; None where it is not known."""
        key = self._key(made_of)
        found = recall_as(PlainMinimum, self._checkpoints, "refine", key, (PlainValues,)) if key else None
        if found is not None and not self._is_told:
            self._is_told = True
            self._checkpoints.say("resumed: rounds of the refinement are known")
        return found

    def keep(self, made_of: object, found: PlainMinimum) -> None:
        """Keep a minimum."""
        if key := self._key(made_of):
            self._checkpoints.keep("refine", key, pack(found))

    def _key(self, made_of: object) -> bytes:
        """Return a digest; empty where nothing is kept, or where something is no plain data."""
        try:
            return digest_of(made_of) if self._checkpoints.are_kept else b""
        except TypeError:
            return b""
