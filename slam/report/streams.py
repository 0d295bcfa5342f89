"""Streams of a flight in the words of a pilot."""

from __future__ import annotations

from collections.abc import Mapping

STREAM_WORDS: Mapping[str, str] = {
    "cam0": "the camera",
    "imu0": "gyro and accelerometer",
    "attitude0": "the attitude sensor (roll, pitch and heading)",
    "sonar0": "the height sensor",
    "gps0": "the GPS",
    "velocity0": "the vehicle's own velocity",
    "barometer0": "the barometer",
}
"""Name of a stream in messages -> in words."""
