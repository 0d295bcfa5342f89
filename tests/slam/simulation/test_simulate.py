from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam import simulate
from slam.core.errors import InputError
from slam.simulation.place.terrain import elevation
from slam.simulation.recipe import load_recipe, recipe_from

SHORT = recipe_from(
    {
        "name": "short",
        "landmarks": {"A": [0.3, 0.3], "B": [1.0, 0.8]},
        "maneuver": {"way_points": ["A", "B", [0.3, 0.8, 1.0], "A"]},
        "world": {"extent_m": [0, 0, 1.3, 1.3], "margin_m": 0.5, "metres_per_px": 0.004},
    },
    "test",
)


def test_the_figure_eight_has_the_shape_of_the_published_one():
    flight = simulate("figure_eight", 0)
    assert 780 <= len(flight.frames) <= 805
    assert flight.frames[0].read().shape == (240, 320, 3)
    assert 50 < flight.truth.stamps_s[-1] < 56
    steps = np.diff(flight.truth.w_T_b[:, :3, 3], axis=0)
    assert np.linalg.norm(np.diff(flight.truth.w_T_b[::50, :3, 3], axis=0), axis=1).sum() == pytest.approx(
        26.4, rel=0.03
    )
    assert np.linalg.norm(steps, axis=1).max() < 0.01
    assert list(flight.landmarks) == list("ABCDEFGH")
    assert flight.gaps == (("A", "E"),)
    assert len(flight.landmark_pairs) == 9
    assert np.all(flight.truth.w_T_b[:, 2, 3] > 0.7)


def test_flights_of_one_recipe_are_named_apart():
    assert [simulate(SHORT, seed).name for seed in (0, 7)] == ["short-seed-0", "short-seed-7"]


def test_every_landmark_of_the_figure_eight_is_seen():
    flight = simulate("figure_eight", 1)
    poses = flight.frames.load.w_T_b[:, 0]
    for mark in flight.landmarks.values():
        c_T_w = np.linalg.inv(poses @ flight.camera.b_T_c)
        pixel = flight.camera.project(c_T_w[:, :3, :3] @ mark + c_T_w[:, :3, 3])
        inside = ((pixel >= 0) & (pixel <= np.array(flight.camera.size_px) - 1)).all(1)
        assert inside.sum() >= 10


def test_the_same_seed_gives_the_same_bytes_and_another_another_flight():
    one, again, other = simulate(SHORT, 4), simulate(SHORT, 4), simulate(SHORT, 5)
    for a, b in ((one.imu.accel_m_s2, again.imu.accel_m_s2), (one.sonar.range_m, again.sonar.range_m)):
        assert a.tobytes() == b.tobytes()
    assert one.truth.w_T_b.tobytes() == again.truth.w_T_b.tobytes()
    assert one.attitude.roll_pitch_yaw_rad.tobytes() == again.attitude.roll_pitch_yaw_rad.tobytes()
    assert one.frames[11].read().tobytes() == again.frames[11].read().tobytes()
    assert one.frames.names == again.frames.names
    assert not np.array_equal(one.truth.w_T_b[:50], other.truth.w_T_b[:50])


def test_changing_one_instrument_leaves_the_others_as_they_were():
    model = SHORT.model
    changed = simulate(replace(SHORT, model=replace(model, sonar=replace(model.sonar, rate_hz=10.0))), 4)
    one = simulate(SHORT, 4)
    assert len(changed.sonar.range_m) < len(one.sonar.range_m)
    assert np.array_equal(changed.imu.gyro_rad_s, one.imu.gyro_rad_s)
    assert np.array_equal(changed.truth.w_T_b, one.truth.w_T_b)
    assert np.array_equal(changed.frames[3].read(), one.frames[3].read())


def test_truth_covers_every_stamp_and_interpolates_to_the_camera():
    flight = simulate(SHORT, 2)
    truth = flight.truth.stamps_s
    for stream in (flight.frames, flight.imu, flight.attitude, flight.sonar):
        assert truth[0] <= stream.stamps_s[0]
        assert stream.stamps_s[-1] <= truth[-1] + 1e-9
    exact = flight.frames.load.w_T_b[:, 0]
    for axis in range(3):
        between = np.interp(flight.frames.stamps_s, truth, flight.truth.w_T_b[:, axis, 3])
        assert np.abs(between - exact[:, axis, 3]).max() < 2e-5
    nearest = np.abs(truth[:, None] - flight.frames.stamps_s).argmin(0)
    turn = Rotation.from_matrix(flight.truth.w_T_b[nearest, :3, :3]).inv() * Rotation.from_matrix(
        exact[:, :3, :3]
    )
    assert turn.magnitude().max() < 0.003


def test_picture_names_are_their_stamps():
    flight = simulate(SHORT, 0)
    stamps_ns = [int(name.removesuffix(".png")) - flight.epoch_ns for name in flight.frames.names]
    assert np.array_equal(stamps_ns, np.round(flight.frames.stamps_s * 1e9).astype(int))


def test_ten_laps_make_a_flight_ten_times_as_long():
    recipe = load_recipe("figure_eight")
    once = simulate(recipe, 0)
    long = simulate(replace(recipe, maneuver=replace(recipe.maneuver, laps=10)), 0)
    assert len(long.frames) == pytest.approx(10 * len(once.frames), rel=0.03)
    assert np.all(np.isfinite(long.truth.w_T_b))
    wander = long.truth.w_T_b[-1, :3, 3] - [0.0, 2.1, 0.8]
    assert np.linalg.norm(wander) < 0.15


def test_a_recipe_made_in_python_is_checked():
    with pytest.raises(InputError, match=r"recipe 'short'.*no landmark 'Q'"):
        simulate(replace(SHORT, gaps=(("A", "Q"),)))
    with pytest.raises(InputError, match="seed -1"):
        simulate(SHORT, -1)


def test_the_sonar_measures_the_boxes_of_the_gym():
    flight = simulate("gym", seed=0)
    world = flight.frames.load.world
    height = np.interp(flight.sonar.stamps_s, flight.truth.stamps_s, flight.truth.w_T_b[:, 2, 3])
    x, y = (
        np.interp(flight.sonar.stamps_s, flight.truth.stamps_s, flight.truth.w_T_b[:, i, 3]) for i in (0, 1)
    )
    below = elevation(world, x, y)
    # Level but for a few degrees: away from the edges the reading is the height above what lies below.
    around = [elevation(world, x + dx, y + dy) for dx in (-0.08, 0.08) for dy in (-0.08, 0.08)]
    inside = np.ptp([below, *around], axis=0) == 0
    off = flight.sonar.range_m - (height - below)
    assert {round(float(h), 2) for h in np.unique(below[inside])} >= {0.0, 0.18, 0.25, 0.35}
    assert np.abs(np.median(off[inside & (below > 0.1)])) < 0.004
    assert np.abs(off[inside]).max() < 0.06


def test_a_flight_into_an_obstacle_is_refused_in_one_line():
    recipe = load_recipe("gym")
    with pytest.raises(InputError, match="hits an obstacle after") as caught:
        simulate(replace(recipe, maneuver=replace(recipe.maneuver, height_m=0.3)))
    assert "\n" not in str(caught.value)


def test_the_white_balance_filter_tones_each_picture_anew():
    plain, toned = simulate("square", seed=0), simulate("square_white_balance", seed=0)
    means = [[f.frames.load(k).mean((0, 1)) for k in range(40, 60)] for f in (plain, toned)]
    steps = np.abs(np.diff(means, axis=1)).mean((1, 2))
    assert steps[1] > 5 * steps[0]
    assert toned.camera.focal_px == plain.camera.focal_px
    assert np.array_equal(toned.truth.w_T_b, plain.truth.w_T_b)


def test_a_pilot_who_is_blown_away_is_reported():
    windy = replace(SHORT, camera=None, model=SHORT.model.with_term("steady_wind", x=19.0))
    with pytest.raises(
        InputError, match=r"recipe short: maneuver: the vehicle leaves the floor after"
    ) as caught:
        simulate(windy, 0)
    assert "\n" not in str(caught.value)


def test_a_flight_is_replayed_by_its_own_commands():
    """Every simulated flight has the streams that criticism needs, whoever flew it."""
    flight = simulate(SHORT, 1)
    assert np.abs(flight.command.stick).max() > 0.02
    assert np.diff(flight.command.stamps_s).max() <= 0.05 + 1e-9
    assert flight.velocity.v_m_s.shape[1] == 2
    assert 10 < flight.battery.value.min() < flight.battery.value.max() < 12.7
    assert flight.command.max_tilt_rad == SHORT.model.vehicle.max_tilt_rad
