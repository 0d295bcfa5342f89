"""Read-out time of a video in refinements: its frames show how the camera moves and turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gtsam.symbol_shorthand import X as POSE

from backend.bundle.accuracy.row_motion_errors import row_motion_covariances
from backend.bundle.exposure_motion import READOUT
from backend.bundle.factors import WORLD
from backend.bundle.refinement import Bundle
from backend.measurements import RowExposure
from tests.backend.bundle.made_scenes import SEEDS, SURVEY, errors_squared, position_rms
from tests.backend.bundle.rolling_scenes import READOUT_S, as_global, refined
from tests.backend.made_floor import CAMERA, Made, Scene, camera_turns, make

GLOBAL = replace(SURVEY, position_std_m=(0.03, 0.05), turn_std_rad_s=0.3)
ROLLING = replace(GLOBAL, readout_s=READOUT_S)
"""Turns of 0.3 rad/s move the picture by two pixels meanwhile, as much as its speed of 15 m/s does."""
XY = np.array([[-0.6, -0.4], [0.6, -0.4], [0.6, 0.4], [-0.6, 0.4]])


def video(scene: Scene, seed: int, **exposure: object) -> Made:
    """The scene by a camera of unknown shutter."""
    made = make(scene, seed)
    n = scene.keyframes
    speed = floor_speed(made, camera_turns(scene))
    how = RowExposure(int(scene.size_px[1]), None, np.full((n, 3), np.nan), xy=XY, floor_speed=speed)
    return replace(made, measurements=replace(made.measurements, exposure=replace(how, **exposure)))


def floor_speed(made: Made, turn: np.ndarray) -> np.ndarray:
    """Speeds (n, 4, 2) in the directions ``XY``, by differences of projections."""
    w_T_c = made.w_T_b @ CAMERA.b_T_c
    velocity, out = np.gradient(w_T_c[:, :3, 3], axis=0), []
    for pose, v, rate in zip(w_T_c, velocity, turn, strict=True):
        ray = np.column_stack([XY, np.ones(4)])
        point = ray * ((made.floor_z_m - pose[2, 3]) / (ray @ pose[2, :3]))[:, None]
        later = point - 1e-6 * (v @ pose[:3, :3] + np.cross(rate, point))
        out.append((later[:, :2] / later[:, 2:] - XY) / 1e-6)
    return np.array(out)


@pytest.fixture(scope="module")
def made() -> Made:
    return video(ROLLING, 1)


@pytest.fixture(scope="module")
def found(made: Made) -> Bundle:
    return refined(made)


def test_the_read_out_time_is_estimated_by_velocities_and_turns(made: Made, found: Bundle):
    assert found.readout.is_estimated
    assert found.readout.known_velocities == 16, "at the ends of strips too"
    assert abs(found.readout.readout_s - READOUT_S) < 3 * found.readout.std_s
    assert found.readout.std_s < 0.03 * READOUT_S
    assert position_rms(made, found.w_T_b) < 0.3 * position_rms(made, as_global(made).w_T_b)
    assert np.median(errors_squared(made, found)) < 2 * 5.35  # the median of chi-square with 6 freedoms


def test_the_turn_from_the_first_row_to_the_last_is_in_body_axes(found: Bundle):
    turned = READOUT_S * camera_turns(ROLLING) @ CAMERA.b_T_c[:3, :3].T
    np.testing.assert_allclose(found.row_turn_rad, turned, atol=0.05 * np.abs(turned).max())


def test_a_global_shutter_is_fixed_and_leaves_the_map_as_it_is():
    made = video(GLOBAL, 1)
    found, before = refined(made), as_global(made)
    assert (found.readout.is_estimated, found.readout.readout_s) == (False, 0)
    np.testing.assert_array_equal(found.w_T_b, before.w_T_b)
    np.testing.assert_array_equal(found.covariances, before.covariances)


@pytest.mark.parametrize("stated_s", [0.015, pytest.param(-READOUT_S, marks=pytest.mark.slow)])
def test_a_stated_time_that_the_pictures_refute_is_estimated(made: Made, found: Bundle, stated_s: float):
    exposure = replace(made.measurements.exposure, readout_s=stated_s)
    wrong = refined(replace(made, measurements=replace(made.measurements, exposure=exposure)))
    assert wrong.readout.is_estimated
    assert wrong.readout.stated_s == stated_s
    assert wrong.readout.readout_s == pytest.approx(found.readout.readout_s, abs=found.readout.std_s)


def test_a_stated_time_that_is_right_is_fixed(made: Made):
    exposure = replace(made.measurements.exposure, readout_s=READOUT_S)
    right = refined(replace(made, measurements=replace(made.measurements, exposure=exposure)))
    assert (right.readout.readout_s, right.readout.is_estimated) == (READOUT_S, False)


def test_pixels_that_are_corrected_by_nearly_the_time_give_the_same_map(made: Made, found: Bundle):
    """As after an earlier map, which has refuted a global shutter."""
    optimum, nearly_s = found.optimum, READOUT_S - 0.002
    motion, tracks = optimum.problem.exposure_motion, made.measurements.tracks
    pixel = tracks.pixel + (optimum.problem.tracks.pixel - tracks.pixel) * (nearly_s / motion.readout_s)
    exposure = replace(made.measurements.exposure, corrected_s=nearly_s, is_refuted=True)
    measured = replace(made.measurements, tracks=replace(tracks, pixel=pixel), exposure=exposure)
    again = refined(replace(made, measurements=measured))
    assert again.readout.is_estimated
    assert again.readout.stated_s is None
    assert again.readout.readout_s == pytest.approx(found.readout.readout_s, abs=0.5 * found.readout.std_s)


@pytest.mark.slow
def test_the_told_deviation_of_the_time_is_that_of_its_errors():
    found = [refined(video(ROLLING, seed)).readout for seed in SEEDS]
    assert all(each.is_estimated for each in found)
    off = np.array([(each.readout_s - READOUT_S) / each.std_s for each in found])
    assert 0.4 < np.mean(off**2) < 2.0


@pytest.mark.slow
def test_no_global_shutter_is_taken_for_a_rolling_one():
    for scene in (GLOBAL, replace(GLOBAL, relief=0.03)):
        assert not any(refined(video(scene, seed)).readout.is_estimated for seed in SEEDS)


def test_errors_of_the_motion_count_in_the_covariances_as_much_as_they_bend_the_pictures(made: Made):
    """Turns of 6 mrad from the first row to the last are wrong."""
    wrong = camera_turns(ROLLING) + np.random.default_rng(11).normal(0, 0.2, (16, 3))
    exposure = replace(made.measurements.exposure, floor_speed=floor_speed(made, wrong))
    found = refined(replace(made, measurements=replace(made.measurements, exposure=exposure)))
    assert 3.0 < np.mean(errors_squared(made, found)) < 9.0, "14 by the noise of pixels alone"


def test_the_covariances_of_a_motion_without_errors_are_those_of_the_pixels(found: Bundle):
    linear = found.optimum.linearise()
    reduced = linear.eliminate()
    added = row_motion_covariances(found.optimum, linear, reduced, readout_std_s=0.0)
    plain = reduced.joint_covariances([POSE(k) for k in range(16)], WORLD)
    share = np.diagonal(added, axis1=1, axis2=2)[:, :6] / np.diagonal(plain, axis1=1, axis2=2)[:, :6]
    assert share.max() < 0.3


def test_a_larger_deviation_of_the_read_out_time_counts_in_the_covariances(found: Bundle):
    linear = found.optimum.linearise()
    reduced = linear.eliminate()
    one, two = (row_motion_covariances(found.optimum, linear, reduced, std_s) for std_s in (1.0, 2.0))
    with_readout = reduced.joint_covariances([POSE(k) for k in range(16)], READOUT)
    by_second = with_readout[:, :6, 6] / with_readout[:, 6:, 6]
    expected = 3.0 * by_second[:, :, None] * by_second[:, None, :]
    np.testing.assert_allclose((two - one)[:, :6, :6], expected, rtol=1e-6, atol=1e-9 * expected.max())
