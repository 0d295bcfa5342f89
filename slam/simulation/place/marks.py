"""Marks of landmarks: white discs with a ring and a letter, which a person finds in the mosaic."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]


def draw_mark(texture: Image, name: str, center: tuple[float, float], radius: float) -> None:
    """Draw a white disc with a black ring and the name, eight times too large and averaged down."""
    fine, half = 8, int(np.ceil(radius)) + 2
    size = (2 * half + 1) * fine
    corner = np.floor(np.array(center) + 0.5).astype(int) - half
    middle = (np.array(center) - corner + 0.5) * fine - 0.5
    y, x = np.mgrid[:size, :size]
    distance = np.hypot(x - middle[0], y - middle[1]) / (radius * fine)
    patch = np.full((size, size), 245, np.uint8)
    patch[(distance > 0.74) & (distance < 0.90)] = 15
    font, bold = cv2.FONT_HERSHEY_DUPLEX, max(1, round(radius * fine / 7))
    (w, h), _ = cv2.getTextSize(name, font, 1.0, 1)
    scale = 0.95 * radius * fine / np.hypot(w, h)
    (w, h), _ = cv2.getTextSize(name, font, scale, bold)
    cv2.putText(
        patch, name, (round(middle[0] - w / 2), round(middle[1] + h / 2)), font, scale, 15, bold, cv2.LINE_AA
    )
    area = (2 * half + 1, 2 * half + 1)
    ink = cv2.resize(patch, area, interpolation=cv2.INTER_AREA).astype(float)
    cover = cv2.resize((distance < 1).astype(np.float32), area, interpolation=cv2.INTER_AREA)
    rows, cols = (np.arange(2 * half + 1) + corner[axis] for axis in (1, 0))
    r, c = ((rows >= 0) & (rows < texture.shape[0])), ((cols >= 0) & (cols < texture.shape[1]))
    if r.any() and c.any():
        under = texture[np.ix_(rows[r], cols[c])]
        over, share = ink[np.ix_(r, c)][..., None], cover[np.ix_(r, c)][..., None]
        texture[np.ix_(rows[r], cols[c])] = np.rint(share * over + (1 - share) * under).astype(np.uint8)
