"""A delay or a step of the pictures' clock that is well known is taken out, any other is held and told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.clocks.picture_clock import ClockPiece, PictureClock
from slam.core.units import SPACE
from slam.evaluation import evaluate
from slam.mapping.calibration.clock_offset import (
    NO_CORRECTION,
    clock_contradiction,
    clock_correction,
    clock_displacements,
    clock_errors,
    clock_warning,
    finer_correction,
)
from slam.mapping.pipeline import optimize
from slam.simulation import simulate
from slam.simulation.recipe import recipe_from
from tests.slam.small_flight import flown

STAMPS_S = np.array([0.0, 4.5, 8.5, 10.0, 10.5, 20.0])


def shown(*delays: tuple[float, float]) -> PictureClock:
    """Return a clock with one piece each ten seconds: delay and standard deviation."""
    pieces = [
        ClockPiece(10.0 * k if k else float("-inf"), delay_s, std_s)
        for k, (delay_s, std_s) in enumerate(delays)
    ]
    return PictureClock(tuple(pieces), 2.0)


@pytest.mark.parametrize(
    ("delay_s", "std_s", "taken_out_s"),
    [
        (0.04, 0.002, 0.04),
        (-0.06, 0.002, -0.06),
        (0.02, 0.001, 0.0),  # a cheap camera's stamps
        (0.04, 0.01, 0.0),  # chance
        (1.99, 0.001, 0.0),  # as far as was looked: it may be more
        (0.5, 1.0, 0.0),  # several delays explain the turns as well
    ],
)
def test_a_delay_is_taken_out_where_it_is_sure(delay_s, std_s, taken_out_s):
    assert clock_correction(shown((delay_s, std_s)), STAMPS_S).delays_at(np.array([5.0])) == [taken_out_s]
    assert clock_correction(None, STAMPS_S) is NO_CORRECTION


def test_a_step_is_taken_out_on_both_sides_or_not_at_all():
    taken_out = clock_correction(shown((0.003, 0.002), (1.0, 0.003)), STAMPS_S)
    np.testing.assert_allclose(taken_out.delays_at(np.array([0.0, 9.0, 10.0, 20.0])), [0, 0, 1, 1])
    torn = shown((0.003, 0.02), (1.0, 0.003))
    assert clock_correction(torn, STAMPS_S) is NO_CORRECTION
    assert "one side of it is too vague" in str(clock_contradiction(torn, NO_CORRECTION))


def test_a_step_that_would_tear_the_order_of_the_pictures_is_not_taken_out():
    """A clock that is set forward by a second leaves a second without pictures."""
    assert clock_correction(shown((0.0, 0.002), (1.0, 0.002)), np.arange(0.0, 20.0, 0.5)) is NO_CORRECTION


def test_the_map_corrects_what_tracking_left():
    first = shown((0.09, 0.002))
    assert finer_correction(shown((0.001, 0.002)), first, STAMPS_S) is first
    (piece,) = finer_correction(shown((0.01, 0.002)), first, STAMPS_S).pieces
    assert piece.delay_s == pytest.approx(0.1)
    (piece,) = finer_correction(shown((0.1, 0.002)), NO_CORRECTION, STAMPS_S).pieces
    assert piece.delay_s == pytest.approx(0.1)


def test_what_is_reported_names_what_was_done():
    known = clock_correction(shown((0.04, 0.002)), STAMPS_S)
    assert f"40.0 ±{SPACE}2.0 ms after" in str(clock_warning(None, known))
    assert "corrected in the map" in str(clock_warning(None, known))
    stepped = str(clock_warning(None, clock_correction(shown((0.0, 0.002), (1.0, 0.002)), STAMPS_S)))
    assert stepped.startswith(
        f"the clock of cam0 steps against imu0 by +1.0000 ±{SPACE}0.0028 s at 10.00 s: corrected"
    )
    assert "cannot be determined" in str(clock_warning(shown((0.04, np.inf)), NO_CORRECTION))
    assert "or more" in str(clock_contradiction(shown((-1.99, 0.001)), NO_CORRECTION))
    assert "still disagree" in str(clock_contradiction(shown((0.1, 0.001)), known))
    for clock in (shown((0.01, 0.001)), None):
        assert clock_warning(clock, NO_CORRECTION) is None
        assert clock_contradiction(clock, NO_CORRECTION) is None


def test_figures_tell_each_span_of_the_clock():
    assert clock_errors(None, NO_CORRECTION) is None
    before, after = clock_errors(None, clock_correction(shown((0.003, 0.002), (1.0, 0.003)), STAMPS_S)).spans
    assert (before.begin_s, before.delay_s, after.begin_s, after.delay_s) == (None, 0.0, 10.0, 1.0)
    assert after.taken_out


def test_an_error_of_the_time_moves_a_pose_along_its_motion():
    poses, stamps_s = np.tile(np.eye(4), (4, 1, 1)), 0.5 * np.arange(4)
    poses[:, 0, 3] = 2.0 * stamps_s  # 2 m/s
    poses[3] = np.nan
    pieces = ClockPiece(float("-inf"), 0.0, 0.01), ClockPiece(0.4, 0.0, 0.02)
    moved = clock_displacements(PictureClock(pieces, 1.0), poses, stamps_s, stamps_s)
    np.testing.assert_allclose(moved[:, 3], [[0.02, 0.0], [0.0, 0.04], [0.0, 0.04], [0.0, 0.0]])
    moved[:, 3] = 0.0
    np.testing.assert_allclose(moved, 0.0)


CALM = {
    "name": "calm",
    "maneuver": {"way_points": [[0.6, 0.6], [2.2, 0.6], [2.2, 1.4], [0.6, 1.4], [0.6, 0.6]], "laps": 2}
    | {"height_m": 1.0, "cruise_m_s": 0.3, "acceleration_m_s2": 0.3},
    "world": {"extent_m": [0.0, 0.0, 3.0, 2.0]},
    "camera": {"size_px": [320, 240], "rate_hz": 5.0},
    "hold_noise": {"tilt_std_deg": 0.1, "yaw_rate_std_deg_s": 0.3}
    | {"velocity_std_m_s": 0.01, "velocity_up_std_m_s": 0.005},
}
"""Two calm laps, 5 pictures and 200 readings of the IMU a second."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "late_s", "step_s"),
    [
        (1, 0.0, 0.0),
        (2, 0.0, 0.0),
        (4, 0.0, 0.0),
        (4, 0.1, 0.0),
        (1, 0.1, 0.0),
        (3, 0.0, 1.0),
        (2, 0.0, -0.15),
    ],
)
def test_the_map_of_a_calm_flight_stands_at_the_right_times(seed: int, late_s: float, step_s: float):
    flight = simulate(recipe_from(CALM, "calm"), seed=seed)
    frames = flight.frames
    late = frames.stamps_s + late_s + np.where(frames.stamps_s > 15.0, step_s, 0.0)
    estimate = optimize(replace(flight, frames=replace(frames, stamps_s=late)))
    assert estimate.status == "ok"
    spans = estimate.instruments.picture_clock.spans
    assert [span.taken_out for span in spans] == [late_s + step_s != 0] * len(spans)
    assert len(spans) == (2 if step_s else 1)
    expected = [late_s, late_s + step_s][: len(spans)]
    for span, delay_s in zip(spans, expected, strict=True):
        assert abs(span.delay_s - delay_s) < 3 * span.delay_std_s < 0.03
    run = evaluate(estimate, flight)
    assert run.ate_m.rmse < 0.005
    assert run.nees.position.mean < 2 * run.nees.position.upper95


def _stepping(stamps_s):
    return stamps_s + np.where(np.arange(len(stamps_s)) >= int(0.8 * len(stamps_s)), 0.4, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("clock", "told"),
    [
        (_stepping, "differs from imu0's by +0.39"),
        (lambda stamps_s: 1.03 * stamps_s, "(a step or a drift), which is not corrected"),
        (lambda stamps_s: stamps_s, ""),
    ],
)
def test_a_step_near_the_end_and_a_drift_are_in_the_status(clock, told: str):
    """The step leaves poses 0.16 m off, and the drift 0.04 m, where 3 mm are told."""
    flight = flown(4)
    stamps_s = clock(flight.frames.stamps_s)
    status = optimize(replace(flight, frames=replace(flight.frames, stamps_s=stamps_s))).status
    assert told in status
    assert (status == "ok") == (not told)
