"""The paper's floor: a square tile of interlocking foam puzzle pieces with smaller pieces on it.

Source: IMAV 2011 paper, section 4.1 and figures 4 to 7 (large puzzle pieces in a square of 1.6 m x 1.6 m,
smaller pieces inside it to give features; the square repeated for the figure eight).
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

PIECES = 8
"""Pieces along the side of a tile (0.2 m each)."""
LOOSE_PIECES = 26
PALETTE_BGR = np.array(
    [
        (62, 74, 186),
        (70, 150, 205),
        (84, 184, 208),
        (98, 148, 82),
        (168, 118, 64),
        (150, 88, 112),
        (176, 172, 166),
        (92, 92, 98),
    ],
    np.uint8,
)
"""Colours of foam mats: red, orange, yellow, green, blue, purple, light and dark grey."""
GROOVE = 0.55
"""Brightness in the seam between two pieces."""


def puzzle_tile(size_px: int, rng: np.random.Generator) -> Image:
    """Draw a tile (size_px, size_px, 3) BGR whose opposite borders fit together."""
    fine = 2
    piece = size_px * fine / PIECES
    labels = _interlocked(piece, rng)
    colours = _shades(PIECES * PIECES, rng)
    tile = colours[labels]
    seam = cv2.morphologyEx(labels.astype(np.float32), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
    tile[seam] = (tile[seam] * GROOVE).astype(np.uint8)
    for _ in range(LOOSE_PIECES):
        _lay_loose_piece(tile, 0.42 * piece, rng)
    # The tile has an extra piece at each border. Without them it wraps around.
    inner = slice(round(piece), round(piece) + size_px * fine)
    return np.asarray(cv2.resize(tile[inner, inner], (size_px, size_px), interpolation=cv2.INTER_AREA))


def _interlocked(piece: float, rng: np.random.Generator) -> NDArray[np.int32]:
    """Return the piece of each pixel, for the tile and an extra piece on every side."""
    count = PIECES + 2
    edge = np.rint(np.arange(count + 1) * piece).astype(int)
    labels = np.zeros((edge[-1], edge[-1]), np.int32)

    def label(row: int, col: int) -> int:
        return (row - 1) % PIECES * PIECES + (col - 1) % PIECES

    for row in range(count):
        for col in range(count):
            labels[edge[row] : edge[row + 1], edge[col] : edge[col + 1]] = label(row, col)
    tabs = rng.choice([-1, 1], (2, PIECES, PIECES))
    for row in range(count):
        for col in range(count):
            side, lower = (tabs[axis, (row - 1) % PIECES, (col - 1) % PIECES] for axis in (0, 1))
            owner = label(row, col + 1) if side < 0 else label(row, col)
            _tab(labels, ((col + 1) * piece, (row + 0.5) * piece), (side, 0), piece, owner)
            owner = label(row + 1, col) if lower < 0 else label(row, col)
            _tab(labels, ((col + 0.5) * piece, (row + 1) * piece), (0, lower), piece, owner)
    return labels


def _tab(
    labels: NDArray[np.int32], root: tuple[float, float], way: tuple[int, int], piece: float, owner: int
) -> None:
    """Draw a neck and a knob from an edge into the neighbouring piece."""
    neck = np.array(root) + 0.06 * piece * np.array(way)
    knob = np.array(root) + 0.15 * piece * np.array(way)
    cv2.line(labels, _px(root), _px(neck), int(owner), round(0.16 * piece))
    cv2.circle(labels, _px(knob), round(0.115 * piece), int(owner), -1)


def _px(point: tuple[float, float] | NDArray[np.float64]) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))


def _shades(count: int, rng: np.random.Generator) -> Image:
    """Return colours (count, 3) of the palette with small random differences."""
    base = PALETTE_BGR[rng.integers(0, len(PALETTE_BGR), count)].astype(float)
    return np.clip(base * rng.uniform(0.8, 1.15, (count, 1)) + rng.normal(0, 6, (count, 3)), 20, 235).astype(
        np.uint8
    )


def _lay_loose_piece(tile: Image, side: float, rng: np.random.Generator) -> None:
    """Draw a small piece with four knobs and a dark rim, at a random angle, away from the tile's border."""
    rim = 1.6 * side
    center = rng.uniform(len(tile) / (PIECES + 2) + rim, len(tile) * (1 - 1 / (PIECES + 2)) - rim, 2)
    turn = rng.uniform(0, np.pi / 2)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    corners = center + side / 2 * (np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ axes)
    signs = rng.choice([-1, 1], 4)
    colour = _shades(1, rng)[0]
    rim_colour = (colour * GROOVE).astype(int).tolist()
    mask = np.zeros(tile.shape[:2], np.uint8)
    cv2.fillPoly(mask, [np.int32(np.rint(corners))], 255)
    for way, sign in zip((axes[0], axes[1], -axes[0], -axes[1]), signs, strict=True):
        knob = center + way * side * (0.5 + sign * 0.11)
        cv2.circle(mask, _px(knob), round(0.13 * side), 255 if sign > 0 else 0, -1)
    left, top, width, height = cv2.boundingRect(mask)
    around = np.s_[top : top + height, left : left + width]
    tile[around][mask[around] > 0] = colour
    outline, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(tile, outline, -1, rim_colour, 2, cv2.LINE_AA)
