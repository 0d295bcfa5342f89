"""Pictures of maps on a page: small, grey where there is nothing, and of one scale before and after."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from slam.report.pictures.map import shown_area, thumbnail
from slam.report.pictures.mosaic_marks import MapMarks

MARKS = MapMarks("m", False)


def test_a_thumbnail_is_small_and_grey_where_there_is_nothing(tmp_path):
    picture = np.zeros((300, 5000, 4), np.uint8)
    picture[:, 2500:] = [10, 200, 30, 255]
    Image.fromarray(picture).save(tmp_path / "mosaic.png")
    small = np.asarray(Image.open(io.BytesIO(thumbnail(tmp_path / "mosaic.png"))))
    height, width, channels = small.shape
    assert channels == 3
    assert 1000 <= width <= 2000
    assert width / height == pytest.approx(5000 / 300, rel=0.02)
    assert np.abs(small[:, : int(0.45 * width)].astype(int) - [0xB3, 0xB8, 0xBF]).max() <= 2
    assert np.abs(small[:, int(0.55 * width) :].astype(int) - [10, 200, 30]).max() <= 4


def test_before_and_after_have_one_scale_and_show_the_same_ground(tmp_path):
    """A red thing at one place of the ground has one place in both pictures, whose own edges differ."""
    for name, (west, north), (wide, tall), pixel_m in (
        ("mosaic", (-1.0, 2.0), (300, 500), 0.01),
        ("mosaic_chain", (-3.0, 1.5), (400, 240), 0.02),
    ):
        picture = np.full((tall, wide, 3), 90, np.uint8)
        row, col = round((north - 0.5) / pixel_m), round((1.0 - west) / pixel_m)
        reach = round(0.2 / pixel_m)
        picture[row - reach : row + reach, col - reach : col + reach] = 255, 0, 0
        Image.fromarray(picture).save(tmp_path / f"{name}.png")
        corner = west + pixel_m / 2, north - pixel_m / 2
        (tmp_path / f"{name}.pgw").write_text("\n".join(map(str, (pixel_m, 0, 0, -pixel_m, *corner))))
    paths = [tmp_path / "mosaic.png", tmp_path / "mosaic_chain.png"]
    assert shown_area(paths[0]) == pytest.approx((-3.0, -3.3, 5.0, 2.0))
    shown = [_pixels(path) for path in paths]
    heights, widths = np.transpose([pixels.shape[:2] for pixels in shown])
    ratio = widths[0] / widths[1]
    assert heights[0] / heights[1] == pytest.approx(ratio, rel=0.02)
    middle = [_middle_of_red(pixels) for pixels in shown]
    np.testing.assert_allclose(middle[0], middle[1] * ratio, atol=3)


def _pixels(path: Path) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(thumbnail(path, 600, MARKS)))).astype(int)


def _middle_of_red(pixels: np.ndarray) -> np.ndarray:
    return np.argwhere(pixels[..., 0] - pixels[..., 1] > 100).mean(axis=0)
