"""Photographs that are read reduced."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.features import Extractor, FeatureConfig
from frontend.photographs import Photograph, photographs
from frontend.picture_check import reduced_size
from tests.frontend.floor_pairs import texture

CAMERA = Camera((640.0, 640.0), (319.5, 239.5), (640, 480))


class Reducing:
    """Loader of one picture, smaller by a ratio where it may be."""

    def __init__(self, ratio: int) -> None:
        self.ratio, self.sides = ratio, list[int | None]()
        self.picture = texture(np.random.default_rng(4), 640, 480)

    def __call__(self, k: int) -> NDArray[np.uint8] | None:
        return self.picture

    def load_reduced(self, k: int, side_px: int | None) -> NDArray[np.uint8] | None:
        self.sides.append(side_px)
        size = (640 // self.ratio, 480 // self.ratio)
        return cv2.resize(self.picture, size, interpolation=cv2.INTER_AREA).astype(np.uint8)


def only(load: Reducing, side_px: int) -> Photograph | str:
    extract = Extractor(FeatureConfig(max_side_px=side_px))
    ((_, found),) = photographs(load, 1, extract, CAMERA, lambda k: None, lambda k: None)
    return found


def test_positions_refer_to_the_whole_picture() -> None:
    load = Reducing(2)
    found, whole = only(load, 320), Extractor(FeatureConfig(max_side_px=320))(load.picture, CAMERA)
    assert load.sides == [320]
    assert isinstance(found, Photograph)
    np.testing.assert_array_equal(found.features.pixel, whole.pixel)


def test_other_ratios_than_those_of_a_decoder_are_refused() -> None:
    assert only(Reducing(5), 128) == "of another size than the camera's"


@pytest.mark.parametrize(
    ("size", "side", "reduced"),
    [
        ((5472, 3648), 1400, (2736, 1824)),
        ((5472, 3648), 600, (684, 456)),
        ((2000, 1500), 1400, (2000, 1500)),
        ((60, 44), 12, (15, 11)),
        ((61, 44), 12, (61, 44)),
        ((44, 60), 30, (22, 30)),
        ((10, 8), 1400, (10, 8)),
    ],
)
def test_size_is_the_smallest_of_whole_pixels(
    size: tuple[int, int], side: int, reduced: tuple[int, int]
) -> None:
    assert reduced_size(size, side) == reduced
