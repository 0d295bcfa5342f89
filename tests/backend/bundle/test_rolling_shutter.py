"""Read-out time of a rolling shutter in refinements; the rows are projected one by one by `made_floor`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.bundle.exposure_motion import PRIOR_STD_S
from backend.bundle.locate import locate
from backend.bundle.refinement import Bundle
from backend.bundle.rolling_shutter import corrected_rows, readout_test
from backend.measurements import ControlPoint, FloorTracks, RowExposure
from tests.backend.bundle.made_scenes import SEEDS, SURVEY, WRONG_LENS, errors_squared, position_rms
from tests.backend.bundle.rolling_scenes import READOUT_S, as_global, refined
from tests.backend.made_floor import CAMERA, Made, Scene, make

GLOBAL = replace(SURVEY, position_std_m=(0.03, 0.05))
ROLLING = replace(GLOBAL, readout_s=READOUT_S)
"""At 15 m/s, the speed of the scene, the camera moves by 0.45 m meanwhile: two pixels."""
FREE_LENS = replace(WRONG_LENS, keyframes=16)


def photographs(scene: Scene, seed: int, **exposure: object) -> Made:
    """The scene by a camera of unknown shutter, and of unknown velocity."""
    made = make(scene, seed)
    unknown = RowExposure(int(scene.size_px[1]), None, np.full((scene.keyframes, 3), np.nan))
    return replace(made, measurements=replace(made.measurements, exposure=replace(unknown, **exposure)))


@pytest.fixture(scope="module")
def made() -> Made:
    return photographs(ROLLING, 1)


@pytest.fixture(scope="module")
def found(made: Made) -> Bundle:
    return refined(made)


@pytest.fixture(scope="module")
def bent(made: Made) -> Bundle:
    """The same pictures as if all rows were exposed at once."""
    return as_global(made)


def test_the_read_out_time_is_estimated_and_the_map_is_as_good_as_with_a_global_shutter(made, found, bent):
    assert found.readout.is_estimated
    assert abs(found.readout.readout_s - READOUT_S) < 2 * found.readout.std_s
    assert found.readout.std_s < 0.1 * PRIOR_STD_S
    assert position_rms(made, found.w_T_b) < 0.5 * position_rms(made, bent.w_T_b)
    assert np.median(errors_squared(made, found)) < 2 * 5.35  # the median of chi-square with 6 freedoms


def test_the_motion_from_the_first_row_to_the_last_is_in_body_axes(made, found, bent):
    velocity = np.gradient(made.w_T_b[:, :3, 3], axis=0)
    moved_m = READOUT_S * np.einsum("nba,nb->na", made.w_T_b[:, :3, :3], velocity)
    ends = [0, 7, 8, 15]
    off = np.linalg.norm(found.row_motion_m - moved_m, axis=1)
    assert np.delete(off, ends).max() < 0.2 * np.linalg.norm(moved_m, axis=1).mean()
    assert bent.row_motion_m is None


def test_a_global_shutter_is_fixed_and_leaves_the_map_as_it_is():
    made = photographs(GLOBAL, 1)
    found, before = refined(made), as_global(made)
    assert not found.readout.is_estimated
    assert found.readout.readout_s == 0
    assert 0 < found.readout.std_s < 0.1 * PRIOR_STD_S
    assert found.readout.known_velocities == 12  # not those at the four ends of the two strips
    assert before.readout is None
    np.testing.assert_array_equal(found.w_T_b, before.w_T_b)
    np.testing.assert_array_equal(found.covariances, before.covariances)


def test_the_last_row_may_be_exposed_first():
    found = refined(photographs(replace(ROLLING, readout_s=-READOUT_S), 1))
    assert abs(found.readout.readout_s + READOUT_S) < 2 * found.readout.std_s


def test_copies_of_all_observations_hardly_tell_the_time_better(made, found):
    """Eight copies of independent residuals would tell it to 0.35 of the deviation."""
    tracks, each = made.measurements.tracks, np.arange(8)
    number = (tracks.track + each[:, None] * (tracks.track.max() + 1)).ravel()
    copies = FloorTracks(
        np.tile(tracks.keyframe, 8), number, np.tile(tracks.pixel, (8, 1)), np.tile(tracks.std_px, 8)
    )
    many = refined(replace(made, measurements=replace(made.measurements, tracks=copies)))
    assert many.readout.std_s > 0.45 * found.readout.std_s


@pytest.mark.parametrize("seed", [1, 2])
def test_pictures_of_a_vehicle_that_stops_at_the_ends_of_strips_tell_no_global_shutter(seed: int):
    """Their rows are straight, and nothing tells that it stops."""
    made = photographs(replace(ROLLING, stops=(0, 7, 8, 15)), seed)
    optimum = as_global(made).optimum
    problem = replace(optimum.problem, measurements=made.measurements)
    test = readout_test(replace(optimum, cost=replace(optimum.cost, problem=problem)))
    assert test.motion.is_known.sum() == 12
    assert test.readout_s > 0.93 * READOUT_S


@pytest.mark.parametrize("stated_s", [None, READOUT_S])
def test_pictures_of_a_vehicle_that_stops_at_the_ends_of_strips_show_it(stated_s: float | None):
    made = photographs(replace(ROLLING, stops=(0, 7, 8, 15)), 1, readout_s=stated_s)
    found = refined(made)
    assert found.readout.readout_s == pytest.approx(READOUT_S, rel=0.1)
    assert position_rms(made, found.w_T_b) < 0.07, "0.09 m as if it had flown on"


def test_the_rounds_end_when_the_rows_are_settled():
    """With a free lens they take longer than the noise does."""
    at = refined(photographs(replace(FREE_LENS, readout_s=READOUT_S), 2)).optimum
    before, after = at.problem.tracks, corrected_rows(at.problem, at.at, at.noise, at.used)[0].tracks
    changed = (after.pixel - before.pixel) / before.std_px[:, None]
    assert np.sqrt(np.mean(changed**2)) < 0.1


def test_pictures_of_unknown_velocity_fly_evenly_where_the_flight_leaves_a_direction_open(made, found):
    at = found.optimum
    bare = replace(at.problem.measurements, positions=(), attitudes=(), ranges=())
    problem = replace(at.problem, measurements=bare)
    motion = corrected_rows(problem, at.at, at.noise, np.zeros_like(at.used))[0].exposure_motion
    assert not motion.is_known.all()
    np.testing.assert_allclose(
        motion.own_motion[~motion.is_known], motion.readout_s * motion.f_v[~motion.is_known]
    )


def test_velocities_that_the_vehicle_reports_count_where_the_neighbours_tell_none():
    made = photographs(ROLLING, 1)
    # Each picture is taken after a pause of its own.
    pauses = replace(made.measurements, stamps_s=np.cumsum(10.0 ** np.arange(16)))
    silent = refined(replace(made, measurements=pauses))
    assert silent.readout is None
    reported = replace(pauses.exposure, w_v_m_s=np.gradient(made.w_T_b[:, :3, 3], axis=0))
    found = refined(replace(made, measurements=replace(pauses, exposure=reported)))
    assert found.readout.known_velocities == 16
    assert abs(found.readout.readout_s - READOUT_S) < 2 * found.readout.std_s


def test_a_stated_time_is_fixed(bent):
    made = photographs(ROLLING, 1, readout_s=READOUT_S)
    found = refined(made)
    assert (found.readout.readout_s, found.readout.std_s, found.readout.is_estimated) == (READOUT_S, 0, False)
    assert position_rms(made, found.w_T_b) < 0.5 * position_rms(made, bent.w_T_b)


def test_it_is_fixed_where_the_focal_length_along_the_flight_explains_it():
    """One strip of a camera with pixels of any aspect: both stretch all pictures alike."""
    camera = replace(CAMERA, aspect_std_ratio=0.05)
    scene = replace(ROLLING, keyframes=8, tilt_std_rad=0.0, height_swing=0.0, camera=camera)
    made = photographs(scene, 1)
    one_strip = replace(made, measurements=made.measurements.of_keyframes(range(4)), start=made.start[:4])
    found = refined(one_strip)
    assert not found.readout.is_estimated
    assert found.readout.std_s > 0.2 * PRIOR_STD_S


def marked(made: Made) -> list[ControlPoint]:
    """Surveyed points of the floor, with their pixels in the pictures as recorded."""
    tracks, points = made.measurements.tracks, list[ControlPoint]()
    for number in np.flatnonzero(np.bincount(tracks.track) >= 6)[:12]:
        rows = tracks.track == number
        place = made.point[number] + [0.0, 0.0, made.floor_z_m]
        mark = tracks.keyframe[rows], tracks.pixel[rows], 0.3
        points.append(ControlPoint(f"P{number}", place, np.full(3, 0.02), *mark))
    return points


def test_points_are_located_by_the_rows_of_their_marks(made, found, bent):
    points = marked(made)
    truth = np.array([point.w_p_m for point in points])
    off, off_bent = (
        np.linalg.norm([at.w_p_m for at in locate(map_.optimum, points)] - truth, axis=1)
        for map_ in (found, bent)
    )
    assert off.mean() < 0.7 * off_bent.mean()
    residual_px = np.concatenate([at.residual_px for at in locate(found.optimum, points)])
    assert np.sqrt(np.mean(residual_px**2)) < 1.2 * ROLLING.pixel_std


def test_marks_of_control_points_belong_to_their_rows(made):
    followed = replace(made, measurements=replace(made.measurements, control=tuple(marked(made))))
    found = refined(followed)
    assert abs(found.readout.readout_s - READOUT_S) < 2 * found.readout.std_s
    assert found.noise.marks < 1.3


@pytest.mark.slow
def test_the_told_deviation_of_the_time_is_that_of_its_errors():
    for scene in (ROLLING, replace(FREE_LENS, readout_s=READOUT_S)):
        found = [refined(photographs(scene, seed)).readout for seed in SEEDS]
        assert all(each.is_estimated for each in found)
        off = np.array([(each.readout_s - READOUT_S) / each.std_s for each in found])
        assert 0.4 < np.mean(off**2) < 2.0


@pytest.mark.slow
def test_no_global_shutter_is_taken_for_a_rolling_one():
    scenes = GLOBAL, FREE_LENS, replace(GLOBAL, relief=0.03), replace(FREE_LENS, relief=0.03)
    for scene in scenes:
        assert not any(refined(photographs(scene, seed)).readout.is_estimated for seed in SEEDS)
