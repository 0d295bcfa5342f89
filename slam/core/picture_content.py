"""The content of a picture, told without decoding it."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from slam.core.streams import Frames


@runtime_checkable
class KnowsContent(Protocol):
    """A loader of pictures that can tell whether a picture has changed."""

    def content_key(self, k: int) -> bytes | None:
        """Return a digest of what picture k is made of; None where that is not known."""


def content_key(frames: Frames, k: int) -> bytes | None:
    """Return a digest of what picture k is made of; None where its loader does not know it."""
    return frames.load.content_key(k) if isinstance(frames.load, KnowsContent) else None
