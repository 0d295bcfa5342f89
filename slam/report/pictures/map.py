"""The pictures of mosaics in a report: with the landmarks of an evaluation, and with surveyed points.

The maps before and after are drawn over the same ground, so that both have one scale and lie alike.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.core.plot_style import UNMEASURED
from slam.report.page import embedded
from slam.report.pictures.mosaic_marks import MapMarks, Mark, with_marks, with_points

if TYPE_CHECKING:
    from slam.core.control_points import ControlReport
    from slam.report.tables.evaluation import Evaluated

MAP, CHAIN = "mosaic.png", "mosaic_chain.png"
_MOST_PX = 2000
"""Longer side of a picture on a page."""
_STRIP_PX = 64
"""Number of rows of a reduced picture that are computed at a time."""


class GroundArea(NamedTuple):
    """A rectangle of the ground, in the unit of the map."""

    left: float
    bottom: float
    right: float
    top: float


def picture(path: Path | None, marks: MapMarks | None = None) -> str | None:
    """Return a picture as a data address, with marks if it has a world file; None without the file."""
    if path is None or not path.exists():
        return None
    return embedded(thumbnail(path, marks=marks if _is_placed(path) else None), "jpeg")


def map_picture(path: Path | None, marks: MapMarks, evaluated: Evaluated) -> str | None:
    """Return the picture of a map with the landmarks that were compared where that map has them.

    The map of the plain chain, ``mosaic_chain.png``, has them elsewhere than the optimized one.
    """
    if path is None:
        return None
    places = evaluated.chain_landmarks if path.name == CHAIN else evaluated.landmarks
    return picture(path, replace(marks, points=(*marks.points, *(Mark(*place) for place in places))))


def surveyed_marks(report: ControlReport | None) -> tuple[Mark, ...]:
    """Return the control and check points whose survey places them on the ground of the map."""
    points = () if report is None else report.points
    return tuple(Mark(p.name, *p.surveyed_m[:2], True) for p in points if p.surveyed_m is not None)


def bounds_of(path: Path) -> GroundArea:
    """Return what a picture with a world file covers, in the unit of that file; without one, in pixels."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path) as source:
            return GroundArea(*source.bounds)


def shown_area(path: Path) -> GroundArea:
    """Return what the picture of a map shows: the ground of the maps before and after, if both are there."""
    beside = [path.with_name(name) for name in (MAP, CHAIN)]
    both = [bounds_of(each) for each in beside if each.exists() and _is_placed(each)]
    if path not in beside or len(both) < 2:
        return bounds_of(path)
    left, bottom, right, top = zip(*both, strict=True)
    return GroundArea(min(left), min(bottom), max(right), max(top))


def _is_placed(path: Path) -> bool:
    return path.with_suffix(".pgw").exists()


def thumbnail(path: Path, most_px: int = _MOST_PX, marks: MapMarks | None = None) -> bytes:
    """Return a picture of any size as JPEG of at most ``most_px``; transparent pixels become grey.

    ``marks``: points on it, and a scale bar and arrows below it; the picture then needs a world file, and
    shows the ground of `shown_area`.
    """
    from PIL import Image
    from rasterio.env import Env
    from rasterio.errors import NotGeoreferencedWarning

    own = bounds_of(path)
    area = own if marks is None else shown_area(path)
    with warnings.catch_warnings(), Env(GDAL_CACHEMAX=64, GDAL_PAM_ENABLED="NO"):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)  # a plain picture needs no place on Earth
        pixels, pixel_m = _drawn(path, most_px, own, area)
    if marks is not None:
        if marks.points:
            pixels = with_points(pixels, pixel_m, (area.left, area.top), marks.points)
        pixels = with_marks(pixels, pixel_m, marks.unit, marks.on_earth, (area.left, area.top))
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "JPEG", quality=88)
    return stream.getvalue()


def _drawn(path: Path, most_px: int, own: GroundArea, area: GroundArea) -> tuple[NDArray[np.uint8], float]:
    """Return a picture of the ground ``own`` on grey paper of ``area``, and the side of a pixel."""
    share = max(area.right - area.left, area.top - area.bottom) / max(
        own.right - own.left, own.top - own.bottom
    )
    pixels = np.concatenate(list(_shrunk(path, most_px / share)))
    pixel_m = (own.right - own.left) / pixels.shape[1]
    if own == area:
        return pixels, pixel_m
    spans = (area.top - area.bottom, area.right - area.left)
    tall, wide = (max(size, round(span / pixel_m)) for size, span in zip(pixels.shape, spans, strict=False))
    paper = np.empty((tall, wide, *pixels.shape[2:]), np.uint8)
    paper[:] = _paper(pixels.shape[2] if pixels.ndim == 3 else 1)
    starts = (area.top - own.top) / pixel_m, (own.left - area.left) / pixel_m
    row, col = (
        min(round(start), most - size)
        for start, most, size in zip(starts, (tall, wide), pixels.shape, strict=False)
    )
    paper[row : row + pixels.shape[0], col : col + pixels.shape[1]] = pixels
    return paper, pixel_m


def _paper(channels: int) -> NDArray[np.uint8]:
    """Return the grey (channels,) of what no picture shows: white could be ground."""
    from PIL import ImageColor

    colour = np.array(ImageColor.getrgb(UNMEASURED), np.uint8)
    return colour if channels == 3 else np.full(channels, round(float(colour.mean())), np.uint8)


def _shrunk(path: Path, most_px: float) -> Iterator[NDArray[np.uint8]]:
    """Strips of the reduced picture, (h, w, 3) or (h, w), from the top down.

    A PNG can only be read from its beginning: reading out of order would decode all of it again.
    """
    import rasterio
    from rasterio.windows import Window

    with rasterio.open(path) as source:
        shrink = max(1, ceil(max(source.width, source.height) / most_px))
        width, strip = max(1, source.width // shrink), shrink * _STRIP_PX
        for top in range(0, source.height, strip):
            rows = min(strip, source.height - top)
            pixels = np.moveaxis(source.read(window=Window(0, top, source.width, rows)), 0, -1)
            if pixels.shape[2] in (2, 4):
                alpha = pixels[..., -1:].astype(np.float32) / 255
                paper = _paper(pixels.shape[2] - 1)
                pixels = (pixels[..., :-1] * alpha + paper * (1 - alpha)).astype(np.uint8)
            size = width, max(1, rows // shrink)
            yield cv2.resize(np.ascontiguousarray(pixels), size, interpolation=cv2.INTER_AREA)
