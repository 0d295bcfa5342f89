"""Telemetry logs of ground stations (MAVLink, ``.tlog``) of ArduPilot, PX4 and others.

MAVLink's body axes are forward-right-down, and its world is north-east-down. Most messages have the time
since the start of the autopilot. The ground station's times of reception place that clock in the calendar:
reception is late by a varying delay, so the smallest difference of the two clocks is taken. Source: MAVLink's
``common.xml``.
"""

from __future__ import annotations

import mmap
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.measurements import GRAVITY_M_S2
from backend.wording import counted, either
from slam.core.messages import Message, note, warning
from slam.io.body_axes import angles_from_aviation, angles_from_ned_quaternion
from slam.io.files import refusal
from slam.io.gps_accuracy import with_accuracy
from slam.io.recordings.logs import field_values
from slam.io.recordings.logs.field_rules import FieldRule, FieldSeries, above_sea_level, field_recording
from slam.io.recordings.logs.field_values import Converted, Fields, column, columns
from slam.io.recordings.logs.mavlink import DECLARATIONS, Packet, telemetry
from slam.io.recordings.logs.sticks import stick_from_pulses
from slam.io.recordings.range_limits import Limits, limits_entries, stated_limits, within
from slam.io.recordings.recording import COPY_AGAIN, Recording

DESCRIPTION = "a MAVLink telemetry log"
_HEARTBEAT = 0
_GROUND_STATION, _NO_AUTOPILOT = 6, 8
"""``type`` of a ground station, and ``autopilot`` of a part that is none, in HEARTBEAT."""
_AUTOPILOTS = {3: "ArduPilot", 12: "PX4"}
_FIRST_UNIX_US = 10**15
"""Smaller times count from the start of the autopilot: this one is in 2001."""
_RESTART_NS = 10**9
"""A clock that goes back by more belongs to an autopilot that was started again."""
_LEAST_IMU_HZ = 50.0
"""Turns of a small drone reach about 10 Hz; slower readings miss them, and cannot be integrated."""
_UNKNOWN_16 = 0xFFFF


@dataclass
class _Messages:
    """Messages of one type, as they are read."""

    received_us: list[int] = field(default_factory=list)
    payloads: list[bytes] = field(default_factory=list)


def _imu(fields: Fields, accel_unit: float, gyro_unit: float) -> Converted:
    names = ("xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc")
    return field_values.frd_vectors(fields, *names) * np.repeat([gyro_unit, accel_unit], 3), ()


def _slow_imu(series: FieldSeries) -> str:
    """Return the rate of an IMU as a doubt, where it is too slow to be integrated."""
    if len(series.stamps_ns) < 2:
        return ""
    rate_hz = 1e9 / max(float(np.median(np.diff(series.stamps_ns))), 1.0)
    return "" if rate_hz >= _LEAST_IMU_HZ else f"{rate_hz:.2g} readings a second are too few to be integrated"


def _attitude(fields: Fields) -> Converted:
    return angles_from_aviation(columns(fields, "roll", "pitch", "yaw")), ()


def _quaternion(fields: Fields) -> Converted:
    return angles_from_ned_quaternion(columns(fields, "q1", "q2", "q3", "q4")), ()


def _gps(fields: Fields) -> Converted:
    values = columns(fields, "lat", "lon", "alt") * (1e-7, 1e-7, 1e-3)
    known = field_values.known_fixes(values, column(fields, "fix_type"))
    return with_accuracy(known, columns(fields, "h_acc", "h_acc", "v_acc") * 1e-3), ()


def _range(fields: Fields) -> Converted:
    range_m = column(fields, "current_distance") * 0.01
    is_down = column(fields, "orientation") == field_values.DOWN
    return field_values.only_down(range_m, is_down, within(range_m, _limits(fields)))


def _limits(fields: Fields) -> Limits | None:
    """Return the limits of the sensors that look down; one message serves all."""
    is_down = column(fields, "orientation") == field_values.DOWN
    if not is_down.any():
        return None
    return stated_limits(*(column(fields, name)[is_down] * 0.01 for name in ("min_distance", "max_distance")))


def _flow(fields: Fields) -> Converted:
    angles = columns(fields, "integrated_x", "integrated_y")
    turns = columns(fields, "integrated_xgyro", "integrated_ygyro")
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = (angles - turns) / (column(fields, "integration_time_us") * 1e-6)[:, None]
    distance_m, quality = column(fields, "distance"), column(fields, "quality")
    return field_values.flow_velocity(rates, distance_m, (quality > 0) & (distance_m > 0))


def _voltage(fields: Fields) -> Converted:
    millivolts = column(fields, "voltage_battery")
    return np.where(millivolts == _UNKNOWN_16, np.nan, millivolts * 1e-3)[:, None], ()


def _altitude(fields: Fields) -> Converted:
    return field_values.standard_altitude(column(fields, "press_abs")), ()


_SI, _MILLI = (
    partial(_imu, accel_unit=1.0, gyro_unit=1.0),
    partial(_imu, accel_unit=GRAVITY_M_S2 * 1e-3, gyro_unit=1e-3),
)
_FRD = "forward-right-down to forward-left-up"
_MILLI_READING = f"mrad/s, 1e-3 g; {_FRD}"
_ANGLES = "rad; yaw from north to east, pitch up to pitch down"
_NED = f"quaternion; north-east-down to yaw from east, {_FRD}"
RULES: tuple[FieldRule, ...] = (
    FieldRule("imu0", "HIGHRES_IMU", ("xgyro", "xacc"), _SI, f"rad/s, m/s²; {_FRD}", doubt=_slow_imu),
    FieldRule("imu0", "SCALED_IMU", ("xgyro", "xacc"), _MILLI, _MILLI_READING, doubt=_slow_imu),
    FieldRule(
        "sonar0",
        "DISTANCE_SENSOR",
        ("current_distance",),
        _range,
        "cm to m, facing down",
        lambda fields: limits_entries(_limits(fields)),
    ),
    FieldRule("sonar0", "RANGEFINDER", ("distance",), field_values.single("distance"), "m, facing down"),
    FieldRule("attitude0", "ATTITUDE_QUATERNION", ("q1",), _quaternion, _NED),
    FieldRule("attitude0", "ATTITUDE", ("roll",), _attitude, _ANGLES),
    FieldRule("velocity0", "OPTICAL_FLOW_RAD", ("integrated_x",), _flow, "rad, m; to m/s forward and left"),
    FieldRule("battery0", "SYS_STATUS", ("voltage_battery",), _voltage, "mV to V"),
    FieldRule("gps0", "GPS_RAW_INT", ("lat",), _gps, "1e-7 deg, mm above sea level", above_sea_level),
    FieldRule("barometer0", "SCALED_PRESSURE", ("press_abs",), _altitude, "hPa to m by ISO 2533"),
)
"""The messages of MAVLink and what they become, in the order of preference."""


def open_recording(path: Path) -> Recording:
    """Open a telemetry log. Raises ``InputError`` where no autopilot sent a message."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        messages, others, lost = _scanned(data)
    system, autopilot = _vehicle(messages)
    if system is None:
        do = "copy it again from the ground station, or give the autopilot's own log"
        raise refusal(path, f"is {DESCRIPTION} without a heartbeat of an autopilot", do)
    series, doubles = _series(
        {number: each for (sender, number), each in messages.items() if sender == system}
    )
    rules = (*RULES, *(_ardupilot_rules(series) if autopilot == "ArduPilot" else ()))
    warnings: list[Message] = [
        note("stamps are those of the autopilot, placed in the calendar by the earliest reception")
    ]
    if lost:
        warnings.append(
            warning(
                f"{counted(lost, 'byte')} of the log {either(lost, 'holds', 'hold')} no packet, damaged "
                "or cut short",
                COPY_AGAIN,
            )
        )
    if doubles:
        line = f"{counted(doubles, 'message was', 'messages were')} received twice, and one of each counts"
        warnings.append(note(line))
    metadata = {"vehicle": autopilot} if autopilot else {}
    unread = [(f"message {number}", "MAVLink", count) for number, count in sorted(others.items())]
    return field_recording(path, DESCRIPTION, series, rules, tuple(warnings), metadata, unread)


def _scanned(data: mmap.mmap) -> tuple[dict[tuple[int, int], _Messages], Counter[int], int]:
    """Return the messages by system and number, the number of others, and of bytes passed over."""
    messages: dict[tuple[int, int], _Messages] = defaultdict(_Messages)
    others: Counter[int] = Counter()
    lost = 0
    for found in telemetry(data):
        if isinstance(found, int):
            lost += found
            continue
        received_us, packet = found
        if packet.number in DECLARATIONS:
            each = messages[packet.system, packet.number]
            each.received_us.append(received_us)
            each.payloads.append(_full_payload(packet))
        else:
            others[packet.number] += 1
    return messages, others, lost


def _full_payload(packet: Packet) -> bytes:
    """Return the payload with the zeros that version 2 drops, and without later extensions."""
    size = DECLARATIONS[packet.number].dtype.itemsize
    return packet.payload[:size].ljust(size, b"\0")


def _table(number: int, each: _Messages) -> NDArray[np.void]:
    return np.frombuffer(b"".join(each.payloads), DECLARATIONS[number].dtype)


def _vehicle(messages: dict[tuple[int, int], _Messages]) -> tuple[int | None, str]:
    """Return the system with the most heartbeats of an autopilot, and the autopilot's name if it is known."""
    counts: Counter[tuple[int, int]] = Counter()
    for (system, number), each in messages.items():
        if number == _HEARTBEAT:
            table = _table(number, each)
            flies = (table["type"] != _GROUND_STATION) & (table["autopilot"] != _NO_AUTOPILOT)
            counts.update((system, int(kind)) for kind in table["autopilot"][flies])
    if not counts:
        return None, ""
    (system, autopilot), _ = counts.most_common(1)[0]
    return system, _AUTOPILOTS.get(autopilot, "")


def _series(messages: dict[int, _Messages]) -> tuple[dict[str, FieldSeries], int]:
    """Return the channels of a vehicle, and the number of messages that were received twice."""
    tables = {number: _table(number, each) for number, each in messages.items()}
    boot_ns = {number: found for number, table in tables.items() if (found := _boot_ns(table)) is not None}
    received_ns = {
        number: np.array(each.received_us, dtype=np.uint64).astype(np.int64) * field_values.NS_PER_US
        for number, each in messages.items()
    }
    starts = _starts(boot_ns, received_ns)
    series, doubles = {}, 0
    for number, table in tables.items():
        stamps_ns = received_ns[number]
        if number in boot_ns:
            session = np.searchsorted(starts[0], stamps_ns, side="right") - 1
            stamps_ns = boot_ns[number] + starts[1][np.maximum(session, 0)]
        order = np.arange(len(table))
        if number in boot_ns:
            _, order = np.unique(stamps_ns, return_index=True)
            doubles += len(table) - len(order)
        fields = {name: table[name][order] for name in table.dtype.names or ()}
        name = DECLARATIONS[number].name
        series[name] = FieldSeries(name, stamps_ns[order], fields)
    return series, doubles


def _boot_ns(table: NDArray[np.void]) -> NDArray[np.int64] | None:
    """Return the times since the start of the autopilot; None where a message has none."""
    names = table.dtype.names or ()
    if "time_boot_ms" in names:
        return np.asarray(table["time_boot_ms"].astype(np.int64) * 10**6)
    if "time_usec" in names and (table["time_usec"] < _FIRST_UNIX_US).all():
        return np.asarray(table["time_usec"].astype(np.int64) * field_values.NS_PER_US)
    return None


def _starts(
    boot_ns: dict[int, NDArray[np.int64]], received_ns: dict[int, NDArray[np.int64]]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return for each start of the autopilot the first reception, and the calendar time of the start.

    The time of the start is the smallest difference of reception and autopilot's time.
    """
    if not boot_ns:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    received = np.concatenate([received_ns[number] for number in boot_ns])
    boot = np.concatenate(list(boot_ns.values()))
    order = np.argsort(received, kind="stable")
    received, boot = received[order], boot[order]
    restarts = np.flatnonzero(np.diff(boot) < -_RESTART_NS) + 1
    begins = np.concatenate([[0], restarts])
    return received[begins], np.minimum.reduceat(received - boot, begins)


def _ardupilot_rules(series: dict[str, FieldSeries]) -> tuple[FieldRule, ...]:
    """Return the rules that hold for ArduPilot alone: the unit of RAW_IMU, and the order of the sticks."""
    parameters: dict[str, float] = {}
    if "PARAM_VALUE" in series:
        fields = series["PARAM_VALUE"].fields
        names = [bytes(name).decode("latin-1") for name in fields["param_id"]]
        parameters = dict(zip(names, column(fields, "param_value").tolist(), strict=True))

    def sticks(fields: Fields) -> Converted:
        raw = {k: column(fields, f"chan{k}_raw") for k in range(1, 19)}
        pulses = {k: np.where(values == _UNKNOWN_16, 0.0, values) for k, values in raw.items()}
        return stick_from_pulses(pulses, parameters), ()

    reading = "µs by the calibration of the log; right and back to left and forward"
    return (
        FieldRule("imu0", "RAW_IMU", ("xgyro", "xacc"), _MILLI, _MILLI_READING, doubt=_slow_imu),
        FieldRule("command0", "RC_CHANNELS", ("chan4_raw",), sticks, reading),
    )
