"""Pictures of a flight, decoded ahead of their use."""

from __future__ import annotations

from collections.abc import Iterator

from frontend.workers import Workers
from slam.core.flight import Flight
from slam.core.progress import Progress
from slam.core.streams import Frames, Image


def read_ahead(flight: Flight, progress: Progress, first: int = 0) -> Iterator[Image | None]:
    """Pictures in order from a ``first`` one on, the next one decoded while the last is worked on."""
    assert flight.frames is not None
    total = len(flight.frames)
    for k, image in enumerate(Workers(1).map(_loaded, flight.frames, range(first, total), ahead=2), first):
        yield image
        progress("track", k + 1, total)


def _loaded(frames: Frames, k: int) -> Image | None:
    return frames.load(k)
