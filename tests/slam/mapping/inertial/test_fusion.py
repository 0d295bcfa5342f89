"""Parts of a map that the readings of an IMU connect in the refinement."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from backend import se3
from backend.measurements import AlignedPair, Position
from slam.core.flight import Flight
from slam.core.streams import Scalar
from slam.evaluation import evaluate
from slam.mapping.config import PipelineConfig
from slam.mapping.inertial.bridges import joined
from slam.mapping.inertial.fusion import _apart, _doubted, _from_first, fuse_parts
from slam.mapping.inertial.measurements import tracked_frames
from slam.mapping.keyframe_readings import KeyframeReadings
from slam.mapping.pipeline import optimize
from slam.mapping.setup import Setup
from tests.benchmarks.instrument_flights import KINDS, flown
from tests.slam.mapping.inertial.test_bridges import made_parts, one_way
from tests.slam.mapping.made_map import CAMERA
from tests.slam.mapping.test_tracking_gaps import observations


def test_pictures_are_a_spacing_apart_and_the_last_one_before_a_gap_is_taken():
    found = tracked_frames(observations(2.0, passed_s=1.6), np.arange(3), CAMERA)
    # Keyframes are at 0, 1 and 3 s; pictures at each tenth of the first second, and at 1.4 s.
    stamps_s = np.array([frame.stamp_s for frame in found])
    assert np.diff([0.0, *stamps_s[:-1], 1.0]).max() <= 0.2 + 1e-9
    assert len(stamps_s) < 8
    assert stamps_s[-1] == 1.4
    assert [frame.k for frame in found] == [0] * (len(found) - 1) + [1]


def test_pictures_of_other_parts_are_left_out():
    found = tracked_frames(observations(2.0, passed_s=1.6), np.array([1, 2]), CAMERA)
    assert [(frame.k, frame.stamp_s) for frame in found] == [(0, 1.4)]


def test_parts_are_compared_from_their_first_keyframe():
    """A part that only moved over the floor, turned about the vertical or rose has not been bent."""
    rng = np.random.default_rng(0)
    before = se3.exp(rng.normal(0, 0.3, (4, 6)))
    moved = se3.from_planar(np.array([[2.0, -1.0, 0.5]]))
    moved[0, 2, 3] = 0.1
    np.testing.assert_allclose(_from_first(before, moved @ before), moved, atol=1e-12)


def test_behind_a_bridge_of_readings_that_are_wrong_nothing_is_certain():
    """The filter's covariance rests on the same readings, so neither the map nor the status may state it."""
    _, parts, edge = made_parts(np.random.default_rng(0))
    bridged = joined(parts, [edge])
    found = _doubted(parts, bridged, np.arange(8), "imu0 does not fit the pictures")
    np.testing.assert_array_equal(found.w_T_b, bridged.w_T_b)
    for covariances in (found.covariances, found.over_floor_covariances):
        np.testing.assert_array_equal(np.isnan(covariances).any(axis=(1, 2)), parts.component == 1)
    line = found.bridges[0].warning
    assert "the instruments bridge the gap with an unknown error, because imu0 does not fit" in str(line)
    assert "±" not in str(line)


def test_a_barometer_that_the_parts_could_not_use_does_not_act_on_the_whole(monkeypatch):
    _, parts, edge = made_parts(np.random.default_rng(0))
    at_s = np.arange(8.0)
    readings = KeyframeReadings.at(Flight("read", barometer=Scalar(at_s, at_s)), at_s, None, PipelineConfig())
    assert len(readings.heights) == 8
    given = []

    def fused(parts, joined, members, setup, motion):
        given.append(setup.readings.heights)
        return joined

    monkeypatch.setattr("slam.mapping.inertial.fusion._fused", fused)
    setup = Setup(CAMERA, readings, PipelineConfig())
    fuse_parts(parts, joined(parts, [edge]), setup, object(), None)
    assert given == [()]


@pytest.mark.parametrize("left_out", [False, True])
def test_a_velocity_that_a_part_could_not_use_does_not_act_on_the_whole(monkeypatch, left_out):
    _, parts, edge = made_parts(np.random.default_rng(0))
    parts = replace(parts, velocity_left_out=left_out)
    readings = KeyframeReadings.at(Flight("read"), np.arange(8.0), None, PipelineConfig())
    given = []

    def fused(parts, joined, members, setup, motion):
        given.append(motion.name)
        return joined

    monkeypatch.setattr("slam.mapping.inertial.fusion._fused", fused)
    setup = Setup(CAMERA, readings, PipelineConfig())
    fuse_parts(parts, joined(parts, [edge]), setup, object(), object())
    assert given == ["imu0" if left_out else "imu0 and velocity0"]


def test_a_part_over_lines_keeps_the_positions_that_place_it(monkeypatch):
    w_T_b, parts, _ = made_parts(np.random.default_rng(0))
    one = replace(parts, w_T_b=w_T_b, component=np.zeros(8, np.int64), georeferenced=True)
    readings = KeyframeReadings.at(Flight("read"), np.arange(8.0), None, PipelineConfig())
    taken = tuple(Position(k, w_T_b[k, :3, 3], np.full(3, 0.05)) for k in range(8))
    setup = Setup(CAMERA, replace(readings, positions=taken), PipelineConfig())
    agreeing = replace(setup, readings=replace(readings, positions=taken[1:]))
    pair = AlignedPair(0, 1, np.zeros((4, 2)), np.zeros((4, 2)), np.eye(8))
    monkeypatch.setattr("slam.mapping.inertial.fusion.aligned_pairs", lambda *_: (pair,))
    given = []

    def fused(parts, joined, members, setup, motion):
        given.append(setup.readings.positions)
        return joined

    monkeypatch.setattr("slam.mapping.inertial.fusion._fused", fused)
    one = replace(one, setups=(agreeing,))
    fuse_parts(one, one, setup, object(), None)
    assert given == [taken[1:]]


def test_parts_that_a_wrong_velocity_joined_are_taken_apart():
    _, parts, edge = made_parts(np.random.default_rng(0))
    bridged = joined(parts, [edge])
    found = _apart(parts, bridged, np.arange(8), "velocity0 does not fit the pictures")
    np.testing.assert_array_equal(found.w_T_b, parts.w_T_b)
    np.testing.assert_array_equal(found.covariances, parts.covariances)
    assert len(set(found.component[:5])) == len(set(found.component[5:])) == 1
    assert found.component[0] != found.component[7]
    assert found.bridges == ()
    (line,) = found.warnings
    said = "a gap in the pictures is not bridged: velocity0 does not fit the pictures"
    assert line.text == f"{said}; measure on one side of it only"


@lru_cache
def without_imu(seed: int, gain: float = 1.0, offset_m_s: float = 0.0, jump_m_s: float = 0.0) -> Flight:
    """The flight whose vehicle reports velocity and attitude alone, with errors of its velocity."""
    flight = one_way(seed)
    velocity = flight.velocity
    assert velocity is not None
    late = velocity.stamps_s > np.mean(velocity.stamps_s)
    v_m_s = gain * velocity.v_m_s + offset_m_s + jump_m_s * late[:, None]
    return replace(flight, imu=None, velocity=replace(velocity, v_m_s=v_m_s, scale_std=0.1))


@pytest.mark.slow
def test_without_an_imu_the_velocity_bridges_a_gap_inside_the_refinement():
    scores = []
    for seed in range(4):
        flight = without_imu(seed)
        estimate = optimize(flight)
        assert (estimate.component == 0).all()
        assert estimate.instruments.velocity is not None
        assert estimate.information_shares["x"]["velocity"] > 0.0
        nees = evaluate(estimate, flight).nees
        assert nees is not None
        scores.append(nees.pose.mean)
    assert 3 < np.mean(scores) < 9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("errors", "told"),
    [({"gain": 1.2}, "times the speed"), ({"offset_m_s": 0.3}, "m/s too much")],
)
def test_errors_of_the_velocity_are_told_and_do_not_move_the_map(errors, told):
    right, wrong = (without_imu(0, **changes) for changes in ({}, errors))
    found = [optimize(flight) for flight in (right, wrong)]
    assert any("velocity0 reads" in line and told in line for line in found[1].warnings)
    before, after = (evaluate(estimate, right) for estimate in found)
    assert after.nees is not None
    assert after.nees.pose.mean < 12
    assert after.ate_m.rmse < 1.1 * before.ate_m.rmse + 0.02


@pytest.mark.slow
def test_a_velocity_that_jumps_in_the_gap_is_told_and_makes_the_bridge_less_certain():
    right, wrong = without_imu(0), without_imu(0, jump_m_s=0.3)
    before, after = (optimize(flight) for flight in (right, wrong))
    assert any("velocity0 reads" in line and "more or less" in line for line in after.warnings)
    nees = evaluate(after, right).nees
    assert nees is not None
    assert nees.pose.mean < 12
    # The part before the gap is not bent.
    (edge,) = (e for e in before.relative_poses if e.kind == "inertial")
    std_m = np.sqrt(np.trace(before.covariances[1 : edge.j, 3:, 3:], axis1=1, axis2=2))
    moved_m = np.linalg.norm((after.w_T_b - before.w_T_b)[1 : edge.j, :3, 3], axis=1)
    assert (moved_m < 0.5 * std_m + 1e-3).all()


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_readings_of_the_wrong_sign_do_not_move_the_map(sign):
    flight = replace(one_way(0), velocity=None)
    assert flight.imu is not None
    wrong = replace(flight, imu=replace(flight.imu, accel_m_s2=sign * flight.imu.accel_m_s2))
    estimate = optimize(wrong)
    assert ("imu0" in estimate.status) == (sign < 0)
    nees = evaluate(estimate, flight).nees
    assert sign < 0 or (nees is not None and nees.pose.mean < 10)


@pytest.mark.slow
def test_a_map_whose_lengths_only_the_whole_tells_is_in_metres():
    """Over lines, no part tells the lengths by the accelerometer, but all parts together do."""
    flight = replace(flown(KINDS["floor of lines"], 0), sonar=None)
    estimate = optimize(flight)
    assert estimate.metric
    assert not any("could not determine the metric scale" in line for line in estimate.warnings)
    found = evaluate(estimate, flight)
    assert abs(np.log(found.scale)) < 2 * estimate.scale_std < 0.05
