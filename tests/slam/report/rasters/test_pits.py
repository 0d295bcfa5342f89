"""Pits deeper than wide are doubted, and wide hollows, gaps between trees and noise are not."""

from __future__ import annotations

import numpy as np

from frontend.mosaic.surface import HeightSource, Surface
from frontend.surface.misregistration import Misregistration
from slam.report.rasters.pits import doubted_pits, lowest_place
from slam.report.rasters.surface import MeasuredGround, height_stds


def surface(height: np.ndarray, std_m: float = 0.1) -> Surface:
    rng = np.random.default_rng(0)
    # A surface is smoothed by a median, which takes most of the noise of single cells.
    noisy = (height + std_m / 2 * rng.standard_normal(height.shape)).astype(np.float32)
    source = np.full(height.shape, HeightSource.PICTURES, np.uint8)
    return Surface(10.0, 20.0, 0.1, noisy, np.full(height.shape, std_m, np.float32), source)


def test_a_pit_deeper_than_wide_is_doubted():
    height = np.zeros((200, 300))
    height[50:70, 100:130] = -6.0  # 2 m x 3 m
    found = doubted_pits(surface(height))
    assert np.array_equal(found, height < -1)
    none_compared = Misregistration((0, 0), np.zeros((0, 2), np.int64), np.zeros((0, 2)), np.zeros((0, 2)))
    facts = MeasuredGround(none_compared, surface(height)).facts
    assert facts.doubted_share == found.mean()
    x, y, lowest_m = facts.doubted_at_m
    assert 20.0 < x < 23.0
    assert 13.0 < y < 15.0
    assert lowest_m < -6.0


def test_wide_hollows_gaps_between_trees_and_noise_are_true():
    height = np.zeros((200, 300))
    height[40:160, 60:220] = -3.0  # 12 m x 16 m
    height[:20, :100] = 8.0
    height[:20, 40:50] = 0.0  # 1 m between crowns
    assert not doubted_pits(surface(height)).any()
    assert lowest_place(surface(height), np.zeros(height.shape, bool)) is None


def test_what_was_filled_in_is_no_measurement_to_doubt():
    height = np.zeros((60, 60))
    height[20:30, 20:30] = -4.0
    given = surface(height)
    given.source[height < -1] = HeightSource.FILLED
    assert not doubted_pits(given).any()


def test_heights_that_nothing_measured_are_as_uncertain_as_the_ground_is_uneven():
    height = np.zeros((200, 300))
    height[:, 150:] = 4.0
    height[50:70, 100:130] = -6.0
    given = surface(height)
    given.source[0, :4] = HeightSource.FILLED, HeightSource.LEVEL, HeightSource.FLOOR, HeightSource.SONAR
    given.std_m[0, 3] = np.nan
    std_m = height_stds(given, doubted_pits(given))
    uneven_m = 4.0 / np.sqrt(2.0)  # half of the ground is 4 m high
    assert np.allclose(std_m[0, :2], uneven_m, rtol=0.02)
    assert std_m[0, 2] == 0.0, "found flat"
    assert std_m[0, 3] == np.float32(0.1), "the usual one"
    assert np.allclose(std_m[height < -1], uneven_m, rtol=0.02), "doubted"
    assert (std_m[100:] == np.float32(0.1)).all()
    nothing = surface(np.zeros((10, 10)))
    nothing.source[:] = HeightSource.FILLED
    assert np.isnan(height_stds(nothing, doubted_pits(nothing))).all(), (
        "how uneven the ground is, is not known"
    )
