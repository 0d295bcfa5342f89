"""Video of Parrot's AR.Drone 2 as it sends it: pictures in H.264, each behind a header (PaVE).

The header has the drone's time of the picture. Source: Parrot, AR.Drone Developer Guide SDK 2.0, section 7.3.
"""

from __future__ import annotations

import mmap
import shutil
import struct
import tempfile
import weakref
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from slam.core.messages import Message, warning
from slam.core.progress import Progress
from slam.io.files import refusal
from slam.io.recordings.recording import COPY_AGAIN, Content, Offer, PictureChannel, Recording
from slam.io.recordings.video.pictures import VideoPictures, first_size_of
from slam.io.recordings.video.subtitle_streams import video_camera

DESCRIPTION = "a video of an AR.Drone"
MARK = b"PaVE"
_HEADER = struct.Struct("<4s2BHI4H2I4B")
"""Mark, version, codec, sizes of header and payload, four sizes in pixels, number and time of the picture,
number of chunks, number of the chunk, type of the picture, control."""
_H264 = 4
_KEY_TYPES = (1, 2)
"""Pictures that are decoded without earlier ones: IDR and I."""
_NS_PER_MS = 1_000_000


@dataclass
class _Stream:
    """The pictures of a file, from the first one that can be decoded alone."""

    numbers: list[int] = field(default_factory=list)
    times_ms: list[int] = field(default_factory=list)
    parts: list[tuple[int, int]] = field(default_factory=list)
    """Begin and end of the encoded data in the file, in order."""
    codecs: set[int] = field(default_factory=set)
    before_key: int = 0
    lost_bytes: int = 0

    def add(self, header: tuple[int, ...], begin: int, end: int) -> None:
        """Add one chunk of a picture."""
        codec, number, time_ms, kind = header[2], header[9], header[10], header[13]
        self.codecs.add(codec)
        if not self.numbers and kind not in _KEY_TYPES:
            self.before_key += 1
            return
        if not self.numbers or self.numbers[-1] != number:
            self.numbers.append(number)
            self.times_ms.append(time_ms)
        self.parts.append((begin, end))

    def notes(self) -> tuple[Message, ...]:
        """Return a line for everything that is missing."""
        gaps = int(np.maximum(np.diff(self.numbers) - 1, 0).sum())
        lines = (
            (
                self.before_key,
                warning(
                    "pictures before the first key picture cannot be decoded and are left out",
                    "begin to record earlier",
                ),
            ),
            (
                gaps,
                warning(
                    "pictures were not received",
                    "later ones may show traces of them",
                    "stay nearer to the drone",
                ),
            ),
            (
                self.lost_bytes,
                warning("bytes hold no picture (damaged or cut short) and were passed over", COPY_AGAIN),
            ),
        )
        return tuple(line.prefixed(str(count)) for count, line in lines if count)


def open_recording(path: Path) -> Recording:
    """Open a video. Raises ``InputError`` where no picture can be decoded."""
    stream = _scanned(path)
    if not stream.parts:
        raise refusal(path, f"is {DESCRIPTION} without a complete key picture", "record a longer video")
    if stream.codecs != {_H264}:
        raise refusal(
            path,
            f"is {DESCRIPTION} in another code than H.264 (codecs {sorted(stream.codecs)})",
            "set video_codec of the drone to an H264 value, or convert the video to MP4",
        )

    def read(chosen: Sequence[Offer], progress: Progress) -> Content:
        return Content(pictures=_pictures(path, stream), metadata={"vehicle": "AR.Drone 2"})

    rows = len(stream.numbers)
    offer = Offer(stream="cam0", channel=path.name, kind="PaVE", rows=rows, reading="the drone's time in ms")
    return Recording(path=path, name=path.stem, description=DESCRIPTION, offers=(offer,), read=read)


def _scanned(path: Path) -> _Stream:
    stream = _Stream()
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at = 0
        while at < len(data):
            end = len(data) + 1
            if data[at : at + 4] == MARK and at + _HEADER.size <= len(data):
                header = _HEADER.unpack_from(data, at)
                begin = at + header[3]
                end = begin + header[4]
            if end > len(data) or begin < at + _HEADER.size:
                following = data.find(MARK, at + 1)
                end = following if following > 0 else len(data)
                stream.lost_bytes += end - at
            else:
                stream.add(header, begin, end)
            at = end
    return stream


def _pictures(path: Path, stream: _Stream) -> PictureChannel:
    """Return the pictures, decoded from a copy of the stream without the headers.

    The copy is deleted with the pictures."""
    folder = tempfile.TemporaryDirectory(prefix="slam-")
    bare = Path(folder.name) / f"{path.stem}.h264"
    with path.open("rb") as file, bare.open("wb") as copy:
        for begin, end in stream.parts:
            file.seek(begin)
            copy.write(file.read(end - begin))
    shutil.copystat(path, bare)  # by which a later run knows the pictures again
    fetch = VideoPictures(bare, np.arange(len(stream.numbers), dtype=float), is_timed=False)
    weakref.finalize(fetch, folder.cleanup)
    camera, notes = video_camera(first_size_of(bare), None, has_angles=False)
    stamps_ns = np.array(stream.times_ms, dtype=np.int64) * _NS_PER_MS
    return PictureChannel(
        stamps_ns=stamps_ns,
        names=tuple(f"{number:08d}.jpg" for number in stream.numbers),
        fetch=fetch,
        camera=camera,
        picture_format="jpg",
        notes=(*notes, *stream.notes()),
    )
