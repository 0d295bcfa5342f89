"""The refinement with outliers among the observations, and with inputs that it cannot refine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.bundle.refinement import refine
from backend.errors import BackendError
from backend.measurements import Measurements
from tests.backend.bundle.made_scenes import SEEDS, SONAR, errors_squared, position_rms
from tests.backend.made_floor import Scene, make


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


BAROMETER = replace(SONAR, range_std_m=None, barometer_std_m=0.05, height_swing=0.4)


def _wild(measurements: Measurements, kind: str, at: int) -> Measurements:
    """Return the measurements with one reading of an instrument far off."""
    readings = list(getattr(measurements, kind))
    one = readings[at]
    readings[at] = {
        "ranges": lambda: replace(one, range_m=4 * one.range_m),
        "heights": lambda: replace(one, height_m=one.height_m + 40.0),
        "attitudes": lambda: replace(one, roll_pitch_yaw_rad=one.roll_pitch_yaw_rad + [1.2, -0.8, 0.0]),
    }[kind]()
    return replace(measurements, **{kind: tuple(readings)})


@pytest.mark.parametrize(
    ("scene", "kind"),
    [(SONAR, "ranges"), (SONAR, "attitudes"), (BAROMETER, "heights")],
    ids=lambda x: str(x)[:9],
)
@pytest.mark.parametrize("at", [0, 9])
def test_one_wild_reading_of_an_instrument_moves_no_map(scene: Scene, kind: str, at: int):
    """Neither the map nor its accuracy may rest on one reading that the others contradict."""
    made = make(scene, 1)
    clean = refine(made.measurements, made.start)
    bundle = refine(_wild(made.measurements, kind, at), made.start)
    scale, tilt = (
        np.log(bundle.w_T_b[:, 2, 3].mean() / clean.w_T_b[:, 2, 3].mean()),
        np.linalg.norm(bundle.w_T_b[:, 2, :2] - clean.w_T_b[:, 2, :2], axis=1).max(),
    )
    assert abs(scale) < clean.scale_std
    assert tilt < scene.attitude_std_rad
    assert bundle.scale_std < 1.5 * clean.scale_std
