"""Check of a video against its own header: AVI (RIFF) and Matroska files that were cut short or damaged.

An MP4 file is compared sample by sample instead (`slam.io.recordings.video.mp4`).
Sources: Microsoft, "AVI RIFF File Reference" and OpenDML 1.02; RFC 8794 and RFC 9559 (Matroska).
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.wording import either
from slam.core.messages import Message, warning
from slam.io.recordings.recording import COPY_AGAIN

Array = NDArray[np.float64]

_HEAD_BYTES = 1 << 16
"""Bytes at the beginning that hold the headers of a file."""
_SEGMENT = bytes.fromhex("18538067")
"""The element of Matroska that holds the pictures."""
_STREAMED = 1 << 30
"""Count of pictures in an AVI file that FFmpeg streams to a pipe, where it cannot go back to write the true
one (``AVI_MAX_RIFF_SIZE`` in libavformat/avienc.c). Lengths are not stated there either."""


def without_cut_end(path: Path, shown_s: Array) -> tuple[Array, tuple[Message, ...]]:
    """Return the times of the pictures that are whole, and a line where the file has fewer than it states.

    ``shown_s`` (n,) are the times of the packets in seconds, in the order of the file. In an AVI file that is
    cut short, the last packet is decoded in part and therefore left out, also where it is the only one.
    """
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    size = path.stat().st_size
    if head.startswith(b"RIFF"):
        stated, rate_hz = _stated_pictures(head)
        if stated >= _STREAMED:
            return shown_s, ()
        shown_count = len(shown_s) if len(shown_s) < 2 else 1 + round(float(np.ptp(shown_s)) * rate_hz)
        if 0 < stated <= shown_count:
            return shown_s, ()
        if _end_of_riff(path, size) > size:
            counted = f"its header counts {stated} pictures" if stated else ""
            return shown_s[:-1], (
                warning(
                    f"the file is cut short after {len(shown_s)} pictures",
                    counted,
                    "the last one, which may be incomplete, is left out",
                    COPY_AGAIN,
                ),
            )
        missing = stated - shown_count
        return shown_s, (
            warning(
                f"{missing} of {stated} pictures that the header counts {either(missing, 'is', 'are')} "
                "missing in the file, and pictures after them come too early by their times",
                COPY_AGAIN,
            ),
        ) * (stated > 0)
    lost = _end_of_segment(head) - size
    if lost > 0:
        return shown_s, (warning(f"the file is cut short: its last {lost:,} bytes are missing", COPY_AGAIN),)
    return shown_s, ()


def _stated_pictures(head: bytes) -> tuple[int, float]:
    """Return how many pictures the header of an AVI file counts, and their rate in Hz; 0 where unknown."""
    at = head.find(b"vids") - 8
    if at < 0 or head[at : at + 4] != b"strh" or at + 44 > len(head):
        return 0, 0.0
    scale, rate, _, count = struct.unpack_from("<4I", head, at + 28)
    return (count, rate / scale) if scale and rate else (0, 0.0)


def _end_of_riff(path: Path, size: int) -> int:
    """Return where the last RIFF chunk ends by its own size; there are several in a large file (OpenDML)."""
    at = 0
    with path.open("rb") as file:
        while at + 8 <= size:
            file.seek(at)
            kind, length = struct.unpack("<4sI", file.read(8))
            if kind != b"RIFF":
                break
            at += 8 + length + (length & 1) * (at + 8 + length < size)
    return at


def _end_of_segment(head: bytes) -> int:
    """Return where the segment of a Matroska file ends by its own size; 0 where it is not stated."""
    at = head.find(_SEGMENT) + len(_SEGMENT)
    if not head.startswith(b"\x1aE\xdf\xa3") or at < len(_SEGMENT) or at + 8 > len(head) or not head[at]:
        return 0
    width = 9 - head[at].bit_length()
    value = int.from_bytes(head[at : at + width], "big") & ((1 << 7 * width) - 1)
    return 0 if value == (1 << 7 * width) - 1 else at + width + value
