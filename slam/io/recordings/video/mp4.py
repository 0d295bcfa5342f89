"""The index of an MP4 or MOV file: its tracks, the times of their samples, and where the samples are.

Source: ISO/IEC 14496-12 (ISO base media file format), sections 4.2 and 8.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from slam.io.files import refusal

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

MAX_INDEX_BYTES = 1 << 28
"""Largest ``moov`` box that is read; an hour at 60 pictures a second has about 5 MB."""
START = re.compile(rb".{4}(ftyp(?!hei|mif1|msf1|avi)|moov|mdat|wide|free|skip)", re.DOTALL)
"""First bytes of a file. A HEIC or AVIF picture begins alike, with a brand of its own."""


@dataclass(frozen=True)
class Mp4Track:
    """One track of a file."""

    handler: str
    """Four letters: ``vide``, ``sbtl``, ``meta`` and so on."""
    code: str
    """Four letters of the format of its samples, for example ``avc1``, ``tx3g``, ``gpmd``."""
    stamps_s: Array
    """(m,) times at which the samples are shown, increasing, from the first one that is shown.

    Samples that an edit list cuts off, those with the time of another one, and those beyond the end of the
    file are not shown."""
    durations_s: Array
    """(n,) in the order of the file."""
    offsets: Integers
    """(n,) places of the samples in the file, in the order of the file."""
    sizes: Integers
    """(n,) bytes."""
    lost: int
    """Number of samples that do not lie in the file entirely."""

    def samples(self, file: BinaryIO, limit_bytes: int = 1 << 24) -> Iterator[bytes | None]:
        """Yield the samples in the order of the file; None for one beyond its end or the limit."""
        for offset, size in zip(self.offsets.tolist(), self.sizes.tolist(), strict=True):
            file.seek(offset)
            data = file.read(size) if size <= limit_bytes else b""
            yield data if len(data) == size else None


def read_tracks(path: Path) -> tuple[Mp4Track, ...]:
    """Return the tracks of a file. Raises ``InputError`` where the index is missing or damaged."""
    with path.open("rb") as file:
        index = _index(path, file)
    try:
        movie_scale = _timescale(_find(index, b"mvhd"))
        return tuple(
            _track(body, path.stat().st_size, movie_scale)
            for kind, body in boxes(index)
            if kind == b"trak" and _find(body, b"mdia", b"minf", b"stbl")
        )
    except (struct.error, ValueError, IndexError, OverflowError) as error:
        raise refusal(
            path, f"is a video with a damaged index ({error})", "repair it with a tool for MP4 files"
        ) from None


def _index(path: Path, file: BinaryIO) -> bytes:
    """Return the content of ``moov``."""
    end = path.stat().st_size
    at = 0
    while at + 8 <= end:
        file.seek(at)
        head = file.read(16)
        size, kind = struct.unpack(">I4s", head[:8])
        start = 8
        if size == 1 and len(head) == 16:
            size, start = struct.unpack(">Q", head[8:])[0], 16
        size = end - at if size == 0 else size
        if size < start:
            break
        if kind == b"moov":
            if size > MAX_INDEX_BYTES or at + size > end:
                break
            file.seek(at + start)
            return file.read(size - start)
        at += size
    raise refusal(
        path,
        "is a video without its index (moov), as after a power loss of the recorder",
        "repair it with a tool for MP4 files (untrunc) and another video of the same camera",
    )


def read_user_data(path: Path) -> bytes:
    """Return the content of ``udta``, where makers name the camera; empty where there is none."""
    with path.open("rb") as file:
        return _find(_index(path, file), b"udta")


def boxes(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield the kind and the content of each box. Raises ``ValueError`` for a length that cannot be."""
    at = 0
    while at + 8 <= len(data):
        size, kind = struct.unpack(">I4s", data[at : at + 8])
        start = 8
        if size == 1:
            size, start = struct.unpack(">Q", data[at + 8 : at + 16])[0], 16
        size = len(data) - at if size == 0 else size
        if size < start:
            raise ValueError(f"a box of {size} bytes")
        yield kind, data[at + start : at + size]
        at += size


def _find(data: bytes, *names: bytes) -> bytes:
    """Return the content of a nested box; empty where it is absent."""
    for name in names:
        data = next((body for kind, body in boxes(data) if kind == name), b"")
    return data


def _timescale(header: bytes) -> int:
    """Return the units per second that the header of the file or of a track states; 0 without a header."""
    if not header:
        return 0
    return int(struct.unpack(">I", header[20:24] if header[0] == 1 else header[12:16])[0])


def _track(body: bytes, limit: int, movie_scale: int) -> Mp4Track:
    """Return a track; more samples than ``limit``, the bytes of the file, are damage.

    Samples beyond these bytes are lost, as in a file that is cut short.
    """
    media = _find(body, b"mdia")
    table = _find(media, b"minf", b"stbl")
    timescale = _timescale(_find(media, b"mdhd"))
    if timescale == 0:
        raise ValueError("a track without units of time")
    counts = _integers(_find(table, b"stts"), 2)
    sizes = _sizes(_find(table, b"stsz"), limit)
    durations = _repeated(counts[:, 1], counts[:, 0], limit)
    if len(durations) != len(sizes):
        raise ValueError(f"{len(durations)} times of {len(sizes)} samples")
    decoded = np.concatenate([[0], np.cumsum(durations)[:-1]]) if len(durations) else durations
    shown = decoded
    if composition := _find(table, b"ctts"):
        shifts = _integers(composition, 2)
        signed = shifts[:, 1].astype(np.uint32).view(np.int32).astype(np.int64)
        shown = decoded + _repeated(signed, shifts[:, 0], limit)[: len(decoded)]
    offsets = _offsets(table, sizes)
    is_whole = offsets + sizes <= limit
    stamps = _edited(
        np.unique(shown[is_whole]), _edits(_find(body, b"edts", b"elst")), timescale, movie_scale
    )
    return Mp4Track(
        handler=_find(media, b"hdlr")[8:12].decode("latin-1"),
        code=_find(table, b"stsd")[12:16].decode("latin-1"),
        stamps_s=(stamps - stamps[0]) / timescale if len(stamps) else np.empty(0),
        durations_s=durations / timescale,
        offsets=offsets,
        sizes=sizes,
        lost=int((~is_whole).sum()),
    )


def _edits(box: bytes) -> list[tuple[int, int]]:
    """Return duration, in units of the file, and start in the track, in its units, of each edit."""
    if not box:
        return []
    layout, size = (">Qq", 20) if box[0] == 1 else (">Ii", 12)
    count = struct.unpack(">I", box[4:8])[0]
    return [struct.unpack_from(layout, box, at) for at in range(8, 8 + size * count, size)]


def _edited(shown: Integers, edits: list[tuple[int, int]], timescale: int, movie_scale: int) -> Integers:
    """Return the times at which samples are shown after the edit list (section 8.6.6).

    A start of -1 is a pause. A duration of 0 lasts to the end of the track.
    """
    if not edits or not movie_scale:
        return shown
    pieces, begin = [], 0
    for duration, start in edits:
        length = round(duration * timescale / movie_scale)
        if start >= 0:
            until = start + length if length else np.iinfo(np.int64).max
            pieces.append(shown[(shown >= start) & (shown < until)] + (begin - start))
        begin += length
    return np.concatenate([np.empty(0, np.int64), *pieces])


def _integers(box: bytes, columns: int) -> Integers:
    """Return the rows of a table of 32-bit numbers after its version, flags and count."""
    count = struct.unpack(">I", box[4:8])[0]
    rows = np.frombuffer(box[8 : 8 + 4 * columns * count], ">u4")
    return rows.reshape(-1, columns).astype(np.int64)


def _repeated(values: Integers, counts: Integers, limit: int) -> Integers:
    if counts.sum() > limit:
        raise ValueError(f"{counts.sum():,} samples")
    return np.repeat(values, counts)


def _sizes(box: bytes, limit: int) -> Integers:
    if not box:
        return np.empty(0, np.int64)
    common, count = struct.unpack(">II", box[4:12])
    if count > limit:
        raise ValueError(f"{count:,} samples")
    if common:
        return np.full(count, common, np.int64)
    return np.frombuffer(box[12 : 12 + 4 * count], ">u4").astype(np.int64)


def _offsets(table: bytes, sizes: Integers) -> Integers:
    """Return the place of each sample from the chunks of the track."""
    if wide := _find(table, b"co64"):
        chunks = np.frombuffer(wide[8:], ">u8").astype(np.int64)
    else:
        chunks = _integers(_find(table, b"stco"), 1)[:, 0]
    runs = _integers(_find(table, b"stsc"), 3)
    last = np.append(runs[1:, 0], len(chunks) + 1)
    per_chunk = np.repeat(runs[:, 1], last - runs[:, 0])[: len(chunks)]
    first = np.concatenate([[0], np.cumsum(per_chunk)])[:-1]
    before = np.concatenate([[0], np.cumsum(sizes)])
    chunk_of = np.repeat(np.arange(len(per_chunk)), per_chunk)[: len(sizes)]
    if len(chunk_of) < len(sizes):
        raise ValueError(f"{len(chunk_of)} places of {len(sizes)} samples")
    within = before[:-1] - before[first[chunk_of]]
    return np.asarray(chunks[chunk_of] + within)
