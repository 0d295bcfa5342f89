"""Content that is made already, written whole or not at all."""

from __future__ import annotations

from pathlib import Path

from slam.io.atomic import atomic_file


def write_whole(path: str | Path, content: bytes) -> None:
    """Put ``content`` at ``path`` in one step; until then an earlier file stays as it was.

    Raises ``InputError`` where the place cannot be written.
    """
    with atomic_file(path) as partial:
        partial.write_bytes(content)
