"""Frozen and featureless pictures, and what a stated accuracy rests on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from frontend.keyframes import TOO_FEW
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.summary import summarise
from slam.mapping.pipeline import optimize
from slam.mapping.warnings.lost_pictures import lost_picture_warnings
from slam.simulation import simulate
from slam.simulation.recipe import recipe_from

SMALL = {"world": {"extent_m": [0.0, 0.0, 3.0, 2.0]}, "camera": {"size_px": [176, 144], "rate_hz": 5.0}}


@pytest.fixture(scope="module")
def moving() -> Flight:
    way = {
        "way_points": [[1.0, 1.0], [2.2, 1.0]],
        "height_m": 0.8,
        "cruise_m_s": 0.3,
    }
    return simulate(recipe_from({"name": "small", "maneuver": way, **SMALL}, "small"), seed=1)


def showing(flight: Flight, picture_of: Callable[[int], int | None]) -> Flight:
    """Return the flight with the picture of another number in the place of each, grey for None."""
    frames = flight.frames

    def load(k: int):
        shown = picture_of(k)
        return np.full_like(frames.load(k), 127) if shown is None else frames.load(shown)

    return replace(flight, frames=replace(frames, load=load))


@pytest.mark.slow
def test_frozen_and_featureless_pictures_are_told_with_their_time(moving: Flight):
    stamps_s = moving.frames.stamps_s
    n = len(stamps_s)
    seen = replace(moving, imu=None, velocity=None)  # nothing to bridge a gap with
    estimate = optimize(showing(seen, lambda k: 4 if 4 <= k < 9 else None if k in (n - 3, n - 2) else k))
    assert estimate.status == "ok"
    (frozen,) = [line for line in estimate.warnings if "freeze" in line]
    assert frozen.startswith(f"cam0: 4 of {n} pictures are left out (same picture as the one before)")
    assert f"from {stamps_s[5]:.1f} to {stamps_s[8]:.1f} s" in frozen
    (grey,) = [line for line in estimate.warnings if "without texture" in line]
    assert grey.startswith(f"bare ground: 2 of {n} pictures are left out")


@pytest.mark.parametrize("shown", [0, None])
def test_pictures_that_show_nothing_else_are_refused_with_the_reason(moving: Flight, shown: int | None):
    """Equal pictures contradict the instruments of a vehicle that moves."""
    with pytest.raises(InputError, match=r"\(\d+ x (same picture|.*too)"):
        optimize(showing(moving, lambda _: shown))


def test_equal_pictures_make_a_map_of_one_place(moving: Flight):
    still = replace(moving, imu=None, attitude=None, sonar=None, velocity=None)
    estimate = optimize(showing(still, lambda _: 0))
    n = len(moving.frames)
    assert estimate.frame_index.tolist() == [0, n - 1]
    np.testing.assert_allclose(estimate.w_T_b[1], estimate.w_T_b[0], atol=1e-4)
    assert "one place only" in estimate.status
    assert "its camera froze" in estimate.status
    assert any(f"{n - 2} of {n} pictures are left out (same picture" in line for line in estimate.warnings)


def test_a_stated_accuracy_names_the_one_instrument_that_it_rests_on(moving: Flight):
    estimate = optimize(replace(moving, imu=None))
    assert estimate.accuracy_basis == (
        "Lengths and their accuracy rest on one height sensor alone; no second instrument checks them, and "
        "its gain, its zero and the camera's focal length are taken as exact. "
        "Measure one distance on the ground to check the lengths."
    )
    assert summarise(estimate).to_json()["accuracy_basis"] == estimate.accuracy_basis


def test_all_long_stretches_are_named_in_order_of_time():
    """Two stretches of ten and eight pictures at 2 pictures a second; a single lost one is no stretch."""
    bare = [*range(60, 68), *range(20, 30), 90]
    observations = SimpleNamespace(
        dropped=dict.fromkeys(bare, TOO_FEW), frames=100, camera_stamps_s=np.arange(100) / 2
    )
    (line,) = map(str, lost_picture_warnings(SimpleNamespace(all_keyframes=False), observations))
    assert line.startswith(
        "bare ground: 19 of 100 pictures are left out (too few features), the longest stretches "
        "from 10.0 to 14.5 s and from 30.0 to 33.5 s: "
    )
