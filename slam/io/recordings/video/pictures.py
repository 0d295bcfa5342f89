"""Pictures of a video by number; one is decoded at a time, and none is kept."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.core.streams import Image
from slam.io.content_key import digest_with, file_key
from slam.io.files import brief, refusal
from slam.io.picture_headers import UnreadableImageError

Array = NDArray[np.float64]

_FIRST_MARGIN = 8
"""Number of pictures before the wanted one at which decoding starts after a jump; it is doubled as needed."""
_READ_ON = 64
"""A picture so close ahead is reached by decoding on, which is faster than a jump to a key picture."""

_FFMPEG_OPTIONS = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
_OPENING = threading.Lock()
"""Held while a video is opened, since the variable belongs to the whole process."""


class VideoPictures:
    """Pictures of a video, found by their times, so that a lost picture does not shift the later ones."""

    def __init__(self, path: Path, stamps_s: Array, is_timed: bool = True, held_back: int = 0) -> None:
        """``stamps_s`` (n,) are the times of the pictures from the first one, increasing.

        Pictures of a file without times (``is_timed`` False) are counted instead. ``held_back`` is the
        number of pictures by which the reported times are ahead of those that are shown.
        """
        self._held_back = held_back
        self._path, self._stamps_s, self._is_timed = path, stamps_s, is_timed
        self._grabbed = 0
        """Number of pictures since the start of a file without times."""
        steps = np.diff(stamps_s)
        self._tolerance_s = 0.5 * float(np.min(steps)) if len(steps) else 0.5
        self._video = opened(path)
        self._at_s: float | None = None
        """Time of the picture that was grabbed last; None before the first and behind the last."""
        weakref.finalize(self, self._video.release)

    def __call__(self, k: int) -> Image:
        """Return picture k. Raises ``UnreadableImageError`` where the video does not hold it."""
        wanted_s = float(self._stamps_s[k])
        ahead = self._stamps_s[max(k - _READ_ON, 0)]
        if self._at_s is None or self._at_s > wanted_s + self._tolerance_s or self._at_s < ahead:
            self._jump(k)
        while self._at_s is not None and self._at_s < wanted_s - self._tolerance_s:
            self._grab()
        if self._at_s is None or self._at_s > wanted_s + self._tolerance_s:
            raise UnreadableImageError("missing in the video (damaged?)")
        decoded, image = self._video.retrieve()
        if not decoded or image is None:
            raise UnreadableImageError("damaged")
        return np.asarray(image, dtype=np.uint8)

    def content_key(self, k: int) -> bytes | None:
        """Return a digest of the file and of the time of picture k; None where the file cannot be read."""
        return digest_with(self._file_key, float(self._stamps_s[k]), self._is_timed, self._held_back, k)

    @cached_property
    def _file_key(self) -> bytes | None:
        return file_key(self._path)

    def _jump(self, k: int) -> None:
        margin = _FIRST_MARGIN if self._is_timed else len(self._stamps_s)
        while True:
            start = max(k - margin, 0)
            self._at_s = None
            if start == 0:
                self._video.release()
                with _read_by_index():
                    self._video.open(str(self._path), cv2.CAP_FFMPEG)
                self._video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
                self._grabbed = 0
            else:
                self._video.set(cv2.CAP_PROP_POS_FRAMES, start)
            self._grab()
            if start == 0 or (self._at_s is not None and self._at_s <= self._stamps_s[k] + self._tolerance_s):
                return
            margin *= 2

    def _grab(self) -> None:
        """Go to the next picture that can be decoded."""
        passed = 0 if self._at_s is None else int(np.searchsorted(self._stamps_s, self._at_s))
        for _ in range(len(self._stamps_s) - passed):  # a damaged picture fails, and the next may not
            if self._video.grab():
                self._grabbed += 1
                if not self._is_timed:
                    self._at_s = self._stamp(self._grabbed - 1)
                elif self._held_back:
                    self._at_s = self._shown_s(passed)
                else:
                    self._at_s = self._video.get(cv2.CAP_PROP_POS_MSEC) * 1e-3
                return
        self._at_s = None

    def _shown_s(self, passed: int) -> float | None:
        """Return the time of the grabbed picture, where the file has the times of packets only."""
        packet_s = self._video.get(cv2.CAP_PROP_POS_MSEC) * 1e-3
        if packet_s == 0:  # behind the last packet, the pictures that were held back follow
            return self._stamp(passed + 1)
        return self._stamp(_number_at(self._stamps_s, packet_s) - self._held_back)

    def _stamp(self, k: int) -> float | None:
        return float(self._stamps_s[k]) if 0 <= k < len(self._stamps_s) else None


@contextmanager
def _read_by_index() -> Iterator[None]:
    """Let FFmpeg find the packets of an AVI file by its index, where it has one.

    Otherwise FFmpeg reads on from packet to packet and counts them for the times, so that all pictures
    behind a damaged place come too early. OpenCV passes FFmpeg's flags by this variable alone. Options that
    the user has set there stay.
    """
    with _OPENING:
        before = os.environ.get(_FFMPEG_OPTIONS, "")
        os.environ[_FFMPEG_OPTIONS] = "|".join(filter(None, (before, "fflags;sortdts")))
        try:
            yield
        finally:
            os.environ.pop(_FFMPEG_OPTIONS, None)
            if before:
                os.environ[_FFMPEG_OPTIONS] = before


def opened(path: Path) -> cv2.VideoCapture:
    """Return the opened video, its pictures not turned. Raises ``InputError`` where it cannot be opened."""
    with _read_by_index():
        video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    if not video.isOpened():
        raise refusal(path, "is a video that cannot be decoded", "convert it to H.264 in MP4")
    video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return video


def first_size_of(path: Path) -> tuple[int, int]:
    """Return (width, height) of the first picture that can be decoded.

    Raises ``InputError`` where none can: the codec is unknown, or all pictures are damaged.
    """
    video = opened(path)
    decoded, image = video.read()
    codec = int(video.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode("latin-1").strip("\0")
    video.release()
    if not decoded or image is None:
        raise refusal(
            path,
            f"is a video of which no picture can be decoded (codec {brief(codec)!r})",
            "copy it again from the recorder, or convert it to H.264 in MP4",
        )
    return image.shape[1], image.shape[0]


def pictures_held_back(path: Path, stamps_s: Array) -> int:
    """Return how many packets behind the first one the first picture of a video comes.

    AVI files do not say when a picture is shown, only the order of the packets. Where pictures are predicted
    from later ones, a picture is shown when later packets are there. ``stamps_s`` (n,) are the packets'.
    """
    video = opened(path)
    first_s = video.get(cv2.CAP_PROP_POS_MSEC) * 1e-3 if video.grab() else 0.0
    video.release()
    return _number_at(stamps_s, first_s)


def _number_at(stamps_s: Array, at_s: float) -> int:
    """Return the number of the stamp that is nearest to a time."""
    return int(np.abs(stamps_s - at_s).argmin())


def packet_times(path: Path) -> Array:
    """Return the times in seconds at which the packets of a video are shown, in the order of the file.

    Nothing is decoded. All are zero where the file has no times, as a bare H.264 stream.
    """
    with _read_by_index():
        packets = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    times_ms = []
    while packets.grab():
        times_ms.append(packets.get(cv2.CAP_PROP_POS_MSEC))
    packets.release()
    return np.array(times_ms, dtype=float) * 1e-3
