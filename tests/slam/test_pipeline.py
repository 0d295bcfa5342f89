"""The whole job on short simulated flights: its accuracy, and what becomes of flights that lack something."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from slam.errors import InputError
from slam.estimate import Estimate
from slam.evaluation import evaluate
from slam.flight import Flight
from slam.io.geodesy import geodetic_from_enu
from slam.pipeline import optimize
from slam.simulation import simulate
from tests.slam.small_flight import (
    ORIGIN,
    elsewhere,
    flown,
    gps_of,
    only,
    photographs,
    recipe,
    seeing,
)

BLACK = np.zeros((144, 176, 3), np.uint8)


@lru_cache
def normal(seed: int = 0) -> tuple[Flight, Estimate]:
    flight = flown(seed)
    return flight, optimize(flight)


def assert_whole(estimate: Estimate) -> None:
    """All placed in one part, each with a covariance."""
    assert (estimate.component == 0).all()
    assert np.isfinite(estimate.w_T_b).all()
    assert (np.linalg.eigvalsh(estimate.covariances)[:, 0] > 0).all()


def refusal(flight: Flight) -> str:
    with pytest.raises(InputError) as refused:
        optimize(flight)
    message = str(refused.value)
    assert "\n" not in message
    assert flight.name in message
    return message


@pytest.mark.parametrize("seed", [0, 1])
def test_a_normal_flight(seed):
    """As good as the pictures allow, not better; the covariances say how good."""
    flight, estimate = normal(seed)
    found = evaluate(estimate, flight)
    assert_whole(estimate)
    assert estimate.status == "ok"
    assert estimate.frames == len(flight.frames)
    assert 20 < len(estimate.stamps_s) < 45
    assert 2e-4 < found.ate_sim3_m.rmse < 1.5e-3
    assert 3e-4 < found.ate_m.rmse < 3e-3
    # Wide for one flight: what all its poses share (height, scale) is one draw. The next test is sharp.
    assert 0.5 * found.nees.pose.lower95 < found.nees.pose.mean < 2 * found.nees.pose.upper95
    assert (found.loops.precision, found.loops.recall) == (1.0, 1.0)
    assert abs(found.landmarks[0].error_m.loops) < 4e-3
    # The paper's way is worse: else there were nothing to optimize.
    chain_off = np.linalg.norm(found.tracks.chain_m - found.tracks.reference_m, axis=1)
    assert np.sqrt(np.mean(chain_off**2)) > 1.5 * found.ate_m.rmse


@pytest.mark.slow
def test_covariances_are_honest_over_many_flights():
    """The mean NEES of twelve flights: a draw each of what a flight's poses share."""
    means = [evaluate(estimate, flight).nees.pose.mean for flight, estimate in map(normal, range(12))]
    assert 6 * 0.65 < np.mean(means) < 6 * 1.5


def test_relative_poses_are_those_of_the_keyframes():
    """Edges lead from one optimized pose to the other, to within their own uncertainty."""
    _, estimate = normal()
    whitened = []
    for edge in estimate.relative_poses:
        expected = np.linalg.inv(estimate.w_T_b[edge.i]) @ estimate.w_T_b[edge.j]
        off = expected[:3, 3] - edge.i_T_j[:3, 3]
        whitened.append(off @ np.linalg.solve(edge.covariance[3:, 3:], off) / 3)
    assert 0.05 < np.median(whitened) < 3
    assert {edge.kind for edge in estimate.relative_poses} == {"odometry", "loop"}


def test_keyframes_carry_the_stamps_and_names_of_their_frames():
    flight, estimate = normal()
    assert (np.diff(estimate.frame_index) > 0).all()
    assert np.array_equal(estimate.stamps_s, flight.frames.stamps_s[estimate.frame_index])
    assert estimate.frame_names == tuple(flight.frames.names[k] for k in estimate.frame_index)


def test_two_runs_give_the_same_bits():
    flight, one = normal()
    again = optimize(flown(0))
    for field in ("w_T_b", "covariances", "chain_w_T_b", "odometry_w_T_b", "frame_index", "component"):
        assert getattr(one, field).tobytes() == getattr(again, field).tobytes(), field
    assert (one.loops, one.rejected, one.warnings) == (again.loops, again.rejected, again.warnings)
    assert one.graph_error == again.graph_error
    assert flight.name == again.name


def test_progress_is_told_and_what_it_raises_passes_through():
    stages: dict[str, int] = {}

    def note(stage: str, done: int, total: int) -> None:
        stages[stage] = max(stages.get(stage, 0), done)
        assert total == 0 or done <= total

    flight = only(flown(0), range(24))
    optimize(flight, progress=note)
    assert {"track", "graph", "loops", "refine"} <= set(stages)
    assert stages["track"] == 24

    def interrupted(stage: str, done: int, total: int) -> None:
        if stage == "refine":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        optimize(flight, progress=interrupted)


def test_without_sonar_the_shape_is_right_and_the_missing_scale_is_told():
    flight = replace(flown(0), sonar=None, imu=None)
    estimate = optimize(flight)
    assert_whole(estimate)
    assert "no metric scale" in estimate.status
    assert estimate.status in estimate.warnings
    assert np.median(estimate.w_T_b[:, 2, 3]) == pytest.approx(1.0, abs=0.05)
    found = evaluate(estimate, flight)
    assert found.ate_sim3_m.rmse < 1.5e-3
    assert found.scale == pytest.approx(0.8, rel=0.03)


def test_without_sonar_the_accelerometer_tells_how_long_a_metre_is():
    flight = replace(flown(0), sonar=None)
    estimate = optimize(flight)
    assert_whole(estimate)
    assert "lengths are the accelerometer's" in estimate.status
    assert estimate.instruments.accelerometer.used
    scale = evaluate(estimate, flight).to_json()["ate_sim3_m"]["scale"]
    assert abs(scale - 1) < 3 * estimate.scale_std
    assert estimate.scale_std < 0.06


def test_an_accelerometer_that_contradicts_the_ranges_is_not_believed():
    flight = flown(0)
    sonar = replace(flight.sonar, scale_std=0.0)
    estimate = optimize(replace(flight, sonar=replace(sonar, range_m=sonar.range_m / 2)))
    assert any("one instrument is off" in line for line in estimate.warnings)
    assert not estimate.instruments.accelerometer.used
    assert estimate.instruments.accelerometer.scale == pytest.approx(2, rel=0.15)


def test_without_attitude_the_pictures_alone_tell_the_tilt():
    flight = replace(flown(0), attitude=None)
    estimate = optimize(flight)
    assert estimate.status == "ok"
    found = evaluate(estimate, flight)
    assert 3e-4 < found.ate_m.rmse < 3e-3
    # Wide for one flight: what all its poses share (height, scale) is one draw. The next test is sharp.
    assert 0.5 * found.nees.pose.lower95 < found.nees.pose.mean < 2 * found.nees.pose.upper95


def test_missing_values_in_sonar_and_attitude_are_no_harm():
    flight = flown(0)
    angles, range_m = flight.attitude.roll_pitch_yaw_rad.copy(), flight.sonar.range_m.copy()
    angles[200:260] = np.nan
    angles[300:, 2] = np.nan
    range_m[::3] = np.nan
    range_m[100:140] = np.nan
    broken = replace(
        flight,
        attitude=replace(flight.attitude, roll_pitch_yaw_rad=angles),
        sonar=replace(flight.sonar, range_m=range_m),
    )
    estimate = optimize(broken)
    assert estimate.status == "ok"
    assert evaluate(estimate, broken).ate_m.rmse < 3e-3


def test_a_sonar_that_reads_one_figure_only_is_told():
    flight = flown(0)
    stuck = replace(flight.sonar, range_m=np.full(len(flight.sonar.stamps_s), 0.8))
    estimate = optimize(replace(flight, sonar=stuck))
    assert any("reads exactly 0.8 m" in warning for warning in estimate.warnings)


def test_streams_without_one_value_are_like_none():
    flight = flown(0)
    empty = replace(
        flight,
        attitude=replace(
            flight.attitude, roll_pitch_yaw_rad=np.full((len(flight.attitude.stamps_s), 3), np.nan)
        ),
        sonar=replace(flight.sonar, range_m=np.full(len(flight.sonar.stamps_s), np.nan)),
        gps=replace(
            gps_of(flight, 0.1),
            **dict.fromkeys(("latitude_deg", "longitude_deg", "altitude_m"), np.full(63, np.nan)),
        ),
    )
    none = replace(flight, attitude=None, sonar=None)
    one, other = (optimize(replace(f, imu=None)) for f in (empty, none))
    assert one.w_T_b.tobytes() == other.w_T_b.tobytes()
    assert one.status == other.status
    assert "no metric scale" in one.status


def test_gps_gives_place_heading_and_scale():
    """Absolute errors of the size that the fixes' own noise leaves, inside the covariance."""
    flight = replace(flown(0), sonar=None, attitude=None)
    flight = replace(flight, gps=gps_of(flight, 0.05))
    estimate = optimize(flight)
    assert_whole(estimate)
    assert estimate.status == "ok"
    assert estimate.origin is not None
    origin = flight.geo_origin()
    east_north_up = np.array(geodetic_from_enu(np.zeros((1, 3)), origin)).ravel() - [
        ORIGIN.latitude_deg,
        ORIGIN.longitude_deg,
        ORIGIN.altitude_m,
    ]
    assert np.abs(east_north_up[:2]).max() < 1e-4
    truth = np.column_stack(
        [np.interp(estimate.stamps_s, flight.truth.stamps_s, flight.truth.w_T_b[:, a, 3]) for a in range(3)]
    )
    first_fix = flight.truth.w_T_b[0, :3, 3]
    off = estimate.w_T_b[:, :3, 3] - (truth - first_fix)
    # The origin is the first fix, noise and all: what is left beside it is the map's own error.
    within = np.linalg.norm(off - off.mean(axis=0), axis=1)
    assert 1e-3 < np.sqrt(np.mean(within**2)) < 0.06
    assert np.linalg.norm(off.mean(axis=0)) < 4 * 0.05


def test_a_gps_that_stands_still_is_left_alone():
    """A receiver that repeats one fix: told, and the map is what it is without."""
    flight, without = normal()
    stuck = gps_of(flight, 0.0)
    n = len(stuck.stamps_s)
    stuck = replace(
        stuck, latitude_deg=np.full(n, 47.0), longitude_deg=np.full(n, 8.0), altitude_m=np.full(n, 400.0)
    )
    estimate = optimize(replace(flight, gps=stuck))
    assert "no usable position" in estimate.status
    assert estimate.origin is None
    assert estimate.w_T_b.tobytes() == without.w_T_b.tobytes()
    no_scale = optimize(replace(flight, gps=stuck, sonar=None))
    assert np.isfinite(no_scale.covariances).all()
    assert evaluate(no_scale, flight).ate_sim3_m.rmse < 1.5e-3


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ("plain floor", "98 x too few features"),
        ("grey", "98 x too few features"),
        ("damaged", "98 x unreadable"),
    ],
)
def test_pictures_without_anything_to_see_are_refused_with_the_reason(what, reason):
    if what == "plain floor":
        flight = flown(0, world={"texture": "plain", "mark_diameter_m": 0.0})
    else:
        flight = seeing(flown(0), lambda k: np.full((144, 176), 120, np.uint8) if what == "grey" else None)
    message = refusal(flight)
    assert "0 of 98 pictures usable" in message
    assert reason in message


def test_no_camera_names_the_command_that_needs_none():
    flight = flown(0)
    assert "slam estimate" in refusal(replace(flight, frames=None))
    assert "slam estimate" in refusal(replace(flight, camera=None))
    assert "slam estimate" in refusal(only(flight, []))


def test_a_hover_is_a_small_map():
    """Four seconds over one place: the first and the last picture stand for all."""
    flight = flown(0, maneuver={"way_points": ["A"], "rest_s": 3.0})
    estimate = optimize(flight)
    assert_whole(estimate)
    assert estimate.status == "ok"
    assert len(estimate.stamps_s) == 2
    assert estimate.frames == len(flight.frames)
    assert evaluate(estimate, flight).ate_m.rmse < 3e-3


def test_one_picture_is_too_few():
    assert "1 of 1 pictures usable" in refusal(only(flown(0), [5]))
    assert "1 of 3 pictures usable (2 x unreadable)" in refusal(
        seeing(only(flown(0), [5, 6, 7]), lambda k: None if k else flown(0).frames.load(5))
    )


def test_two_areas_that_no_picture_joins_are_two_parts():
    far = recipe(
        world={"extent_m": [0, 0, 5, 1.0]},
        maneuver={"way_points": [[0.3, 0.3], [1.1, 0.3], [4.0, 0.3], [4.6, 0.3]]},
    )
    flight = simulate(far, 0)
    x = np.interp(flight.frames.stamps_s, flight.truth.stamps_s, flight.truth.w_T_b[:, 0, 3])
    flight = only(flight, np.flatnonzero((x < 1.2) | (x > 3.9)))
    # Nor do instruments: what they bridge is one part (test_bridging).
    estimate = optimize(replace(flight, imu=None, velocity=None))
    sizes = np.bincount(estimate.component)
    assert len(sizes) == 2
    assert sizes[0] >= sizes[1] >= 4
    assert f"2 parts that no picture joins ({sizes[0]}, {sizes[1]} keyframes)" in estimate.status
    assert np.isfinite(estimate.covariances).all()
    assert estimate.rejected["tracking started anew"] == 1
    # Each part is right in its own frame.
    x = np.interp(estimate.stamps_s, flight.truth.stamps_s, flight.truth.w_T_b[:, 0, 3])
    for part in (0, 1):
        own = estimate.component == part
        length = np.linalg.norm(np.ptp(estimate.w_T_b[own, :2, 3], axis=0))
        assert length == pytest.approx(np.ptp(x[own]), abs=0.01)


def test_damaged_pictures_are_counted_and_left_out():
    flight = flown(0)
    broken = seeing(flight, lambda k: None if k % 10 == 3 else flight.frames.load(k))
    estimate = optimize(broken)
    assert estimate.rejected["unreadable"] == 10
    assert not {k for k in estimate.frame_index.tolist() if k % 10 == 3}
    assert estimate.status == "ok"
    assert evaluate(estimate, broken).ate_m.rmse < 3e-3


def test_black_seconds_are_bridged_by_loops():
    """Tracking starts anew behind them; places seen before join the two halves again."""
    flight = flown(0)
    dark = seeing(flight, lambda k: BLACK if 38 <= k < 62 else flight.frames.load(k))
    estimate = optimize(dark)
    assert estimate.rejected["too few features"] == 24
    assert estimate.rejected["tracking started anew"] == 1
    assert_whole(estimate)
    assert estimate.status == "ok"
    assert evaluate(estimate, dark).ate_m.rmse < 4e-3
    assert np.isnan(estimate.chain_w_T_b[-1]).all()
    assert np.isfinite(estimate.chain_w_T_b[0]).all()


def test_photographs_without_gps_are_placed_in_any_order():
    flight = flown(0)
    order = np.random.default_rng(1).permutation(np.arange(0, 98, 3))
    estimate = optimize(photographs([(flight, int(k)) for k in order]))
    assert len(estimate.stamps_s) == 33
    assert_whole(estimate)
    assert "no metric scale" in estimate.status
    there = np.array(
        [
            [
                np.interp(flight.frames.stamps_s[k], flight.truth.stamps_s, flight.truth.w_T_b[:, a, 3])
                for a in (0, 1)
            ]
            for k in order
        ]
    )
    # The same picture up to a similarity of the plane: complex numbers, Horn's fit.
    a, b = estimate.w_T_b[:, :2, 3] @ [1, 1j], there @ [1, 1j]
    a, b = a - a.mean(), b - b.mean()
    left = b - a * np.vdot(a, b) / np.vdot(a, a)
    assert np.sqrt(np.mean(np.abs(left) ** 2)) < 2e-3


@pytest.mark.parametrize("mixed", ["one after the other", "in turns"])
def test_photographs_of_two_places_are_two_parts(mixed):
    """In turns no picture overlaps the one before: only looking at all pairs finds who belongs together."""
    here, there = flown(0), elsewhere()
    photos = [(here, 3 * k) for k in range(12)] + [(there, 3 * k) for k in range(9)]
    if mixed == "in turns":
        photos = [pair for k in range(9) for pair in ((here, 3 * k), (there, 3 * k))] + photos[9:12]
    estimate = optimize(photographs(photos))
    belongs = np.array([0 if flight is here else 1 for flight, _ in photos])
    assert np.array_equal(estimate.component, belongs)
    assert "2 parts that no picture joins (12, 9 keyframes)" in estimate.status


def test_a_photograph_that_belongs_to_nothing_is_left_out():
    here, there = flown(0), elsewhere()
    flight = photographs([(here, 3 * k) for k in range(8)] + [(there, 0)])
    estimate = optimize(flight)
    assert estimate.component.tolist() == [0] * 8 + [-1]
    assert np.isnan(estimate.w_T_b[8]).all()
    assert np.isnan(estimate.covariances[8]).all()
    assert "1 keyframe overlaps no other: not placed" in estimate.status
    with_sonar = optimize(replace(flight, sonar=replace(here.sonar, stamps_s=here.sonar.stamps_s * 1.1)))
    assert "no metric scale" not in with_sonar.status


def test_photographs_that_do_not_overlap_are_refused():
    message = refusal(photographs([(flown(0), 0), (elsewhere(), 0)]))
    assert re.search(r"no two of 2 pictures could be joined \(1 x [a-z ]+\)", message)


@pytest.mark.parametrize(
    ("spoil", "reason", "count"),
    [
        (lambda load, k: load(30) if 30 <= k < 42 else load(k), "same picture as the one before", 11),
        (lambda load, k: load(k - k % 2), "same picture as the one before", 49),
        (lambda load, k: load(k)[:120] if 30 <= k < 42 else load(k), "of another size than the camera's", 12),
        (
            lambda load, k: load(k).astype(np.uint16) if 30 <= k < 42 else load(k),
            "neither 8-bit grey nor colour",
            12,
        ),
        (lambda load, k: 0 * load(k) + 255 if 30 <= k < 42 else load(k), "too few features", 12),
        (lambda load, k: load(k)[..., ::-1].copy() if k % 2 else load(k), "", 0),
    ],
    ids=["frozen", "each twice", "another size", "16 bit", "white", "colours swapped"],
)
def test_bad_pictures_are_counted_by_name_and_survived(spoil, reason, count):
    flight = flown(0)
    spoiled = seeing(flight, lambda k: spoil(flight.frames.load, k))
    estimate = optimize(spoiled)
    assert estimate.rejected.get(reason, 0) == count
    assert_whole(estimate)
    assert estimate.status == "ok"
    assert evaluate(estimate, spoiled).ate_m.rmse < 3e-3
