"""A floor that has nothing but lines: a map whose covariances and status say what it rests on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from frontend.homography import transfer
from frontend.registration import Registration
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.geodesy import GeoOrigin, enu_from_geodetic, geodetic_from_enu
from slam.core.progress import silent
from slam.core.streams import Gps
from slam.evaluation.association import poses_at
from slam.evaluation.nees import nees
from slam.evaluation.trajectory import gauge
from slam.mapping.config import PipelineConfig
from slam.mapping.front_end import FrontEnd, Observations
from slam.mapping.pipeline import optimize, optimize_with_observations
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


@pytest.mark.slow
def test_positions_hold_a_map_over_lines_no_better_than_they_are():
    """The mean of n fixes is no better than one of them over the square root of n, and so is no pose."""
    recipe = load_recipe("court_eight")
    short = replace(recipe, maneuver=replace(recipe.maneuver, way_points=("A", "B", "C")))
    flight = simulate(short, 5)
    truth, std_m = flight.truth, 0.05
    stamps_s = np.arange(truth.stamps_s[0], truth.stamps_s[-1], 0.2)
    w_p_m = np.column_stack([np.interp(stamps_s, truth.stamps_s, x) for x in truth.w_T_b[:, :3, 3].T])
    w_p_m += np.random.default_rng(0).normal(0, std_m, w_p_m.shape)
    origin = GeoOrigin(52.0, 4.0, 10.0)
    gps = Gps(stamps_s, *geodetic_from_enu(w_p_m, origin), noise_std_m=(std_m,) * 3)
    estimate = optimize(replace(flight, gps=gps))
    known = estimate.component == 0
    assert known.all()
    assert estimate.origin is not None
    found = np.sqrt(np.diagonal(estimate.covariances[:, 3:5, 3:5], axis1=1, axis2=2))
    assert found.min() > std_m / np.sqrt(len(stamps_s))
    there = enu_from_geodetic(*geodetic_from_enu(estimate.w_T_b[:, :3, 3], estimate.origin), origin)
    off = (there - poses_at(truth, estimate.stamps_s)[:, :3, 3])[:, :2]
    assert np.sqrt(np.mean((off / found) ** 2)) < 3.0
