"""Features of all keyframes on disk: memory does not grow with the length of the flight."""

from __future__ import annotations

import errno
import hashlib
import os
import tempfile
import weakref
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from frontend.features import Features
from frontend.points import Points

_POINT_BYTES = 24
"""Position and spread of a feature."""


class FeatureStore:
    """Append-only temporary file with the points, then the descriptors, of each keyframe.

    Where the file cannot be written or read, the ``OSError`` names the folder of temporary files.
    """

    def __init__(self) -> None:
        with _named_errors():
            self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115  it lives as long as the store
        self._offset: list[int] = []
        self._shape: list[tuple[int, int]] = []
        self._digest: list[bytes] = []
        self._dtype: np.dtype[Any] = np.dtype(np.float32)
        self._end = 0
        weakref.finalize(self, self._file.close)

    @property
    def points(self) -> Sequence[Points]:
        """Return the points of each keyframe, read on access."""
        return _StoredPoints(self)

    def append(self, features: Features) -> None:
        """Keep the features of the next keyframe."""
        points, descriptor = features.points, features.descriptor
        self._dtype = descriptor.dtype
        self._offset.append(self._end)
        written, raw = 0, memoryview(points.pixel.tobytes() + points.spread.tobytes() + descriptor.tobytes())
        with _named_errors():
            while written < len(raw):  # the system may write only a part
                written += os.pwrite(self._file.fileno(), raw[written:], self._end + written)
        self._shape.append((descriptor.shape[0], descriptor.shape[1]))
        self._digest.append(hashlib.blake2b(raw, digest_size=16).digest())
        self._end += len(raw)

    def __len__(self) -> int:
        return len(self._shape)

    def count(self, k: int) -> int:
        """Return the number of features of a keyframe."""
        return self._shape[k][0]

    def digest(self, k: int) -> bytes:
        """Return a digest of the features of a keyframe: equal features have equal ones, in any store."""
        return self._digest[k]

    def __getitem__(self, k: int) -> Features:
        rows, width = self._shape[k]
        data = self._read(k, rows * (_POINT_BYTES + width * self._dtype.itemsize))
        descriptor = np.frombuffer(data, self._dtype, offset=rows * _POINT_BYTES)
        return Features(_points(data, rows), descriptor.reshape(rows, width))

    def points_of(self, k: int) -> Points:
        """Return the points of one keyframe."""
        return _points(self._read(k, self.count(k) * _POINT_BYTES), self.count(k))

    def _read(self, k: int, size: int) -> bytes:
        with _named_errors():
            return os.pread(self._file.fileno(), size, self._offset[k])


class StoredFeatures:
    """Features of some keyframes of a store, read on access. Where pickled they become their content."""

    def __init__(self, store: FeatureStore, keyframes: Collection[int]) -> None:
        self._store, self._keyframes = store, keyframes

    def __getitem__(self, k: int) -> Features:
        return self._store[k]

    def __reduce__(self) -> tuple[type[dict[int, Features]], tuple[dict[int, Features]]]:
        return dict, ({k: self[k] for k in sorted(self._keyframes)},)


@contextmanager
def _named_errors() -> Iterator[None]:
    """Give the system's errors the name of the folder: they come from an open file and have none."""
    try:
        yield
    except FileNotFoundError:  # of tempfile, which found no folder to write in
        folder = os.environ.get("TMPDIR", "/tmp")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), folder) from None
    except OSError as error:
        raise OSError(error.errno, error.strerror, tempfile.gettempdir()) from None


def _points(data: bytes, rows: int) -> Points:
    pixel = np.frombuffer(data, np.float64, 2 * rows).reshape(rows, 2)
    spread = np.frombuffer(data, np.float64, rows, offset=16 * rows)
    return Points(pixel, spread)


class _StoredPoints(Sequence[Points]):
    def __init__(self, store: FeatureStore) -> None:
        self._store = store

    def __len__(self) -> int:
        return len(self._store)

    def __getitem__(self, k: Any) -> Any:
        return self._store.points_of(k)  # slices are not supported
