"""PX4 logs (ULog), read by ``pyulog``.

PX4's body axes are forward-right-down, its world is north-east-down, and its stamps are microseconds since
the start of the autopilot. Sources: PX4 user guide, "ULog file format"; the message definitions in
PX4-Autopilot/msg (``SensorCombined.msg``, ``VehicleOpticalFlow.msg``, ``DistanceSensor.msg`` and so on).
"""

from __future__ import annotations

import contextlib
import errno
import io
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from backend.wording import counted
from slam.core.messages import Message, warning
from slam.io.body_axes import angles_from_ned_quaternion
from slam.io.gps_accuracy import with_accuracy
from slam.io.recordings.logs import field_values
from slam.io.recordings.logs.field_rules import FieldRule, FieldSeries, above_sea_level, field_recording
from slam.io.recordings.logs.field_values import Converted, Fields, column, columns
from slam.io.recordings.range_limits import Limits, limits_entries, stated_limits, within
from slam.io.recordings.readers import damage_reported, optional_reader
from slam.io.recordings.recording import COPY_AGAIN, Recording
from slam.io.sensor_yaml import Value

if TYPE_CHECKING:
    from pyulog import ULog

DESCRIPTION = "a PX4 log"


def _names(name: str, count: int) -> tuple[str, ...]:
    return tuple(f"{name}[{k}]" for k in range(count))


def _imu(fields: Fields) -> Converted:
    return field_values.frd_vectors(fields, *_names("gyro_rad", 3), *_names("accelerometer_m_s2", 3)), ()


def _attitude(fields: Fields) -> Converted:
    resets = 0
    if "quat_reset_counter" in fields:
        resets = int((np.diff(column(fields, "quat_reset_counter")) != 0).sum())
    notes = (
        warning(
            f"the autopilot's filter reset its attitude {counted(resets, 'time')}, at which the yaw may step",
            "check the heading there",
        ),
    )
    return angles_from_ned_quaternion(columns(fields, *_names("q", 4))), notes * bool(resets)


def _gps(fields: Fields, names: tuple[str, str, str], units: tuple[float, float]) -> Converted:
    values = columns(fields, *names) * [units[0], units[0], units[1]]
    known = field_values.known_fixes(values, column(fields, "fix_type"))
    if any(name not in fields for name in ("eph", "epv")):  # of older versions
        return known, ()
    return with_accuracy(known, columns(fields, "eph", "eph", "epv")), ()


def _limits(fields: Fields) -> Limits | None:
    return stated_limits(column(fields, "min_distance"), column(fields, "max_distance"))


def _range(fields: Fields) -> Converted:
    range_m = column(fields, "current_distance")
    valid = within(range_m, _limits(fields))
    if "signal_quality" in fields:  # 0 is an invalid reading, -1 an unknown quality
        valid &= column(fields, "signal_quality") != 0
    return field_values.only_down(range_m, column(fields, "orientation") == field_values.DOWN, valid)


def _range_nominal(fields: Fields) -> dict[str, Value]:
    nominal = limits_entries(_limits(fields))
    variance = float(np.median(column(fields, "variance"))) if "variance" in fields else 0.0
    if variance > 0:
        nominal["noise_std"] = [repr(float(np.sqrt(variance)))]
    return nominal


def _flow(fields: Fields) -> Converted:
    angles = columns(fields, *_names("pixel_flow", 2)) - columns(fields, *_names("delta_angle", 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = angles / (column(fields, "integration_timespan_us") * 1e-6)[:, None]
    return field_values.flow_velocity(rates, column(fields, "distance_m"), column(fields, "quality") > 0)


def _older_flow(fields: Fields) -> Converted:
    """Return velocities from the message of PX4 before 1.13."""
    turns = columns(fields, "gyro_x_rate_integral", "gyro_y_rate_integral")
    angles = columns(fields, "pixel_flow_x_integral", "pixel_flow_y_integral") - turns
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = angles / (column(fields, "integration_timespan") * 1e-6)[:, None]
    distance_m = column(fields, "ground_distance_m")
    is_valid = (column(fields, "quality") > 0) & (distance_m > 0)
    return field_values.flow_velocity(rates, distance_m, is_valid)


def _sticks(fields: Fields, names: Sequence[str], throttle_from_zero: bool) -> Converted:
    pitch, roll, throttle, yaw = columns(fields, *names).T
    up = 2 * throttle - 1 if throttle_from_zero else throttle
    return np.column_stack([pitch, -roll, up, -yaw]), ()


def _motors(fields: Fields) -> Converted:
    return columns(fields, *_names("control", 4)), ()


_STICKS = ("pitch", "roll", "throttle", "yaw")
_OLD_STICKS = ("x", "y", "z", "r")
_FIX_DEG = ("latitude_deg", "longitude_deg", "altitude_msl_m")
_FIX_INTEGER = ("lat", "lon", "alt")
_FLOW = ("pixel_flow[1]", "delta_angle[1]", "integration_timespan_us", "distance_m", "quality")
_OLDER_FLOW = (
    *("pixel_flow_x_integral", "pixel_flow_y_integral", "gyro_x_rate_integral", "gyro_y_rate_integral"),
    *("integration_timespan", "ground_distance_m", "quality"),
)
_fix_deg = partial(_gps, names=_FIX_DEG, units=(1.0, 1.0))
_fix_integer = partial(_gps, names=_FIX_INTEGER, units=(1e-7, 1e-3))
_sticks_now = partial(_sticks, names=_STICKS, throttle_from_zero=False)
_sticks_before = partial(_sticks, names=_OLD_STICKS, throttle_from_zero=True)
_voltage, _height = field_values.single("voltage_v"), field_values.single("baro_alt_meter")

_FRD = "forward-right-down to forward-left-up"
_ATTITUDE = f"quaternion; north-east-down to yaw from east, {_FRD}"
_COMMAND = "1; right and clockwise to left and counter-clockwise"
_COMMAND_BEFORE = f"{_COMMAND}, throttle 0..1 to -1..1"
_SPEED = "rad, m; to m/s forward and left"
_RANGE = ("current_distance", "min_distance", "max_distance", "orientation")
_SENSOR_COMBINED = ("gyro_rad[0]", "accelerometer_m_s2[0]")
_DEG, _INTEGER = "deg, m above sea level", "1e-7 deg, mm above sea level"
RULES: tuple[FieldRule, ...] = (
    FieldRule("imu0", "sensor_combined", _SENSOR_COMBINED, _imu, f"rad/s, m/s²; {_FRD}"),
    FieldRule(
        "sonar0",
        "distance_sensor",
        ("current_distance", "orientation"),
        _range,
        "m, facing down",
        _range_nominal,
    ),
    FieldRule("attitude0", "vehicle_attitude", ("q[3]",), _attitude, _ATTITUDE),
    FieldRule("velocity0", "vehicle_optical_flow", _FLOW, _flow, _SPEED),
    FieldRule("velocity0", "sensor_optical_flow", _FLOW, _flow, _SPEED),
    FieldRule("velocity0", "optical_flow", _OLDER_FLOW, _older_flow, _SPEED),
    FieldRule("command0", "manual_control_setpoint", _STICKS, _sticks_now, _COMMAND),
    FieldRule("command0", "manual_control_setpoint", _OLD_STICKS, _sticks_before, _COMMAND_BEFORE),
    FieldRule("battery0", "battery_status", ("voltage_v",), _voltage, "V"),
    *(
        rule
        for kind in ("vehicle_gps_position", "sensor_gps")
        for rule in (
            FieldRule("gps0", kind, (*_FIX_DEG, "fix_type"), _fix_deg, _DEG, above_sea_level),
            FieldRule("gps0", kind, (*_FIX_INTEGER, "fix_type"), _fix_integer, _INTEGER, above_sea_level),
        )
    ),
    FieldRule("barometer0", "vehicle_air_data", ("baro_alt_meter",), _height, "m"),
    FieldRule("barometer0", "sensor_combined", ("baro_alt_meter",), _height, "m"),
    FieldRule("motor0", "actuator_motors", ("control[3]",), _motors, "0..1, in the log's order"),
)
"""The message types of PX4 and what they become, in the order of preference."""


def open_recording(path: Path) -> Recording:
    """Open a PX4 log. Raises ``InputError`` without ``pyulog``, or for a damaged file."""
    with optional_reader(path, DESCRIPTION, "px4"):
        from pyulog import ULog
    log, cut = _parsed(path, ULog)
    series = {
        f"{data.name}[{data.multi_id}]" if data.multi_id else data.name: _stamped(data)
        for data in log.data_list
        if "timestamp" in data.data
    }
    return field_recording(path, DESCRIPTION, series, RULES, _damage(log, cut), _metadata(log))


def _stamped(data: ULog.Data) -> FieldSeries:
    """Return the messages of a topic. A stamp of zero is a message that was never published."""
    stamps_us = np.asarray(data.data["timestamp"], np.int64)
    published = stamps_us > 0
    fields = {name: np.asarray(values)[published] for name, values in data.data.items()}
    return FieldSeries(data.name, stamps_us[published] * field_values.NS_PER_US, fields)


def _parsed(path: Path, reader: type[ULog]) -> tuple[ULog, bool]:
    """Return the log, and whether the file ends within a message."""
    silence = contextlib.redirect_stdout(io.StringIO())
    with damage_reported(path, DESCRIPTION), _EndingFile(path) as file, silence:
        return reader(file), file.is_cut


class _EndingFile(io.BufferedReader):
    """File that stops ``pyulog`` where it steps back from a message beyond the end again and again."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self._beyond: set[tuple[int, int]] = set()

    @property
    def is_cut(self) -> bool:
        """Whether a message was asked for of which the file holds only the first part."""
        return bool(self._beyond)

    def read(self, size: int | None = -1) -> bytes:
        """Read bytes as any file does. Raises ``OSError`` for the second read of a message beyond the end."""
        data = super().read(size)
        if data and size is not None and len(data) < size:
            message = (self.tell() - len(data), size)
            if message in self._beyond:
                raise OSError(errno.EINVAL, "a message beyond the end of the file")
            self._beyond.add(message)
        return data


def _damage(log: ULog, cut: bool) -> tuple[Message, ...]:
    lines = []
    if log.dropouts:
        lost_s = sum(dropout.duration for dropout in log.dropouts) * 1e-3
        lines.append(
            warning(
                f"the logger lost data {counted(len(log.dropouts), 'time')}, {lost_s:.2f} s in all",
                "use a faster card, or log less",
            )
        )
    if log.file_corruption:
        lines.append(warning("part of the log is damaged and was skipped", COPY_AGAIN))
    elif cut:
        lines.append(
            warning(
                "the log ends within a message: it was cut short, and what came after is lost",
                COPY_AGAIN,
            )
        )
    return tuple(lines)


def _metadata(log: ULog) -> dict[str, str]:
    sources = {"vehicle": ("sys_name", "ver_hw")}
    notes = {
        key: " ".join(str(log.msg_info_dict[name]) for name in names if name in log.msg_info_dict)
        for key, names in sources.items()
    }
    return {key: value for key, value in notes.items() if value}
