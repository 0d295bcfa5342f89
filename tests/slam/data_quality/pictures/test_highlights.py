"""Lamps mirrored in the floor are highlights; boxes, moving things and a plain floor are none."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from frontend.camera import Camera
from slam.criticism.cause import Cause
from slam.criticism.kalman.record import record_of
from slam.criticism.residuals.reading_anomalies import _highlights
from slam.data_quality.pictures.highlights import dimmed, spots
from tests.slam.criticism.camera.camera_flight import matched_flight

CAMERA = Camera((140.8, 140.8), (87.5, 71.5), (176, 144))


def found(terms: dict[str, dict[str, float]], seed: int) -> list[Cause]:
    flight, matches = matched_flight(terms, seed)
    return _highlights([replace(record_of(flight), matches=matches)])


def of_spots(lagging: int, others: int) -> list[Cause]:
    """Found in pairs of pictures with lagging spots of strengths about 0.3, and in pairs with others."""
    strength = np.linspace(0.2, 0.4, lagging)
    seen = [(1.0, 0.0, s) for s in strength] + [(0.0, 1.0, np.nan)] * others
    flat = SimpleNamespace(notable=False)
    matches = SimpleNamespace(spots=np.array(seen).reshape(-1, 3), lens_distortion=flat)
    return _highlights([SimpleNamespace(matches=matches), SimpleNamespace(matches=None)])


def test_spots_that_lag_in_most_pairs_are_a_lamp_of_their_strength():
    (oddity,) = of_spots(20, 10)
    assert oddity.name == "specular_highlights"
    size = oddity.parameters["strength"]
    assert size.low < 0.3 < size.high
    assert size.value == pytest.approx(0.35, abs=0.01), "the upper quartile, as most spots are cut"
    assert oddity.probability > 0.95
    assert of_spots(20, 60) == []
    assert of_spots(1, 0) == []


@pytest.mark.slow
@pytest.mark.parametrize("strength", [0.3, 0.5])
def test_a_mirrored_lamp_is_found_with_its_strength(strength):
    (oddity,) = found({"specular_highlights": {"strength": strength}}, 5)
    assert oddity.name == "specular_highlights"
    size = oddity.parameters["strength"]
    assert size.low < strength < size.high
    assert size.value == pytest.approx(strength, rel=0.3)
    assert oddity.probability > 0.95


@pytest.mark.parametrize(
    "terms",
    [
        pytest.param({}, marks=pytest.mark.slow),
        pytest.param({"floor_steps": {"height": 0.3, "share": 0.15}}, marks=pytest.mark.slow),
        {"moving_objects": {"count": 40.0}},
        pytest.param({"exposure_variation": {"gain": 0.1, "gamma": 0.2, "tau": 0.5}}, marks=pytest.mark.slow),
    ],
)
def test_nothing_else_is(terms):
    assert found(terms, 6) == []


def picture(spot_px: tuple[float, float], floor_px: float) -> np.ndarray:
    """A floor of stripes, moved, with a spot of light on it."""
    x, y = np.meshgrid(np.arange(176), np.arange(144))
    floor = 90 + 40 * np.sin((x - floor_px) / 9.0) * np.cos(y / 7.0)
    light = 120 * np.exp(-0.5 * ((x - spot_px[0]) ** 2 + (y - spot_px[1]) ** 2) / 7.0**2)
    return np.repeat((floor + light)[..., None], 3, axis=2).astype(np.uint8)


@pytest.mark.parametrize(
    ("spot_px", "lagging", "others"),
    # The floor goes by 30 px: the spot by 10, by 30 (a light patch of the floor), by 70, and aside.
    [((80, 70), 1, 0), ((100, 70), 0, 0), ((140, 70), 0, 1), ((100, 110), 0, 1)],
)
def test_only_what_stays_behind_the_floor_lags(spot_px, lagging, others):
    j, i = dimmed(picture((70, 70), 0.0)), dimmed(picture(spot_px, 30.0))
    i_H_j = np.array([[1.0, 0.0, 30.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    seen = spots(i, j, i_H_j, CAMERA)
    assert (seen.lagging, seen.others) == (lagging, others)
    assert not lagging or seen.strength == pytest.approx(120 / 255, rel=0.3)
