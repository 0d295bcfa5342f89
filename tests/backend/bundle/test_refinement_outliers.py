"""The refinement with outliers among the observations, and with inputs that it cannot refine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.bundle.refinement import refine
from backend.errors import BackendError
from tests.backend.bundle.made_scenes import SEEDS, SONAR, errors_squared, position_rms
from tests.backend.made_floor import make


def test_outlier_observations_are_dropped_and_counted():
    found = []
    for seed in SEEDS[:10]:
        made, rng = make(SONAR, seed), np.random.default_rng(seed)
        tracks = made.measurements.tracks
        wild = rng.uniform(size=len(tracks.track)) < 0.05
        shift = rng.uniform(30, 90, (len(wild), 2)) * rng.choice([-1, 1], (len(wild), 2))
        pixel = tracks.pixel + wild[:, None] * shift
        bundle = refine(replace(made.measurements, tracks=replace(tracks, pixel=pixel)), made.start)
        # What is left of a point seen twice goes with the wild one.
        twice = np.bincount(tracks.track[~wild], minlength=tracks.track.max() + 1) < 2
        expected = wild.sum() + (twice[tracks.track] & ~wild).sum()
        clean = refine(made.measurements, made.start)
        found.append(
            [
                bundle.dropped_observations / expected,
                position_rms(made, bundle.w_T_b) / position_rms(made, clean.w_T_b),
                errors_squared(made, bundle).mean(),
                bundle.noise.pixel_scale,
            ]
        )
    dropped, rms_ratio, consistency, pixel_scale = np.mean(found, axis=0)
    # A wild one among three draws its point along: one of the others may go too.
    assert 0.97 < dropped < 1.25
    assert rms_ratio < 1.2
    assert 4.6 < consistency < 7.4
    assert pixel_scale == pytest.approx(1.0, rel=0.1)


def test_points_on_walls_do_not_bias_the_relief():
    """Points in the air (5 %, at a quarter of the height) are not taken for relief everywhere."""
    scene = replace(SONAR, relief=0.02, walls=0.05)
    found = [refine(m.measurements, m.start).noise.relief for m in (make(scene, seed) for seed in SEEDS[:10])]
    assert np.mean(found) == pytest.approx(0.02, rel=0.25)


def test_a_camera_below_the_floor_raises():
    made = make(SONAR, 0)
    start = made.start.copy()
    start[5, 2, 3] *= -1
    with pytest.raises(BackendError, match=r"keyframe 5|below the floor"):
        refine(made.measurements, start)


@pytest.mark.parametrize("missing", ["tracks", "camera"])
def test_missing_tracks_or_camera_raise(missing: str):
    made = make(SONAR, 0)
    with pytest.raises(BackendError, match="no tracks of floor points, or no camera"):
        refine(replace(made.measurements, **{missing: None}), made.start)
