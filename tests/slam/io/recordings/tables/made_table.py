"""Small tables of readings, and flights of them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from slam.core.flight import Flight
from slam.io.recordings.assemble import flight_of
from slam.io.recordings.choice import Request
from slam.io.recordings.formats import open_recording


def read(path: Path, **topics: str) -> Flight:
    return flight_of(open_recording(path), Request(topics))


def table(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


def lines_with(flight: Flight, words: Iterable[str]) -> list[str]:
    """Return the warnings and notes that have all of some words."""
    return [line for line in flight.warnings if all(word in line for word in words)]
