"""Small tables of readings, and flights of them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from slam.core.flight import Flight


def table(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


def lines_with(flight: Flight, words: Iterable[str]) -> list[str]:
    """Return the warnings and notes that have all of some words."""
    return [line for line in flight.warnings if all(word in line for word in words)]
