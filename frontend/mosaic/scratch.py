"""Pictures of a mosaic on disk, as they are drawn: each file is decoded once, and not in each stage."""

from __future__ import annotations

import os
import shutil
import tempfile
import weakref
from threading import Lock
from typing import IO

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

FREE_SHARE = 0.25
"""Share of the free disk that is used at most: the files of the mosaic may go to the same one."""


class PictureScratch:
    """Temporary file of pictures (h, w, 3), each by the number of its pose and its size.

    A picture for which there is no room is not kept, and has to be read again. Several threads may use it.
    """

    def __init__(self, most_mb: float) -> None:
        self._most_bytes, self._end = most_mb * 1e6, 0
        self._file: IO[bytes] | None = None
        self._offset: dict[tuple[int, int, int], int] = {}
        self._appending = Lock()

    def recall(self, k: int, size_px: tuple[int, int]) -> Image | None:
        """Return the picture of pose k with this (width, height); None where it was not kept."""
        cols, rows = size_px
        offset = self._offset.get((k, cols, rows))
        if offset is None or self._file is None:
            return None
        try:
            raw = os.pread(self._file.fileno(), 3 * rows * cols, offset)
        except OSError:
            return None
        if len(raw) < 3 * rows * cols:
            return None
        return np.frombuffer(raw, np.uint8).reshape(rows, cols, 3).copy()  # that it can be written to

    def keep(self, k: int, picture: Image) -> None:
        """Keep the picture of pose k, if there is room."""
        rows, cols = picture.shape[:2]
        key = (k, cols, rows)
        with self._appending:
            offset = self._end
            if key in self._offset or offset + picture.nbytes > self._most_bytes:
                return
            self._end += picture.nbytes
        raw, written = np.ascontiguousarray(picture).data.cast("B"), 0
        try:
            file = self._opened()
            while written < len(raw):  # the system may write only a part
                written += os.pwrite(file.fileno(), raw[written:], offset + written)
        except OSError:  # full, or no folder to write in
            self._most_bytes = 0.0
            return
        self._offset[key] = offset

    def _opened(self) -> IO[bytes]:
        with self._appending:
            if self._file is None:
                self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115  it lives as long as this
                weakref.finalize(self, self._file.close)
                free = shutil.disk_usage(tempfile.gettempdir()).free
                self._most_bytes = min(self._most_bytes, FREE_SHARE * free)
            return self._file
