"""The doubt of a focal length that nothing tells."""

from types import SimpleNamespace

import numpy as np
import pytest

from slam.core.lens_priors import ASSUMED_FOCAL_STD_RATIO, UNKNOWN_FOCAL_STD_RATIO
from slam.mapping.warnings.unknown_focal import unknown_focal_warning


def warning(told_ratio: float, found_ratio: float) -> str:
    lens = SimpleNamespace(calibration=np.full(9, 500.0), std=np.full(9, 500.0 * found_ratio))
    flight = SimpleNamespace(camera=SimpleNamespace(focal_std_ratio=told_ratio))
    return str(unknown_focal_warning(flight, SimpleNamespace(bundle=SimpleNamespace(lens=lens))) or "")


def test_a_focal_length_that_neither_tags_nor_pictures_tell_is_a_reason() -> None:
    assert "these pictures tell it to 15" in warning(UNKNOWN_FOCAL_STD_RATIO, 0.15)


@pytest.mark.parametrize(
    ("told", "found"), [(UNKNOWN_FOCAL_STD_RATIO, 0.02), (ASSUMED_FOCAL_STD_RATIO, 0.09)]
)
def test_one_that_either_tells_is_none(told: float, found: float) -> None:
    assert warning(told, found) == ""


def test_a_map_without_an_estimate_of_the_lens_knows_it_no_better_than_before() -> None:
    flight = SimpleNamespace(camera=SimpleNamespace(focal_std_ratio=UNKNOWN_FOCAL_STD_RATIO))
    for bundle in (None, SimpleNamespace(lens=None)):
        told = str(unknown_focal_warning(flight, SimpleNamespace(bundle=bundle)))
        assert "these pictures do not either: it is assumed, and may be off by 30" in told
        assert "these pictures tell it" not in told
