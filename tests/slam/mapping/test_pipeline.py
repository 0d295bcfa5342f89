"""The whole job on short simulated flights: its accuracy, and what comes out of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.evaluation import evaluate
from slam.mapping.pipeline import optimize
from slam.mapping.setup import Setup
from slam.simulation import simulate
from tests.slam.small_flight import flown, gps_of, only, recipe
from tests.slam.whole_job import assert_whole, normal, refusal


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_a_normal_flight(seed):
    """As good as the pictures allow, not better; the covariances say how good."""
    flight, estimate = normal(seed)
    found = evaluate(estimate, flight)
    assert_whole(estimate)
    assert estimate.status == "ok"
    assert estimate.instruments.systematic is None
    assert estimate.frames == len(flight.frames)
    assert 20 < len(estimate.stamps_s) < 45
    assert 2e-4 < found.ate_sim3_m.rmse < 1.5e-3
    assert 3e-4 < found.ate_m.rmse < 3e-3
    # Wide for one flight: what all its poses share (height, scale) is one draw. The next test is sharp.
    assert 0.5 * found.nees.pose.lower95 < found.nees.pose.mean < 2 * found.nees.pose.upper95
    assert (found.loops.precision, found.loops.recall) == (1.0, 1.0)
    assert abs(found.landmarks[0].error_m.loops) < 4e-3
    assert estimate.certificate.certified
    assert 0 < estimate.certificate.moved_m < 0.02, "the best arrangement of the pictures is near the map"
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


@pytest.mark.slow
def test_two_runs_give_the_same_bits():
    flight, one = normal()
    again = optimize(flown(0))
    for field in ("w_T_b", "covariances", "chain_w_T_b", "odometry_w_T_b", "frame_index", "component"):
        assert getattr(one, field).tobytes() == getattr(again, field).tobytes(), field
    assert (one.loops, one.rejected, one.warnings) == (again.loops, again.rejected, again.warnings)
    assert one.graph_error == again.graph_error
    assert flight.name == again.name


def test_progress_is_reported_and_what_it_raises_passes_through():
    stages: dict[str, int] = {}

    def note(stage: str, done: int, total: int) -> None:
        stages[stage] = max(stages.get(stage, 0), done)
        assert total == 0 or done <= total

    flight = only(flown(0), range(16))
    optimize(flight, progress=note)
    assert {"track", "graph", "loops", "refine"} <= set(stages)
    assert stages["track"] == 16

    def interrupted(stage: str, done: int, total: int) -> None:
        if stage == "refine":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        optimize(flight, progress=interrupted)


@pytest.mark.slow
def test_edges_are_lifted_with_tilts_relative_to_the_floor(monkeypatch):
    """GPS hardly determines the slope of the ground, and all pictures share its error."""
    tilt_std_rad: list[float] = []
    with_tilts = Setup.with_tilts

    def spy(self, w_T_b, covariances):
        found = with_tilts(self, w_T_b, covariances)
        tilt_std_rad.append(float(np.median(found.readings.roll_pitch_std_rad)))
        return found

    monkeypatch.setattr(Setup, "with_tilts", spy)
    flight = flown(1)
    estimate = optimize(replace(flight, attitude=None, gps=gps_of(flight, 0.3)))
    on_earth_rad = np.sqrt(np.median(estimate.covariances[:, [0, 1], [0, 1]]))
    assert tilt_std_rad[-1] < 0.7 * on_earth_rad


def test_no_camera_names_the_command_that_needs_none():
    flight = flown(0)
    assert "slam estimate" in refusal(replace(flight, frames=None))
    assert "slam estimate" in refusal(replace(flight, camera=None))
    assert "slam estimate" in refusal(only(flight, []))


def test_a_hover_is_a_small_map():
    """Four seconds over one place: the first and the last picture stand for all, and the status says so."""
    flight = flown(0, maneuver={"way_points": ["A"], "rest_s": 3.0})
    estimate = optimize(flight)
    assert_whole(estimate)
    assert estimate.status.startswith("the pictures show one place only")
    assert len(estimate.stamps_s) == 2
    assert estimate.frames == len(flight.frames)
    assert evaluate(estimate, flight).ate_m.rmse < 3e-3


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
    assert (
        f"2 parts ({sizes[0]}, {sizes[1]} keyframes) that no overlapping pictures connect" in estimate.status
    )
    assert np.isfinite(estimate.covariances).all()
    assert estimate.rejected["tracking started anew"] == 1
    # Each part is right in its own frame.
    x = np.interp(estimate.stamps_s, flight.truth.stamps_s, flight.truth.w_T_b[:, 0, 3])
    for part in (0, 1):
        own = estimate.component == part
        length = np.linalg.norm(np.ptp(estimate.w_T_b[own, :2, 3], axis=0))
        assert length == pytest.approx(np.ptp(x[own]), abs=0.01)
