"""Maps made in several ways: perfect poses give perfect distances, pictures lie where they should."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.evaluation.aligned_maps import aligned_maps
from slam.evaluation.association import associate, poses_at
from slam.experiments.drawn_map import paint
from slam.experiments.stitching import (
    LARGEST,
    at_pace,
    consecutive,
    filtered,
    landmark_errors,
    placed,
    with_pictures,
)
from slam.mapping.pipeline import optimize
from tests.slam.small_flight import flown, only


@pytest.fixture(scope="module")
def flight():
    return only(flown(2), range(64))


@pytest.fixture(scope="module")
def estimate(flight):
    return optimize(flight)


@pytest.fixture(scope="module")
def perfect(flight, estimate):
    return placed(replace(estimate, floor_z_m=0.0), poses_at(flight.truth, estimate.stamps_s))


def off_truth(made, flight):
    """(m,) how far each position lies from the true one, the first pose and heading on the truth's."""
    placed_poses = aligned_maps(made, associate(made, flight)).loops.w_T_b
    return np.linalg.norm((placed_poses - poses_at(flight.truth, made.stamps_s))[:, :3, 3], axis=1)


def test_pace_takes_the_next_picture_that_is_there(flight):
    taken = at_pace(flight, 0.3).frames
    assert np.diff(taken.stamps_s).min() >= 0.25 - 1e-9
    assert np.diff(taken.stamps_s).max() <= 0.375 + 1e-9
    assert np.diff(taken.stamps_s).mean() == pytest.approx(0.3, rel=0.02)
    assert set(taken.names) <= set(flight.frames.names)
    assert np.array_equal(taken[3].read(), flight.frames[flight.frames.names.index(taken.names[3])].read())
    everything = at_pace(flight, 1e-3).frames
    assert everything.names == flight.frames.names


def test_some_pictures(flight):
    some = with_pictures(flight, np.array([5, 2]))
    assert some.frames.names == (flight.frames.names[5], flight.frames.names[2])
    assert np.array_equal(some.frames[1].read(), flight.frames[2].read())


@pytest.mark.slow
def test_perfect_poses_have_perfect_landmarks(flight, perfect):
    errors = landmark_errors(perfect, flight)
    assert errors.percent == {"A-B": pytest.approx(0, abs=1e-6), LARGEST: pytest.approx(0, abs=1e-6)}
    for name, place in errors.places.items():
        assert place == pytest.approx(flight.landmarks[name], abs=1e-6)


@pytest.mark.slow
def test_a_map_too_large_by_a_percent_is_off_by_one(flight, perfect):
    grown = perfect.w_T_b.copy()
    grown[:, :3, 3] *= 1.01
    errors = landmark_errors(placed(perfect, grown), flight)
    assert errors.percent["A-B"] == pytest.approx(1.0, abs=1e-6)
    assert errors.error_m["A-B"] == pytest.approx(0.01 * 1.2, abs=1e-8)


@pytest.mark.slow
def test_a_map_that_ends_early_has_no_error_to_report(flight, perfect):
    broken = perfect.w_T_b.copy()
    broken[3:] = np.nan
    errors = landmark_errors(placed(perfect, broken), flight)
    assert np.isnan(errors.percent[LARGEST])


def test_the_papers_chain_drifts_a_little_and_starts_where_the_estimate_does(flight, estimate):
    made = consecutive(flight, estimate)
    assert len(made.stamps_s) > 0.95 * len(at_pace(flight, 0.15).frames)
    assert [flight.frames.names[k] for k in made.frame_index] == list(made.frame_names)
    assert made.stamps_s == pytest.approx(flight.frames.stamps_s[made.frame_index])
    off = off_truth(made, flight)
    assert off[:5].max() < 0.02
    assert 0.001 < off.max() < 0.2


@pytest.mark.slow
def test_the_filters_map_is_near_and_no_picture_helps_it(flight, estimate):
    made = filtered(flight, estimate)
    assert [flight.frames.names[k] for k in made.frame_index] == list(made.frame_names)
    off = off_truth(made, flight)
    assert 0.002 < off.max() < 0.15
    assert landmark_errors(made, flight).percent["A-B"] < 10
    dark = replace(flight, frames=replace(flight.frames, load=lambda _: None))
    assert np.array_equal(filtered(dark, estimate).w_T_b, made.w_T_b)


def test_the_canvas_shows_each_mark_where_the_map_has_it(flight, perfect):
    """A mark is a white disc with a dark ring; there, and nowhere near, the canvas is that bright."""
    errors = landmark_errors(perfect, flight)
    canvas = paint(perfect, flight, errors)
    left, right, bottom, top = canvas.extent_m
    height, width = canvas.rgb.shape[:2]
    assert (right - left) / width == pytest.approx((top - bottom) / height, rel=1e-6)
    grey = canvas.rgb.mean(axis=2)
    y, x = np.mgrid[:height, :width]
    x_m = left + (x + 0.5) * (right - left) / width
    y_m = top - (y + 0.5) * (top - bottom) / height
    for place in canvas.places.values():
        away = np.hypot(x_m - place[0], y_m - place[1])
        rim, ring = (away > 0.0555) & (away < 0.059), (away > 0.046) & (away < 0.052)
        assert grey[rim].mean() > grey[ring].mean() + 40
    assert canvas.pairs == (("A", "B"),)
