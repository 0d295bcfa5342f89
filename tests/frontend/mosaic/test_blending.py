"""Multi-band blending."""

from __future__ import annotations

import cv2
import numpy as np

from frontend.mosaic.blending import MultiBand


def test_one_picture_with_an_irregular_mask_is_unchanged() -> None:
    rng = np.random.default_rng(1)
    picture = rng.uniform(0, 255, (160, 192, 3)).astype(np.float32)
    mask = (cv2.GaussianBlur(rng.normal(size=(160, 192)), (0, 0), 4) > 0).astype(np.float32)
    band = MultiBand(160, 192)
    band.add(picture, mask, 0, 0)
    np.testing.assert_allclose(band.blend()[mask > 0], picture[mask > 0], atol=1e-3)


def test_partition_of_one_picture_reproduces_it() -> None:
    rng = np.random.default_rng(2)
    picture = rng.uniform(0, 255, (160, 192, 3)).astype(np.float32)
    part = rng.integers(0, 3, (10, 12)).repeat(16, 0).repeat(16, 1)
    band = MultiBand(160, 192)
    for i in range(3):
        band.add(picture, (part == i).astype(np.float32), 0, 0)
    np.testing.assert_allclose(band.blend(), picture, atol=1e-3)


def test_step_of_brightness_becomes_a_ramp_and_detail_stays_sharp() -> None:
    columns = np.arange(256)
    stripes = 10.0 * (columns % 2)
    left = np.broadcast_to((100 + stripes)[None, :, None], (128, 256, 3)).astype(np.float32)
    right = left + np.float32(40)
    mask = np.broadcast_to((columns < 128)[None], (128, 256)).astype(np.float32)
    band = MultiBand(128, 256)
    band.add(left, mask, 0, 0)
    band.add(right, 1 - mask, 0, 0)
    row = band.blend()[64, :, 0] - stripes
    np.testing.assert_allclose(row[:50], 100, atol=0.5)
    np.testing.assert_allclose(row[-50:], 140, atol=0.5)
    ramp = np.diff(cv2.blur(row[None], (2, 1))[0])
    assert ramp.max() < 6, "a hard seam would jump by 40"
    assert ramp.min() > -1.0, "no halo"


def test_part_of_the_rectangle_is_blended_at_its_position() -> None:
    picture = np.full((96, 96, 3), 50, np.float32)
    mask = np.zeros((96, 96), np.float32)
    mask[32:64, 32:64] = 1
    band = MultiBand(192, 256)
    band.add(picture, mask, 64, 128)
    out = band.blend()
    np.testing.assert_allclose(out[96:128, 160:192], 50, atol=1e-4)
