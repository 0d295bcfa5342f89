"""A short simulated flight with pictures, as the camera's tests fly it."""

from __future__ import annotations

import json
from functools import cache

from slam.core.flight import Flight
from slam.data_quality.pictures.feature_matches import FeatureMatches, match_all_pictures
from slam.simulation.recipe import recipe_from
from slam.simulation.recording import record

ROWS = (
    (0, 0.0, 0.0, 0.0, 0.0), (1000, 0.3, 0.0, 0.0, 0.0), (1500, -0.3, 0.2, 0.0, 0.0),
    (2200, 0.0, -0.3, 0.2, 0.0), (2900, 0.0, 0.15, 0.0, 0.4), (4000, 0.2, 0.0, 0.0, -0.4),
    (5000, -0.3, 0.0, -0.2, 0.0), (5800, 0.0, 0.3, 0.0, 0.3), (6500, 0.0, -0.3, 0.0, 0.0),
    (7200, 0.3, 0.0, 0.0, 0.0), (7700, -0.2, 0.0, 0.0, -0.3), (9000, 0.0, 0.0, 0.0, 0.0),
    (10000, 0.0, 0.0, 0.0, 0.0),
)  # fmt: skip
"""Tilts about both axes, climbs and turns: every term of the camera shows."""


def camera_flight(terms: dict[str, dict[str, float]], seed: int, rate_hz: float = 4.0) -> Flight:
    """Ten seconds over a textured floor with some terms."""
    recipe = {
        "name": "seen",
        "maneuver": {"script": [list(row) for row in ROWS], "height_m": 1.2, "start_m": [0.0, 0.0]},
        "world": {"extent_m": [-5.0, -5.0, 5.0, 5.0]},
        "camera": {"rate_hz": rate_hz},
        "imu": {"rate_hz": 100.0},
        "attitude": {"rate_hz": 50.0},
        "terms": terms,
    }
    return record(recipe_from(recipe, "seen"), seed)


def matched_flight(terms: dict[str, dict[str, float]], seed: int) -> tuple[Flight, FeatureMatches]:
    """Such a flight and its matches, made once however many tests look at them."""
    return _matched_flight(json.dumps(terms, sort_keys=True), seed)


@cache
def _matched_flight(terms: str, seed: int) -> tuple[Flight, FeatureMatches]:
    flight = camera_flight(json.loads(terms), seed)
    matches = match_all_pictures([flight])[0]
    assert matches is not None
    return flight, matches
