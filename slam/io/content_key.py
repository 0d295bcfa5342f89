"""Digests of the content of files, by which a later run knows that a file is as it was."""

from __future__ import annotations

import os
from collections.abc import Iterable
from hashlib import blake2b
from pathlib import Path

from slam.core.packing import DIGEST_BYTES, digest_of

_WHOLE_BYTES = 1 << 26
"""A file up to this size is read as a whole, as pictures are. Of a video of gigabytes, parts are read."""
_PART_BYTES = 1 << 20


def file_key(path: Path) -> bytes | None:
    """Return a digest of a file; None where it cannot be read.

    Of a large file it is that of its size, of the time of its last change, and of parts of it.
    """
    found = blake2b(digest_size=DIGEST_BYTES)
    try:
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            if status.st_size <= _WHOLE_BYTES:
                found.update(file.read(_WHOLE_BYTES))
                return found.digest()
            found.update(f"{status.st_size} {status.st_mtime_ns}".encode())
            parts = _WHOLE_BYTES // _PART_BYTES
            for part in range(parts):
                file.seek((status.st_size - _PART_BYTES) * part // (parts - 1))
                found.update(file.read(_PART_BYTES))
        return found.digest()
    except OSError:
        return None


def source_key(paths: Iterable[Path]) -> bytes | None:
    """Return a digest of files, and of all files in folders; None where one cannot be read."""
    keys = [file_key(file) for path in paths for file in (_files(path) if path.is_dir() else [path])]
    return None if None in keys else digest_of(keys)


def _files(folder: Path) -> list[Path]:
    """Return the files in a folder: a pipe there would wait for its writer."""
    return [path for path in sorted(folder.rglob("*")) if path.is_file()]


def digest_with(key: bytes | None, *others: object) -> bytes | None:
    """Return a digest of a key and of further values; None without a key."""
    return None if key is None else digest_of((key, *others))
