"""Ground of a few long waves, on whose flatness the tilt of a map rests."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest

from backend.bundle.accuracy.information_shares import information_shares
from backend.bundle.refinement import refine
from slam.core.messages import Message
from slam.mapping.warnings.rolling_ground import rolling_ground_warning
from tests.backend.bundle.made_scenes import SONAR, SURVEY
from tests.backend.made_floor import Scene, make

LONG = replace(
    SONAR, attitude_std_rad=None, rolling=0.04, wavelengths=(3.0, 5.0), points_in_view=100, keyframes=24
)


def warning(scene: Scene, seed: int = 2) -> Message | None:
    made = make(scene, seed)
    bundle = refine(made.measurements, made.start, made.floor_z_m)
    return rolling_ground_warning(
        SimpleNamespace(bundle=bundle, metric=True), information_shares(bundle.optimum)
    )


def test_waves_as_long_as_the_map_are_told_where_nothing_else_tells_the_tilt():
    told = warning(LONG)
    assert "in waves as long as the map" in str(told)
    assert "record the attitude or positions" in str(told)


@pytest.mark.parametrize(
    "scene",
    [
        replace(LONG, wavelengths=(0.5, 1.0)),
        replace(LONG, attitude_std_rad=0.003),
        replace(LONG, rolling=0.0),
        replace(SURVEY, relief=0.0, points_in_view=50),
    ],
    ids=["short waves", "attitude", "flat", "gps"],
)
def test_other_maps_have_no_such_reason(scene: Scene):
    assert warning(scene) is None


def test_a_map_without_a_refinement_has_none():
    assert rolling_ground_warning(SimpleNamespace(bundle=None), {}) is None
