"""Loader of pictures that a recording holds, as pixels or as encoded files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from slam.core.picture_content import KnowsContent
from slam.core.streams import Image
from slam.io.content_key import digest_with
from slam.io.images import decode_image
from slam.io.picture_headers import UnreadableImageError, check_encoded, check_size


@dataclass
class RecordedPictures:
    """Loader of picture k of a flight; the recording is asked for one picture at a time."""

    fetch: Callable[[int], Image | bytes]
    """Return a picture of the recording, or raise ``UnreadableImageError``."""
    index: NDArray[np.int64]
    """(n,) number in the recording of picture k of the flight."""
    size_px: tuple[int, int]
    """(width, height) that every picture must have."""
    picture_format: str
    """Format in which pixels are written into a flight folder: "png" or "jpg"."""
    failures: dict[int, str] = field(default_factory=dict)
    """Reason for each picture k that was requested and could not be read."""
    _lock: Lock = field(default_factory=Lock)

    def __call__(self, k: int) -> Image | None:
        """Return the pixels of picture k, or None with the reason in ``failures``."""
        stored = self.stored(k)
        if not isinstance(stored, bytes):
            return stored
        try:
            return decode_image(stored)
        except UnreadableImageError as reason:
            self.failures[k] = str(reason)
            return None

    def content_key(self, k: int) -> bytes | None:
        """Return a digest of what the recording holds of picture k; None where that is not known."""
        if not isinstance(self.fetch, KnowsContent):
            return None
        return digest_with(self.fetch.content_key(int(self.index[k])), self.size_px)

    def stored(self, k: int) -> Image | bytes | None:
        """Return picture k as the recording holds it, or None with the reason in ``failures``."""
        try:
            with self._lock:
                found = self.fetch(int(self.index[k]))
            if isinstance(found, bytes):
                check_encoded(found, self.size_px)
            else:
                check_size((found.shape[1], found.shape[0]), self.size_px)
            return found
        except UnreadableImageError as reason:
            self.failures[k] = str(reason)
            return None
