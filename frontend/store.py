"""Features of all keyframes, descriptors on disk: memory does not grow with the length of the flight."""

from __future__ import annotations

import os
import tempfile
import weakref
from typing import Any

import numpy as np

from frontend.features import Features
from frontend.points import Points


class FeatureStore:
    """Append-only; points stay in memory (24 bytes a feature), descriptors in a temporary file."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115  it lives as long as the store
        self._offset: list[int] = []
        self._shape: list[tuple[int, int]] = []
        self._dtype: np.dtype[Any] = np.dtype(np.float32)
        self._end = 0
        weakref.finalize(self, self._file.close)
        self.points: list[Points] = []
        """Where each keyframe's features lie."""

    def append(self, features: Features) -> None:
        """Keep the features of the next keyframe."""
        data = np.ascontiguousarray(features.descriptor)
        self._dtype = data.dtype
        self._offset.append(self._end)
        written, raw = 0, memoryview(data.tobytes())
        while written < len(raw):  # the system may take a part of it
            written += os.pwrite(self._file.fileno(), raw[written:], self._end + written)
        self._shape.append((data.shape[0], data.shape[1]))
        self._end += data.nbytes
        self.points.append(features.points)

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, k: int) -> Features:
        rows, width = self._shape[k]
        data = os.pread(self._file.fileno(), rows * width * self._dtype.itemsize, self._offset[k])
        return Features(self.points[k], np.frombuffer(data, self._dtype).reshape(rows, width))
