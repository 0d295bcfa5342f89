"""Small videos, and MP4 files put together box by box after ISO/IEC 14496-12."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from slam.io.recordings.video.mp4 import read_tracks

SIZE_PX = (64, 48)
CONTAINERS = (b"moov", b"trak", b"mdia", b"minf", b"stbl")


def grey_of(k: int) -> int:
    return 10 + 5 * k


def video(path: Path, count: int = 40, rate_hz: float = 10.0, codec: str = "mp4v") -> Path:
    """Write a video whose picture k has the brightness ``grey_of(k)``."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), rate_hz, SIZE_PX)
    assert writer.isOpened()
    for k in range(count):
        writer.write(np.full((SIZE_PX[1], SIZE_PX[0], 3), grey_of(k), np.uint8))
    writer.release()
    return path


def zero_pictures(path: Path, numbers: Iterable[int]) -> None:
    """Overwrite the encoded pictures of some numbers by zero bytes."""
    (track,) = read_tracks(path)
    content = bytearray(path.read_bytes())
    for k in numbers:
        at, size = int(track.offsets[k]), int(track.sizes[k])
        content[at : at + size] = bytes(size)
    path.write_bytes(bytes(content))


def box(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I4s", 8 + len(body), kind) + body


def full(kind: bytes, body: bytes) -> bytes:
    return box(kind, bytes(4) + body)


def table(kind: bytes, *rows: tuple[int, ...]) -> bytes:
    return full(
        kind, struct.pack(">I", len(rows)) + b"".join(struct.pack(f">{len(row)}I", *row) for row in rows)
    )


def with_durations(path: Path, durations: list[int]) -> None:
    """Give each picture of a video its own duration, in the units of its track."""
    times = table(b"stts", *((1, duration) for duration in durations))
    content = replaced(path.read_bytes(), b"edts", b"")  # an edit list would end the track at the old length
    path.write_bytes(replaced(content, b"stts", times))


def with_edits(path: Path, edits: list[tuple[int, int]]) -> None:
    """Give a video another edit list: durations in the units of the file, starts in those of the track."""
    body = struct.pack(">I", len(edits)) + b"".join(struct.pack(">IiI", *edit, 1 << 16) for edit in edits)
    path.write_bytes(replaced(path.read_bytes(), b"edts", box(b"edts", full(b"elst", body))))


def with_quarter_turn(path: Path) -> None:
    """Flag that a player must turn the pictures by 90 degrees (matrix of the track's header)."""
    content = bytearray(path.read_bytes())
    at = content.index(b"tkhd") + 44  # version 0
    content[at : at + 36] = struct.pack(">9i", 0, 1 << 16, 0, -1 << 16, 0, 0, 0, 0, 1 << 30)
    path.write_bytes(bytes(content))


def replaced(data: bytes, wanted: bytes, new: bytes) -> bytes:
    """Return boxes with those of one kind replaced, at any depth."""
    parts = []
    at = 0
    while at + 8 <= len(data):
        size, kind = struct.unpack(">I4s", data[at : at + 8])
        body = data[at + 8 : at + size]
        if kind == wanted:
            parts.append(new)
        else:
            parts.append(
                box(kind, replaced(body, wanted, new)) if kind in CONTAINERS else data[at : at + size]
            )
        at += size
    return b"".join(parts)


def file_of_samples(
    path: Path, handler: bytes, code: bytes, durations_ms: list[int], samples: list[bytes]
) -> Path:
    """Write an MP4 file with one track; its samples stand one behind the other in one chunk."""
    head = box(b"ftyp", b"isom" + bytes(4))
    data = box(b"mdat", b"".join(samples))
    sizes = [len(sample) for sample in samples]
    stbl = (
        full(b"stsd", struct.pack(">I", 1) + box(code, bytes(8)))
        + table(b"stts", *((1, duration) for duration in durations_ms))
        + table(b"stsc", (1, len(samples), 1))
        + full(b"stsz", struct.pack(f">II{len(sizes)}I", 0, len(sizes), *sizes))
        + table(b"stco", (len(head) + 8,))
    )
    mdia = (
        full(b"mdhd", struct.pack(">IIII", 0, 0, 1000, sum(durations_ms)) + bytes(4))
        + full(b"hdlr", bytes(4) + handler + bytes(12))
        + box(b"minf", box(b"stbl", stbl))
    )
    path.write_bytes(head + data + box(b"moov", box(b"trak", box(b"mdia", mdia))))
    return path
