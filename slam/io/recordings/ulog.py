"""PX4 logs (ULog), read by ``pyulog``.

PX4's body axes are forward-right-down, its world is north-east-down, and its stamps are microseconds since
the start of the autopilot. Sources: PX4 user guide, "ULog file format"; the message definitions in
PX4-Autopilot/msg (``SensorCombined.msg``, ``VehicleOpticalFlow.msg``, ``DistanceSensor.msg`` and so on).
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam.core.progress import Progress
from slam.io.body_axes import angles_from_ned_quaternion, body_from_frd
from slam.io.recordings.readers import damage_reported, optional_reader
from slam.io.recordings.recording import Content, Offer, Recording, StreamReadings
from slam.io.sensor_yaml import Value

if TYPE_CHECKING:
    from pyulog import ULog

Array = NDArray[np.float64]
Fields = dict[str, NDArray[np.generic]]
Converted = tuple[Array, tuple[str, ...]]
"""Values (n, c) in the columns of the flight format, and notes."""

DESCRIPTION = "a PX4 log"
_DOWN = 25
"""``distance_sensor.orientation`` of a sensor that looks down (MAVLink's ROTATION_PITCH_270)."""
_FIX_2D, _FIX_3D = 2, 3
_NS_PER_US = 1000


@dataclass(frozen=True)
class _Rule:
    """One message type that can fill one stream."""

    stream: str
    kind: str
    needs: tuple[str, ...]
    """Fields that must be there; they tell the versions of a message apart."""
    values: Callable[[Fields], Converted]
    reading: str


def _vector(fields: Fields, name: str, count: int = 3) -> Array:
    return np.column_stack([np.asarray(fields[f"{name}[{k}]"], float) for k in range(count)])


def _column(fields: Fields, name: str) -> Array:
    return np.asarray(fields[name], float)


def _imu(fields: Fields) -> Converted:
    values = [body_from_frd(_vector(fields, name)) for name in ("gyro_rad", "accelerometer_m_s2")]
    return np.hstack(values), ()


def _attitude(fields: Fields) -> Converted:
    return angles_from_ned_quaternion(_vector(fields, "q", 4)), ()


def _gps(fields: Fields, names: tuple[str, str, str], units: tuple[float, float]) -> Converted:
    latitude, longitude, altitude = (_column(fields, name) for name in names)
    values = np.column_stack([latitude * units[0], longitude * units[0], altitude * units[1]])
    fix = _column(fields, "fix_type")
    values[fix < _FIX_2D] = np.nan
    values[fix < _FIX_3D, 2] = np.nan
    return values, ()


def _range(fields: Fields) -> Converted:
    distance = _column(fields, "current_distance")
    outside = (distance < _column(fields, "min_distance")) | (distance > _column(fields, "max_distance"))
    if "signal_quality" in fields:  # 0 is an invalid reading, -1 an unknown quality
        outside |= fields["signal_quality"] == 0
    down = fields["orientation"] == _DOWN
    distance[outside | ~down] = np.nan
    notes = (
        (f"{int((~down).sum())} readings of sensors that do not look down left out",)
        if not down.all()
        else ()
    )
    return distance[:, None], notes


def _flow(fields: Fields) -> Converted:
    """Return the velocity from accumulated flow, less the turn of the sensor, times the distance.

    The flow is positive where it looks like a right-handed turn of the sensor about the body axis. The
    sensor's boresight moves forward over the ground in such a turn about y, and to the left about x.
    """
    seconds = _column(fields, "integration_timespan_us") * 1e-6
    flow = _vector(fields, "pixel_flow", 2) - _vector(fields, "delta_angle", 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = flow / seconds[:, None] * _column(fields, "distance_m")[:, None]
    values = np.column_stack([rate[:, 1], rate[:, 0]])
    values[(fields["quality"] == 0) | ~np.isfinite(values).all(axis=1)] = np.nan
    return values, ("from flow times distance; body axes taken as level",)


def _sticks(fields: Fields, names: Sequence[str], throttle_from_zero: bool) -> Converted:
    pitch, roll, throttle, yaw = (_column(fields, name) for name in names)
    up = 2 * throttle - 1 if throttle_from_zero else throttle
    return np.column_stack([pitch, -roll, up, -yaw]), ()


def _single(fields: Fields, name: str) -> Converted:
    return _column(fields, name)[:, None], ()


def _motors(fields: Fields) -> Converted:
    return _vector(fields, "control", 4), ()


_STICKS = ("pitch", "roll", "throttle", "yaw")
_OLD_STICKS = ("x", "y", "z", "r")
_FIX_DEG = ("latitude_deg", "longitude_deg", "altitude_msl_m")
_FIX_INTEGER = ("lat", "lon", "alt")
_FLOW = ("pixel_flow[1]", "delta_angle[1]", "integration_timespan_us", "distance_m", "quality")
_fix_deg = partial(_gps, names=_FIX_DEG, units=(1.0, 1.0))
_fix_integer = partial(_gps, names=_FIX_INTEGER, units=(1e-7, 1e-3))
_sticks_now = partial(_sticks, names=_STICKS, throttle_from_zero=False)
_sticks_before = partial(_sticks, names=_OLD_STICKS, throttle_from_zero=True)
_voltage = partial(_single, name="voltage_v")
_height = partial(_single, name="baro_alt_meter")

_FRD = "forward-right-down to forward-left-up"
_ATTITUDE = f"quaternion; north-east-down to yaw from east, {_FRD}"
_COMMAND = "1; right and clockwise to left and counter-clockwise"
_COMMAND_BEFORE = f"{_COMMAND}, throttle 0..1 to -1..1"
_SPEED = "rad, m; to m/s forward and left"
_SENSOR_COMBINED = ("gyro_rad[0]", "accelerometer_m_s2[0]")
_DEG, _INTEGER = "deg, m above sea level", "1e-7 deg, mm above sea level"
RULES: tuple[_Rule, ...] = (
    _Rule("imu0", "sensor_combined", _SENSOR_COMBINED, _imu, f"rad/s, m/s²; {_FRD}"),
    _Rule("sonar0", "distance_sensor", ("current_distance", "orientation"), _range, "m, facing down"),
    _Rule("attitude0", "vehicle_attitude", ("q[3]",), _attitude, _ATTITUDE),
    _Rule("velocity0", "vehicle_optical_flow", _FLOW, _flow, _SPEED),
    _Rule("command0", "manual_control_setpoint", _STICKS, _sticks_now, _COMMAND),
    _Rule("command0", "manual_control_setpoint", _OLD_STICKS, _sticks_before, _COMMAND_BEFORE),
    _Rule("battery0", "battery_status", ("voltage_v",), _voltage, "V"),
    _Rule("gps0", "vehicle_gps_position", (*_FIX_DEG, "fix_type"), _fix_deg, _DEG),
    _Rule("gps0", "vehicle_gps_position", (*_FIX_INTEGER, "fix_type"), _fix_integer, _INTEGER),
    _Rule("gps0", "sensor_gps", (*_FIX_DEG, "fix_type"), _fix_deg, _DEG),
    _Rule("gps0", "sensor_gps", (*_FIX_INTEGER, "fix_type"), _fix_integer, _INTEGER),
    _Rule("barometer0", "vehicle_air_data", ("baro_alt_meter",), _height, "m"),
    _Rule("barometer0", "sensor_combined", ("baro_alt_meter",), _height, "m"),
    _Rule("motor0", "actuator_motors", ("control[3]",), _motors, "0..1, in the log's order"),
)
"""The message types of PX4 and what they become, in the order of preference."""


def open_recording(path: Path) -> Recording:
    """Open a PX4 log. Raises ``InputError`` without ``pyulog``, or for a damaged file."""
    with optional_reader(path, DESCRIPTION, "px4"):
        from pyulog import ULog
    log = _parsed(path, ULog)
    series = {_channel(data.name, data.multi_id): data.data for data in log.data_list}
    offers = []
    for rank, rule in enumerate(RULES):
        for data in log.data_list:
            if data.name == rule.kind and all(name in data.data for name in rule.needs):
                offers.append(_offer(rule, _channel(data.name, data.multi_id), data.data, rank))
    offered = {offer.channel for offer in offers}
    others = tuple(
        (name, name.partition("[")[0], len(fields["timestamp"]))
        for name, fields in sorted(series.items())
        if name not in offered
    )

    def read(chosen: Sequence[Offer], progress: Progress) -> Content:
        readings = {offer.stream: _readings(series[offer.channel], RULES[offer.rank]) for offer in chosen}
        return Content(readings, warnings=_damage(log), metadata=_metadata(log))

    return Recording(
        path=path, name=path.stem, description=DESCRIPTION, offers=tuple(offers), others=others, read=read
    )


def _parsed(path: Path, reader: type[ULog]) -> ULog:
    silence = contextlib.redirect_stdout(io.StringIO())
    with damage_reported(path, DESCRIPTION), path.open("rb") as file, silence:
        return reader(file)


def _channel(name: str, instance: int) -> str:
    return f"{name}[{instance}]" if instance else name


def _offer(rule: _Rule, channel: str, fields: Fields, rank: int) -> Offer:
    return Offer(
        stream=rule.stream,
        channel=channel,
        kind=rule.kind,
        rows=len(fields["timestamp"]),
        reading=rule.reading,
        rank=rank,
    )


def _readings(fields: Fields, rule: _Rule) -> StreamReadings:
    values, notes = rule.values(fields)
    stamps_ns = np.asarray(fields["timestamp"], np.int64) * _NS_PER_US
    return StreamReadings(stamps_ns, values, _nominal(fields) if rule.stream == "sonar0" else {}, notes)


def _nominal(fields: Fields) -> dict[str, Value]:
    """Return what ``distance_sensor`` states about its sensor."""
    nominal: dict[str, Value] = {
        "min_range": repr(float(np.median(_column(fields, "min_distance")))),
        "max_range": repr(float(np.median(_column(fields, "max_distance")))),
    }
    variance = float(np.median(_column(fields, "variance"))) if "variance" in fields else 0.0
    if variance > 0:
        nominal["noise_std"] = [repr(float(np.sqrt(variance)))]
    return nominal


def _damage(log: ULog) -> tuple[str, ...]:
    lines = []
    if log.dropouts:
        lost_s = sum(dropout.duration for dropout in log.dropouts) * 1e-3
        lines.append(f"the logger lost data {len(log.dropouts)} times, {lost_s:.2f} s in all")
    if log.file_corruption:
        lines.append("part of the log is damaged and was skipped")
    return tuple(lines)


def _metadata(log: ULog) -> dict[str, str]:
    told = {"vehicle": ("sys_name", "ver_hw")}
    notes = {
        key: " ".join(str(log.msg_info_dict[name]) for name in names if name in log.msg_info_dict)
        for key, names in told.items()
    }
    return {key: value for key, value in notes.items() if value}
