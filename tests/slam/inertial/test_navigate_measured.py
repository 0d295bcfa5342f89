"""``slam estimate`` on measured flights: against motion capture, against GPS, against what is known of
them."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.evaluation import evaluate
from slam.evaluation.association import poses_at
from slam.inertial.navigate import navigate
from slam.io.flight_folder import read_flight
from tests.benchmarks.estimates import drift_m, off_m, with_early_gps

DATA = os.environ.get("SLAM_DATA")
pytestmark = [
    pytest.mark.skipif(DATA is None, reason="SLAM_DATA names no folder with measured data"),
    pytest.mark.slow,
]


def measured(name: str) -> Flight:
    return read_flight(Path(str(DATA)) / "flights" / name)


def test_drone_in_wind_agrees_with_motion_capture():
    flight = measured("ardrone2-optitrack")
    found = navigate(flight)
    evaluation = evaluate(found.estimate, flight)
    assert evaluation.ate_m.rmse < 0.45
    assert evaluation.ate_aligned_m.rmse < 0.25
    # Its own roll is 6 to 9 degrees off in the wind; the estimate's is not.
    own, tracks = (
        found.track.smoothed.errors["own_attitude"],
        found.estimate.stamps_s - found.estimate.stamps_s[0],
    )
    assert np.degrees(np.abs(own[(tracks > 36) & (tracks < 58), 0])).mean() > 4
    assert evaluation.rpe[0].rotation_deg.rmse < 1
    # The rangefinder is 65 ms late, the accelerometer about 0.7 low.
    assert found.inputs.adjustments.delay_s["range"] == pytest.approx(0.065, abs=0.04)
    assert found.track.smoothed.errors["accel_offset"][-1, 2] == pytest.approx(-0.65, abs=0.15)
    assert any("own roll and pitch are off" in warning for warning in found.estimate.warnings)


def test_segment_that_begins_in_wind_does_not_explain_tilt_as_bias():
    """Its own attitude says level, the accelerometer that it leans by 9 degrees; both may be off."""
    flight = measured("ardrone2-optitrack")
    imu, truth = flight.imu, flight.truth
    assert imu is not None
    assert truth is not None
    inside = (imu.stamps_s > 44) & (imu.stamps_s < 54)
    piece = replace(
        flight,
        imu=replace(
            imu,
            stamps_s=imu.stamps_s[inside],
            gyro_rad_s=imu.gyro_rad_s[inside],
            accel_m_s2=imu.accel_m_s2[inside],
        ),
    )
    found = navigate(piece).estimate
    up = poses_at(truth, found.stamps_s)[:, 2, :3]
    off = np.cross(up, found.w_T_b[:, 2, :3])[:, :2]
    nees = np.einsum("na,nab,nb->n", off, np.linalg.inv(found.covariances[:, :2, :2]), off)
    assert np.degrees(np.sqrt(np.mean(np.sum(off**2, axis=1)))) < 4.5
    assert nees.mean() < 15


def test_gps_improves_on_board_dead_reckoning():
    flight = measured("px4flow-quad")
    tracks = evaluate(navigate(flight).estimate, flight).tracks
    assert off_m(tracks, tracks.loops_m) < min(2.5, 0.5 * off_m(tracks, tracks.chain_m))


def test_withheld_gps_agrees_at_least_as_well_as_dead_reckoning():
    """Fixes of the first five minutes are used; behind them the way to the rest is compared."""
    tracks = with_early_gps(measured("px4flow-quad"))
    assert drift_m(tracks, tracks.loops_m) < drift_m(tracks, tracks.chain_m)


@pytest.mark.parametrize(
    ("name", "said"), [("ardrone-pulses/run-01", "pitch"), ("ardrone2-steps/forward-1", "no velocity0")]
)
def test_insufficient_recording_raises(name, said):
    with pytest.raises(InputError, match="too little to tell how it moved") as refused:
        navigate(measured(name))
    assert said in str(refused.value)
