"""Pictures of which a part is transparent."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from slam.io.photos.import_photos import import_photos
from slam.io.transparent_pixels import transparent_pixels
from tests.slam.io.photos.photo_files import fill, jpeg, warned


def picture(path, channels, least):
    pixels = np.full((6, 8, channels), 255, np.uint8)
    pixels[0, 0, -1] = least
    Image.fromarray(pixels.squeeze()).save(path)
    return path


@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize(("channels", "least", "told"), [(4, 0, 1), (2, 254, 1), (4, 255, 0), (3, 0, 0)])
def test_transparent_pixels_are_told(tmp_path, suffix, channels, least, told):
    whole = picture(tmp_path / f"whole.{suffix}", 3, 255)
    found = transparent_pixels([whole, picture(tmp_path / f"other.{suffix}", channels, least)])
    assert [str(line).startswith("pictures have transparent pixels (1 of 2 that") for line in found] == [
        True
    ] * told


def test_what_is_no_such_picture_is_passed_over(tmp_path):
    (tmp_path / "damaged.png").write_bytes(b"\x89PNG")
    (tmp_path / "a.jpg").write_bytes(jpeg())
    assert transparent_pixels([tmp_path / name for name in ("damaged.png", "a.jpg", "missing.tif")]) == []


def test_photographs_with_a_mask_give_a_warning(tmp_path):
    fill(tmp_path, {})
    for least, name in enumerate("ab"):
        picture(tmp_path / f"{name}.png", 4, least)
    assert warned(import_photos(tmp_path), "transparent pixels", "2 of 2")
