"""Checks of measured flights by instruments that criticism does not use: motion capture and GPS."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slam.core.flight import Flight
from slam.core.streams import AttitudeSeries, Sonar, Velocity
from slam.simulation.replay.channels import truth_angles

EARTH_RADIUS_M = 6371000.0
APART_S = 2.0
"""Time between positions in seconds; nearer ones show their own noise rather than the speed."""
LATE_S = np.arange(0.0, 1.01, 0.05)
MOVING_M_S = 0.5


@dataclass(frozen=True)
class AgainstGps:
    """Comparison of an optical-flow sensor's speed with the speed between GPS positions."""

    scale: float
    std: float
    count: int
    late_s: float
    """Delay of GPS with the best agreement, in seconds."""
    rms_m_s: float


def with_truth_for_instruments(flight: Flight) -> Flight:
    """Return the flight with the reference motion in place of attitude, speed and height."""
    assert flight.truth is not None
    assert flight.truth.w_v_m_s is not None
    stamps, pose = flight.truth.stamps_s, flight.truth.w_T_b
    angles = truth_angles(flight.truth)
    cos, sin = np.cos(angles[:, 2]), np.sin(angles[:, 2])
    v_x, v_y = flight.truth.w_v_m_s[:, :2].T
    ahead_left = np.column_stack([cos * v_x + sin * v_y, cos * v_y - sin * v_x])
    slant_m = pose[:, 2, 3] / np.maximum(pose[:, 2, 2], 0.5)
    return replace(
        flight,
        attitude=AttitudeSeries(stamps, angles),
        velocity=Velocity(stamps, ahead_left),
        sonar=Sonar(stamps, slant_m),
    )


def against_gps(flight: Flight) -> AgainstGps:
    """Compare the flow's speed, rotated by the vehicle's yaw and averaged over ``APART_S``, with GPS."""
    gps, flow, attitude = flight.gps, flight.velocity, flight.attitude
    assert gps is not None
    assert flow is not None
    assert attitude is not None
    place = np.radians(np.column_stack([gps.longitude_deg, gps.latitude_deg]))
    east_north = EARTH_RADIUS_M * (place - place[0]) * [np.cos(place[0, 1]), 1.0]
    good = np.isfinite(flow.v_m_s).all(axis=1)
    stamps, seen = flow.stamps_s[good], flow.v_m_s[good]
    yaw = np.interp(stamps, attitude.stamps_s, np.unwrap(attitude.roll_pitch_yaw_rad[:, 2]))
    turned = np.column_stack(
        [
            np.cos(yaw) * seen[:, 0] - np.sin(yaw) * seen[:, 1],
            np.sin(yaw) * seen[:, 0] + np.cos(yaw) * seen[:, 1],
        ]
    )
    way = np.vstack(
        [np.zeros(2), np.cumsum(0.5 * np.diff(stamps)[:, None] * (turned[1:] + turned[:-1]), axis=0)]
    )
    moments = np.arange(
        max(stamps[0], gps.stamps_s[0]) + 1.0, min(stamps[-1], gps.stamps_s[-1]) - 2.0, APART_S
    )
    step = np.diff(_at(moments, stamps, way), axis=0) / APART_S

    def fit(late_s: float) -> tuple[float, AgainstGps]:
        other = np.diff(_at(moments + late_s, gps.stamps_s, east_north), axis=0) / APART_S
        moving = np.linalg.norm(other, axis=1) > MOVING_M_S
        x, y = other[moving].ravel(), step[moving].ravel()
        scale = float(x @ y / (x @ x))
        left = y - scale * x
        std = float(np.sqrt(np.sum(left**2 * x**2)) / (x @ x))
        rms = float(np.sqrt(np.mean(left**2)))
        return rms, AgainstGps(scale, std, int(moving.sum()), late_s, rms)

    return min((fit(float(late)) for late in LATE_S), key=lambda found: found[0])[1]


def _at(times_s: np.ndarray, stamps_s: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(times_s, stamps_s, column) for column in values.T])
