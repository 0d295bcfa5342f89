"""Names of the instruments that have the errors of the catalogue."""

from __future__ import annotations

from collections.abc import Mapping

from slam.simulation.terms import CATALOGUE

_BY_NAME: Mapping[str, str] = {
    "gyro_scale": "gyro",
    "gyro_bias": "gyro",
    "accel_scale": "accelerometer",
    "accel_bias": "accelerometer",
    "imu_misalignment": "mounting of the IMU",
    "sonar_tilt": "mounting of the height sensor",
    "camera_tilt": "mounting of the camera",
    "camera_time_offset": "clock of the camera",
    "clock_drift": "clock of the log",
    "timestamp_jitter": "clock of the log",
}
_BY_STREAM: Mapping[str, str] = {"sonar": "height sensor", "velocity": "speed sensor", "imu": "IMU"}
SENSOR_OF_READING: Mapping[str, str] = {
    "velocity": "speed sensor",
    "range": "height sensor",
    "gyro": "gyro",
    "accel": "accelerometer",
    "roll": "attitude",
    "pitch": "attitude",
    "yaw": "heading",
}
"""Reading of a residual pattern, without its axis -> the sensor."""


def instrument_of(name: str) -> str:
    """Return the instrument that has an error of the catalogue; empty for one of the vehicle or the place."""
    term = CATALOGUE[name]
    if not term.is_of_instrument or term.family == "place":
        return ""
    return (
        _BY_NAME.get(name) or _BY_STREAM.get(term.stream) or ("sonar" if term.family == "sonar" else "camera")
    )
