"""Writing of the pictures of a flight folder."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.workers import Workers
from slam.core.progress import Progress
from slam.core.streams import Frames, Image
from slam.io.camera_folder import PICTURE_VELOCITY
from slam.io.images import PictureFiles
from slam.io.narrow_pictures import NarrowPictures
from slam.io.picture_headers import UnreadableImageError, image_size, suffix_of
from slam.io.recorded_pictures import RecordedPictures

Array = NDArray[np.float64]

ENCODERS, ENCODED_AHEAD = 2, 5
"""Threads that encode, as this takes longer than to decode; pictures that are encoded or wait for it."""
JPEG_QUALITY = 92
_JPEG = [
    *(cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY),
    *(cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444),
]
_JPEG_OF_VIDEO = [
    *(cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY),
    *(cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420),
]
"""Videos have one colour for each four pixels; to store more takes half as much time again."""
_PNG = [
    *(cv2.IMWRITE_PNG_COMPRESSION, 1),
    *(cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY),
]
"""Compression without a search for repeats. Camera noise has none, so it is twice as fast and files are
smaller.
"""
SUFFIXES = {"png": (".png",), "jpg": (".jpg", ".jpeg")}


def stamps_ns(stamps_s: Array, epoch_ns: int) -> list[int]:
    """Return stamps (n,) of a flight as integers since the epoch of its clock."""
    return [int(s) + epoch_ns for s in np.round(np.asarray(stamps_s) * 1e9)]


def write_frames(frames: Frames, folder: Path, epoch_ns: int, progress: Progress, image_format: str) -> None:
    """Write the pictures and their table into the existing ``folder``, as `write_flight` states.

    Raises ``OSError`` where a picture cannot be written.
    """
    used: set[str] = set()
    encoding = _Encoding(frames.load, _parameters(frames.load, image_format))
    with open(folder / "data.csv", "w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        velocity = frames.w_v_m_s
        titles = () if velocity is None else (column.title for column in PICTURE_VELOCITY)
        rows.writerow(["#timestamp [ns]", "filename", *titles])

        def to_encode() -> Iterator[tuple[Image, Path]]:
            """Store the pictures that need no encoder, and yield the others."""
            for k, stamp in enumerate(stamps_ns(frames.stamps_s, epoch_ns)):
                picture = _picture(frames, k)
                suffixes = _suffixes(picture, frames.load, image_format)
                name = _file_name(frames.names[k], k, suffixes, used)
                target = folder / "data" / name
                target.parent.mkdir(parents=True, exist_ok=True)
                if isinstance(picture, Path):
                    _copy(picture, target)
                elif isinstance(picture, bytes):
                    target.write_bytes(picture)
                elif picture is not None:
                    yield picture, target
                speeds = () if velocity is None else np.round(velocity[k], 6).tolist()
                rows.writerow([stamp, name, *("" if np.isnan(speed) else speed for speed in speeds)])
                progress("writing pictures", k + 1, len(frames))

        # Pictures are reduced and encoded while the next is read or rendered. A loader is never called by two
        # threads.
        for _ in Workers(ENCODERS).map(_encode, encoding, to_encode(), ahead=ENCODED_AHEAD):
            pass


def _picture(frames: Frames, k: int) -> Path | bytes | Image | None:
    """Return picture k as it is stored (a file, or the bytes of one), else its pixels; None if unreadable.

    Pixels are those before they are reduced.
    """
    load = frames.load
    if isinstance(load, PictureFiles):
        return load.paths[k]
    if isinstance(load, NarrowPictures):
        return load.whole(k)
    return load.stored(k) if isinstance(load, RecordedPictures) else load(k)


def _suffixes(picture: Path | bytes | Image | None, load: object, image_format: str) -> tuple[str, ...]:
    if isinstance(picture, Path):
        return (picture.suffix.lower(),)
    if isinstance(picture, bytes):
        return (suffix_of(picture),)
    return SUFFIXES[recorded.picture_format if (recorded := _recorded(load)) else image_format]


def _file_name(name: str, k: int, suffixes: tuple[str, ...], used: set[str]) -> str:
    """Return the frame's name if it is a valid file name, with the suffix of its content, else its number."""
    path = PurePosixPath(name.strip())
    if path.suffix.lower() not in suffixes:
        path = path.with_name(path.name + suffixes[0]) if path.name else path
    if (
        path.is_absolute()
        or ".." in path.parts
        or not str(path).isprintable()
        or not path.name
        or len(str(path)) > 180
    ):
        path = PurePosixPath(f"{k:06d}{suffixes[0]}")
    if str(path).lower() in used:
        path = path.with_name(f"{path.stem}_{k:06d}{path.suffix}")
    used.add(str(path).lower())
    return str(path)


def _copy(source: Path, target: Path) -> None:
    try:
        image_size(source)
    except UnreadableImageError:
        return
    shutil.copyfile(source, target)


def _recorded(load: object) -> RecordedPictures | None:
    """Return the pictures of a recording that a loader gives as they are, or reduced."""
    whole = load.whole if isinstance(load, NarrowPictures) else load
    return whole if isinstance(whole, RecordedPictures) else None


def _parameters(load: object, image_format: str) -> list[int]:
    """Return the encoder's parameters."""
    if recorded := _recorded(load):
        return _PNG if recorded.picture_format == "png" else _JPEG_OF_VIDEO
    return _PNG if image_format == "png" else _JPEG


@dataclass(frozen=True)
class _Encoding:
    """Steps from the pixels of a loader to a file."""

    load: Callable[[int], Image | None]
    parameters: list[int]
    """Settings of the encoder."""


def _encode(encoding: _Encoding, wanted: tuple[Image, Path]) -> None:
    image, target = wanted
    stored = encoding.load.reduced(image) if isinstance(encoding.load, NarrowPictures) else image
    done, content = cv2.imencode(target.suffix.lower(), stored, encoding.parameters)
    if not done:
        raise OSError(f"{target}: the picture cannot be encoded")
    target.write_bytes(content.tobytes())
