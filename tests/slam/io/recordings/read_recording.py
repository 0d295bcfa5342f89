"""A recording, read as the commands read it."""

from __future__ import annotations

from pathlib import Path

from slam.core.flight import Flight
from slam.io.recordings.assemble import flight_of
from slam.io.recordings.choice import Request
from slam.io.recordings.formats import open_recording


def read(path: Path, **topics: str) -> Flight:
    """Return the flight of a recording. ``topics``: stream -> channel that is taken for it."""
    return flight_of(open_recording(path), Request(topics))
