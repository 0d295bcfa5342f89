"""Reading of one picture (PNG, JPEG or TIFF) from an untrusted file, as 8 bits.

The header is checked first (`slam.io.picture_headers`).

Pillow decodes, because it refuses a truncated picture, where OpenCV fills the rest with grey. Pixels of more
than 8 bits are decoded by OpenCV (PNG) and GDAL (TIFF), and converted as ``slam.io.levels`` describes. EXIF
orientation is not applied, as the intrinsics belong to the pixels in sensor order.
"""

from __future__ import annotations

import contextlib
import io
import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image as Pillow

from frontend.picture_check import reduced_size
from slam.core.messages import Message, warning
from slam.core.streams import Image
from slam.io.content_key import digest_with, file_key
from slam.io.levels import Levels, Raw, levels_of, range_of
from slam.io.picture_headers import (
    HEADER_BYTES,
    MAX_BYTES,
    PNG,
    UnreadableImageError,
    check_size,
    encoded_header,
    picture_header,
    read_bytes,
)
from slam.io.tiff import MAGIC as TIFF_MAGIC
from slam.io.tiff import gdal_pixels, unusual_tiff

_TAG_BLOCKS = re.compile(rb"(\xff[\xe1\xe2]..)(Exif|MPF\0)", re.DOTALL)
"""Start of a JPEG's Exif and multi-picture blocks."""
_PICTURES_FOR_LEVELS = 8
"""Number of pictures from which the levels are taken. One with a bright spot is enough."""


@dataclass
class PictureFiles:
    """Loader of picture k of a list of files. It can be sent to another process."""

    paths: tuple[Path, ...]
    size_px: tuple[int, int] | None
    """(width, height) that every picture must have; None allows any size."""
    levels: Levels | None = None
    """Common range of files with more than 8 bits, so that none is brighter than its neighbours; None: each
    file has its own."""
    failures: dict[int, str] = field(default_factory=dict)
    """Reason for each picture k that was requested and could not be read."""

    def __reduce__(self) -> tuple[type[PictureFiles], tuple[Any, ...]]:
        # Another process may work in another folder, and its failures are its own.
        return PictureFiles, (tuple(path.absolute() for path in self.paths), self.size_px, self.levels)

    def __call__(self, k: int) -> Image | None:
        """Return picture k, or None with the reason in ``failures``."""
        return self.load_reduced(k, None)

    def content_key(self, k: int) -> bytes | None:
        """Return a digest of the file of picture k and of how it is read; None where it has no bytes."""
        return digest_with(file_key(self.paths[k]), self.size_px, self.levels)

    def load_reduced(self, k: int, side_px: int | None) -> Image | None:
        """Return picture k as `read_image` reduces it, or None with the reason in ``failures``."""
        try:
            return read_image(self.paths[k], self.size_px, self.levels, side_px)
        except UnreadableImageError as reason:
            self.failures[k] = str(reason)
            return None


def read_image(
    path: Path,
    size_px: tuple[int, int] | None = None,
    levels: Levels | None = None,
    side_px: int | None = None,
) -> Image:
    """Return a PNG, JPEG or TIFF as (h, w, 3) BGR or (h, w) grey, 8 bit.

    Deeper pixels are converted with ``levels``, or with those of this picture if it is None. 1-bit pixels
    become 0 and 255, palettes are resolved, and alpha is dropped. With ``side_px`` a JPEG is grey, and
    as small as `reduced_size` says, which takes a fraction of the time. Raises ``UnreadableImageError`` if
    the file is missing, damaged, too large, or not of ``size_px``.
    """
    header = picture_header(path)
    check_size(header.size_px, size_px)
    return _eight_bit(*_decoded(read_bytes(path, MAX_BYTES), header.is_deep, side_px), levels)


def decode_image(data: bytes, size_px: tuple[int, int] | None = None) -> Image:
    """Return the content of a PNG or JPEG file as ``read_image`` does; each deep picture has its own levels.

    Raises ``UnreadableImageError``.
    """
    header = encoded_header(data)
    check_size(header.size_px, size_px)
    return _eight_bit(*_decoded(data, header.is_deep), None)


def _eight_bit(pixels: Raw, is_integer: bool, levels: Levels | None) -> Image:
    if pixels.dtype == np.uint8:
        return np.asarray(pixels, dtype=np.uint8)
    if levels is None:
        ranges = [limits] if (limits := range_of(pixels)) is not None else []
        levels = levels_of(ranges or [(0.0, 0.0)], is_integer)
    return levels.eight_bit(pixels)


def common_levels(paths: Sequence[Path], notes: list[Message]) -> Levels | None:
    """Return the levels for all pictures, from a sample of them, and add notes about them.

    The result is None if no picture of the sample has more than 8 bits. Unreadable pictures are ignored, as
    they are counted when they are loaded.
    """
    notes += _unread_samples(paths)
    return levels_of_sample(_deep_pictures(paths), notes)


def sample_of(count: int) -> list[int]:
    """Return the numbers of the pictures from which the levels of ``count`` pictures are taken."""
    return [int(k) for k in np.unique(np.linspace(0, count - 1, _PICTURES_FOR_LEVELS).astype(int))]


def levels_of_sample(pictures: Iterable[tuple[Raw, bool]], notes: list[Message]) -> Levels | None:
    """Return the levels for pictures like these, and add a note; None where none has more than 8 bits.

    Each comes with whether its values are integers.
    """
    ranges, integer = [], True
    for pixels, is_integer in pictures:
        if pixels.dtype != np.uint8 and (limits := range_of(pixels)) is not None:
            ranges.append(limits)
            integer &= is_integer
    if not ranges:
        return None
    levels = levels_of(ranges, integer)
    notes.append(
        warning(
            f"pictures have more than 8 bits per pixel: the values {levels} are read as 8 bits, from the "
            f"range in {len(ranges)} of them",
            "convert them to 8 bits yourself if the mosaic is too dark or too bright",
        )
    )
    return levels


def _unread_samples(paths: Sequence[Path]) -> list[Message]:
    """Return a note if a sample of the pictures has more samples a pixel than are read."""
    most = 0
    for k in sample_of(len(paths)):
        with contextlib.suppress(UnreadableImageError):
            most = max(most, picture_header(paths[k]).of_samples)
    said = f"pictures have {most} samples a pixel: the first alone is read"
    return [warning(said, "convert them if others show more")] if most else []


def _deep_pictures(paths: Sequence[Path]) -> Iterator[tuple[Raw, bool]]:
    for k in sample_of(len(paths)):
        with contextlib.suppress(UnreadableImageError):
            if picture_header(paths[k]).is_deep:
                yield _decoded(read_bytes(paths[k], MAX_BYTES), is_deep=True)


def _decoded(data: bytes, is_deep: bool, side_px: int | None = None) -> tuple[Raw, bool]:
    """Return all bits of a picture, (h, w) grey or (h, w, 3) BGR, and whether they are integers."""
    try:
        if data.startswith(TIFF_MAGIC) and is_deep:
            pixels, is_integer = gdal_pixels(data)
            return (np.ascontiguousarray(pixels[..., ::-1]) if pixels.ndim == 3 else pixels), is_integer
        if data.startswith(PNG):
            # Pillow checks no CRC while decoding, so a flipped bit would be undetected.
            Pillow.open(io.BytesIO(data), formats=["PNG"]).verify()
        elif not data.startswith(TIFF_MAGIC):
            # The tags are removed, as they are not needed and Pillow warns of damaged ones.
            data = _TAG_BLOCKS.sub(rb"\1none", data[:HEADER_BYTES]) + data[HEADER_BYTES:]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow warns of a TIFF's damaged tags
            with Pillow.open(io.BytesIO(data), formats=["PNG", "JPEG", "TIFF"]) as picture:
                if side_px is not None:
                    picture.draft("L", reduced_size(picture.size, side_px))  # changes a JPEG alone
                pixels = _pixels(picture)
        return (_sixteen_bit(data, grey=pixels.ndim == 2) if is_deep else pixels), True
    except UnreadableImageError:
        raise
    except Exception as e:  # Pillow and GDAL raise any exception for a damaged file
        reason = "truncated" if "truncated" in str(e).lower() else "damaged"
        if data.startswith(TIFF_MAGIC):
            reason = unusual_tiff(data) or reason
        raise UnreadableImageError(reason) from e


def _sixteen_bit(data: bytes, grey: bool) -> Raw:
    """Return all bits of a PNG that Pillow has verified. Pillow itself keeps only the upper byte of
    colours.
    """
    channels = cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYDEPTH | channels)
    if pixels is None:
        raise UnreadableImageError("damaged")
    return np.asarray(pixels, dtype=np.uint16)


def _pixels(picture: Pillow.Image) -> Image:
    mode = picture.mode
    if mode in ("1", "L", "LA", "La") or mode.startswith("I;16"):
        return np.array(picture.convert("L"))
    # numpy takes ten times as long to reverse the channels.
    return np.asarray(cv2.cvtColor(np.asarray(picture.convert("RGB")), cv2.COLOR_RGB2BGR), dtype=np.uint8)
