"""Marks on the picture of a mosaic: points with names on it, scale bar and directions below it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.core.units import axis_names

Image = NDArray[np.uint8]

_STRIP_SHARE, _LEAST_STRIP_PX = 0.05, 28
"""Height of the strip over the width of the picture, and in pixels at least."""
_BAR_SHARE = 0.3
"""Longest bar over the width of the picture."""
_LEAST_TICKS = 4
"""Steps between coordinates along the longer side, at least."""
_BLACK, _WHITE = (31, 35, 40), 255
_CAPITAL_PX = 21
"""Height of a capital letter of the font at size 1."""
_LETTER_SHARE = 0.035
"""Height of the letters of a landmark over the width of the picture, which is shown half a page wide."""
_CROWDED = 0.6
"""Size of all marks where signs would cover each other: that of surveyed points for landmarks."""
_SURVEYED_SHARE = 0.02
"""The same of control points, which are more and have longer names: as tall as the text of a caption."""
_TRIANGLE = np.array([(-np.sqrt(3) / 2, 0.5), (np.sqrt(3) / 2, 0.5), (0.0, -1.0)])
"""Corners of the sign of a surveyed point, around its middle."""


class Mark(NamedTuple):
    """A point on the picture of a map, with its name beside it."""

    name: str
    x: float
    y: float
    """Its place on the map, in the unit of the map."""
    surveyed: bool = False
    """Whether it is a control or check point, which is drawn as a triangle, and not as a ring."""


@dataclass(frozen=True)
class MapMarks:
    """Marks for the picture of a mosaic."""

    unit: str
    """Unit of lengths."""
    on_earth: bool
    """Whether x is east and y is north."""
    points: tuple[Mark, ...] = ()

    @property
    def axes(self) -> tuple[str, str]:
        """Names of the directions to the right and up."""
        return axis_names(self.on_earth)


def with_points(pixels: Image, pixel_m: float, corner: tuple[float, float], points: Sequence[Mark]) -> Image:
    """Return a north-up picture (h, w, 3) with a ring or a triangle and a name at each point.

    ``corner``: x and y of its upper left corner; ``pixel_m``: the side of a pixel.
    """
    marked = pixels.copy()
    pens = [_Pen.of(mark, pixel_m, corner, marked.shape[1]) for mark in points]
    if any(a.sign.shared_px(b.sign) for a, b in combinations(pens, 2)):
        pens = [_Pen.of(mark, pixel_m, corner, round(_CROWDED * marked.shape[1])) for mark in points]
    taken = [pen.sign for pen in pens]
    for pen in pens:
        for color, thickness in ((_WHITE,) * 3, 4 * pen.edge), (_BLACK, pen.edge):
            if pen.mark.surveyed:
                corners = np.round(pen.at + pen.radius * _TRIANGLE).astype(np.int32)
                cv2.polylines(marked, [corners], True, color, thickness, cv2.LINE_AA)
            else:
                cv2.circle(marked, pen.at, pen.radius, color, thickness, cv2.LINE_AA)
    for pen in pens:
        # The first of the freest places: a name at the right of its sign is read best.
        place = min(pen.places(), key=lambda box: box.cut_off(marked) + sum(map(box.shared_px, taken)))
        taken.append(place)
        pen.write(marked, place)
    return marked


class _Box(NamedTuple):
    """A rectangle of a picture, in pixels."""

    left: int
    top: int
    right: int
    bottom: int

    def shared_px(self, other: _Box) -> int:
        """Area that two rectangles share."""
        wide = min(self.right, other.right) - max(self.left, other.left)
        tall = min(self.bottom, other.bottom) - max(self.top, other.top)
        return max(0, wide) * max(0, tall)

    def cut_off(self, picture: Image) -> int:
        """Area that lies outside a picture."""
        whole = (self.right - self.left) * (self.bottom - self.top)
        return whole - self.shared_px(_Box(0, 0, picture.shape[1], picture.shape[0]))


@dataclass(frozen=True)
class _Pen:
    """The sizes with which a mark is drawn, in pixels."""

    mark: Mark
    at: tuple[int, int]
    radius: int
    edge: int
    tall: float

    @classmethod
    def of(cls, mark: Mark, pixel_m: float, corner: tuple[float, float], width_px: int) -> _Pen:
        at = round((mark.x - corner[0]) / pixel_m), round((corner[1] - mark.y) / pixel_m)
        tall = (_SURVEYED_SHARE if mark.surveyed else _LETTER_SHARE) * width_px
        radius = max(2, round((0.8 if mark.surveyed else 0.4) * tall))
        return cls(mark, at, radius, max(1, round(0.08 * tall)), tall)

    @property
    def sign(self) -> _Box:
        """The ring or the triangle."""
        (x, y), r = self.at, self.radius
        return _Box(x - r, y - r, x + r, y + r)

    def places(self) -> list[_Box]:
        """Places for the name: beside the sign, right before left, above its middle before below it."""
        wide = cv2.getTextSize(self.mark.name, cv2.FONT_HERSHEY_SIMPLEX, self.size, self.edge)[0][0]
        aside, up = round(1.4 * self.radius), round(0.6 * self.radius)
        (x, y), tall = self.at, round(self.tall)
        lefts, lows = (x + aside, x - aside - wide), (y - up, y + up + tall)
        return [_Box(left, low - tall, left + wide, low) for low in lows for left in lefts]

    @property
    def size(self) -> float:
        """Size of the font."""
        return self.tall / _CAPITAL_PX

    def write(self, marked: Image, place: _Box) -> None:
        """Write the name with a white border."""
        edge, name = self.edge, self.mark.name
        # A thicker pen does not make a border: the font of OpenCV 5 takes the thickness as its weight.
        around = [(i * edge, j * edge) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
        for (right, down), color in [*((shift, (_WHITE,) * 3) for shift in around), ((0, 0), _BLACK)]:
            at = place.left + right, place.bottom + down
            cv2.putText(marked, name, at, cv2.FONT_HERSHEY_SIMPLEX, self.size, color, edge, cv2.LINE_AA)


def with_marks(
    pixels: Image, pixel_m: float, unit: str, on_earth: bool, corner: tuple[float, float] | None = None
) -> Image:
    """Return a north-up picture (h, w) or (h, w, 3) with a strip below it that holds a scale bar and arrows.

    ``pixel_m`` is the side of a pixel in ``unit``. The arrows are x and y, or east and north. With
    ``corner``, x and y of the upper left corner, the picture has coordinates at its left and lower edge.
    """
    picture = pixels if pixels.ndim == 3 else cv2.cvtColor(pixels, cv2.COLOR_GRAY2RGB)
    height = max(_LEAST_STRIP_PX, round(_STRIP_SHARE * picture.shape[1]))
    if corner is not None:
        picture = _with_ticks(picture, pixel_m, corner, height)
    width = picture.shape[1]
    strip = np.full((height, width, 3), _WHITE, np.uint8)
    _scale_bar(strip, pixel_m, unit)
    _arrows(strip, ("E", "N") if on_earth else ("x", "y"))
    return np.concatenate([picture, strip])


def _with_ticks(picture: Image, pixel_m: float, corner: tuple[float, float], strip_px: int) -> Image:
    """Return the picture in a frame with coordinates at round places along its left and its lower edge."""
    tall, wide = picture.shape[:2]
    step = bar_length(max(tall, wide) * pixel_m / _LEAST_TICKS)
    size, tick, thick = strip_px / 60, strip_px // 6, max(1, strip_px // 30)
    across = _round_places(corner[0], corner[0] + wide * pixel_m, step)
    upward = _round_places(corner[1] - tall * pixel_m, corner[1], step)
    left = 2 * tick + max((_written(y, size)[1] for y in upward), default=0)
    framed = np.full((tall + strip_px, left + wide, 3), _WHITE, np.uint8)
    framed[:tall, left:] = picture
    cv2.rectangle(framed, (left - thick, 0), (left + wide - 1, tall + thick), _BLACK, thick)
    for x in across:
        text, text_wide, text_tall = _written(x, size)
        at = left + round((x - corner[0]) / pixel_m)
        cv2.line(framed, (at, tall), (at, tall + tick), _BLACK, thick)
        begin = min(max(at - text_wide // 2, 0), left + wide - text_wide)
        _write(framed, text, (begin, tall + 3 * tick // 2 + text_tall), size)
    for y in upward:
        text, text_wide, text_tall = _written(y, size)
        at = round((corner[1] - y) / pixel_m)
        cv2.line(framed, (left - tick, at), (left, at), _BLACK, thick)
        low = min(max(at + text_tall // 2, text_tall), tall)
        _write(framed, text, (left - 3 * tick // 2 - text_wide, low), size)
    return framed


def _round_places(low: float, high: float, step: float) -> list[float]:
    """Return the multiples of ``step`` between two ends."""
    return [step * k for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)]


def _written(value: float, size: float) -> tuple[str, int, int]:
    """Return a coordinate as text, and the width and the height of that in pixels."""
    text = f"{value:g}"
    (wide, tall), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
    return text, wide, tall


def bar_length(longest: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is no longer."""
    power = 10.0 ** np.floor(np.log10(longest))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= longest * (1 + 1e-9)))


def _scale_bar(strip: Image, pixel_m: float, unit: str) -> None:
    height, width = strip.shape[:2]
    length = bar_length(_BAR_SHARE * width * pixel_m)
    left, right = height // 4, height // 4 + round(length / pixel_m)
    low, thick = round(0.75 * height), max(1, height // 16)
    cv2.line(strip, (left, low), (right, low), _BLACK, thick)
    for end in (left, right):
        cv2.line(strip, (end, low - height // 6), (end, low + height // 6), _BLACK, thick)
    _text(strip, f"{length:g} {unit}", (left + thick + height // 10, round(0.5 * height)))


def _arrows(strip: Image, names: tuple[str, str]) -> None:
    """Draw both directions from one corner at the right end."""
    height, width = strip.shape[:2]
    reach, thick = round(0.55 * height), max(1, height // 20)
    corner = width - 4 * height // 2, round(0.8 * height)
    if corner[0] < width // 2:
        return
    for end, name, at in (
        ((corner[0] + reach, corner[1]), names[0], (reach + height // 8, height // 8)),
        ((corner[0], corner[1] - reach), names[1], (-height // 2, -reach + height // 4)),
    ):
        cv2.arrowedLine(strip, corner, end, _BLACK, thick, cv2.LINE_AA, tipLength=0.3)
        _text(strip, name, (corner[0] + at[0], corner[1] + at[1]))


def _text(strip: Image, text: str, at: tuple[int, int]) -> None:
    _write(strip, text, at, strip.shape[0] / 60)


def _write(strip: Image, text: str, at: tuple[int, int], size: float) -> None:
    # A thicker pen fills small letters: the font of OpenCV 5 takes the thickness as its weight.
    cv2.putText(strip, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, _BLACK, 1, cv2.LINE_AA)
