"""A floor that has nothing but lines: a map whose covariances and status say what it rests on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from frontend.homography import transfer
from frontend.registration import Registration
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.progress import silent
from slam.evaluation.association import poses_at
from slam.evaluation.nees import nees
from slam.evaluation.trajectory import gauge
from slam.mapping.config import PipelineConfig
from slam.mapping.front_end import FrontEnd, Observations
from slam.mapping.pipeline import optimize_with_observations
from slam.simulation import load_recipe, simulate

OPEN_PX = 30.0
"""Standard deviation between those of directions that lines show and those that they leave open."""

Mapped = tuple[Flight, Estimate, Observations]


@pytest.fixture(scope="module")
def mapped() -> Mapped:
    recipe = load_recipe("court_eight")
    short = replace(recipe, maneuver=replace(recipe.maneuver, way_points=("A", "B", "C", "B", "A")))
    flight = simulate(short, 5)
    return flight, *optimize_with_observations(flight, PipelineConfig())


@pytest.mark.slow
def test_all_keyframes_are_placed_within_their_covariances(mapped):
    flight, estimate, _ = mapped
    assert (estimate.component == 0).mean() > 0.95
    known = estimate.component == 0
    true = poses_at(flight.truth, estimate.stamps_s)[known]
    found, covariances = estimate.w_T_b[known], estimate.covariances[known]
    off = found[:, :3, 3] - found[0, :3, 3] - (true[:, :3, 3] - true[0, :3, 3])
    assert np.linalg.norm(off, axis=1).mean() < 0.15
    consistency = nees((gauge(found[0], true[0]) @ found)[1:], true[1:], covariances[1:])
    assert consistency is not None
    assert 0.5 < consistency.position.mean < 10.0


@pytest.mark.slow
def test_the_status_says_that_lines_do_not_show_motion_along_themselves(mapped):
    _, estimate, _ = mapped
    assert (
        "show lines but few features, and only the instruments measure motion along them" in estimate.status
    )


def whitened_squares(flight: Flight, seen: Observations, registrations: list[Registration]) -> float:
    """Return the mean squared error of registrations, in standard deviations, where lines show it."""
    camera, squares = flight.camera, []
    corners, true = camera.undistort(camera.corners_px), poses_at(flight.truth, seen.stamps_s)
    for r in registrations:
        floor_H_i, floor_H_j = (camera.floor_H_image(true[k]) for k in (r.i, r.j))
        off = transfer(r.i_H_j, corners) - transfer(np.linalg.inv(floor_H_i) @ floor_H_j, corners)
        variance, axes = np.linalg.eigh(r.corner_covariance)
        whitened = axes.T @ off.ravel() / np.sqrt(variance)
        squares.append(np.mean(whitened[variance < OPEN_PX**2] ** 2))
    return float(np.mean(squares))


@pytest.mark.slow
def test_links_and_loops_are_as_exact_as_told(mapped):
    flight, _, seen = mapped
    by_lines = [r for r in seen.registrations if r.by_lines]
    loops = [r for r in by_lines if seen.stamps_s[r.j] - seen.stamps_s[r.i] > 10]
    assert len(loops) > 3
    assert 0.3 < whitened_squares(flight, seen, loops) < 2.0
    links = [r for r in by_lines if r.j == r.i + 1]
    assert len(links) > 20
    assert 0.3 < whitened_squares(flight, seen, links) < 2.0


@pytest.mark.slow
def test_no_picture_of_the_flight_breaks_the_track(mapped):
    _, _, seen = mapped
    assert all(link is not None for link in seen.links[1:])


@pytest.mark.slow
def test_lines_are_followed_without_a_sonar_and_without_an_imu(mapped):
    flight, _, _ = mapped
    for missing in ("sonar", "imu"):
        less = replace(flight, **{missing: None})
        seen = FrontEnd(less, less.camera, PipelineConfig(), silent).track()
        assert all(link is not None for link in seen.links[1:])
