"""Navdata packets of Parrot's AR.Drone, one after the other as the drone sent them.

A packet has a header, options, and a checksum: the sum of all bytes before it. Axes are forward-right-down,
angles are thousandths of a degree with the pitch positive up, and speeds mm/s. The time counts from the
start of the drone: 11 bits of seconds and 21 bits of microseconds. Source: Parrot, AR.Drone Developer Guide
SDK 2.0, section 7, and its ``navdata_common.h``.
"""

from __future__ import annotations

import mmap
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.measurements import GRAVITY_M_S2
from backend.wording import counted
from slam.core.messages import warning
from slam.io.body_axes import angles_from_aviation
from slam.io.files import refusal
from slam.io.recordings.logs import field_values
from slam.io.recordings.logs.field_rules import FieldRule, FieldSeries, field_recording
from slam.io.recordings.logs.field_values import Converted, Fields, column, columns
from slam.io.recordings.recording import COPY_AGAIN, Recording

DESCRIPTION = "a recording of an AR.Drone's navdata"
MARKS = (b"\x88\x77\x66\x55", b"\x89\x77\x66\x55")
"""First bytes of a packet, of the first and the second generation."""
_MARK = re.compile(b"|".join(MARKS))
_HEADER_BYTES, _OPTION_BYTES = 16, 4
_TIME, _CHECKSUM = 1, 0xFFFF
_CHECKSUM_BYTES = 8
_SECONDS_BIT, _WRAP_US = 21, 2048 * 10**6
_MOTOR_MAX = 255.0


def _layout(*fields: tuple[str, str]) -> np.dtype[np.void]:
    return np.dtype([(name, f"<{kind}") for name, kind in fields])


_OPTIONS: dict[int, tuple[str, np.dtype[np.void]]] = {
    0: (
        "demo",
        _layout(
            *(("state", "u4"), ("battery", "u4"), ("theta", "f4"), ("phi", "f4"), ("psi", "f4")),
            *(("altitude", "i4"), ("vx", "f4"), ("vy", "f4"), ("vz", "f4")),
        ),
    ),
    2: ("raw_measures", _layout(("sensors", "V16"), ("vbat_raw", "u4"))),
    3: (
        "phys_measures",
        _layout(
            *(("accs_temp", "f4"), ("gyro_temp", "u2"), ("acc_x", "f4"), ("acc_y", "f4"), ("acc_z", "f4")),
            *(("gyro_x", "f4"), ("gyro_y", "f4"), ("gyro_z", "f4")),
        ),
    ),
    9: ("pwm", _layout(*((f"motor{k}", "u1") for k in range(1, 5)))),
    10: ("altitude", _layout(("vision", "i4"), ("vz", "f4"), ("ref", "i4"), ("raw", "i4"))),
    21: ("pressure_raw", _layout(("up", "i4"), ("ut", "i2"), ("temperature", "i4"), ("pressure", "i4"))),
}
"""Tag of an option -> its name, and the layout of the fields at its beginning."""


@dataclass
class _Rows:
    """Options of one kind, as they are read."""

    times_us: list[int] = field(default_factory=list)
    parts: list[bytes] = field(default_factory=list)


def _imu(fields: Fields) -> Converted:
    values = field_values.frd_vectors(fields, "gyro_x", "gyro_y", "gyro_z", "acc_x", "acc_y", "acc_z")
    return values * np.repeat([np.pi / 180, GRAVITY_M_S2 * 1e-3], 3), ()


def _attitude(fields: Fields) -> Converted:
    return angles_from_aviation(np.radians(columns(fields, "phi", "theta", "psi") * 1e-3)), ()


def _velocity(fields: Fields) -> Converted:
    return columns(fields, "vx", "vy") * (1e-3, -1e-3), ()


def _range(name: str) -> FieldRule:
    def values(fields: Fields) -> Converted:
        millimetres = column(fields, name)
        return np.where(millimetres > 0, millimetres * 1e-3, np.nan)[:, None], ()

    kind = "altitude" if name == "raw" else "demo"
    return FieldRule("sonar0", kind, (name,), values, "mm to m")


def _voltage(fields: Fields) -> Converted:
    return column(fields, "vbat_raw")[:, None] * 1e-3, ()


def _motors(fields: Fields) -> Converted:
    return columns(fields, *(f"motor{k}" for k in range(1, 5))) / _MOTOR_MAX, ()


def _barometer(fields: Fields) -> Converted:
    return field_values.standard_altitude(column(fields, "pressure") * 1e-2), ()


_FRD = "forward-right-down to forward-left-up"
RULES: tuple[FieldRule, ...] = (
    FieldRule("imu0", "phys_measures", ("gyro_x", "acc_x"), _imu, f"deg/s, 1e-3 g; {_FRD}"),
    _range("raw"),
    _range("altitude"),
    FieldRule("attitude0", "demo", ("theta",), _attitude, "1e-3 deg; yaw clockwise, pitch up to pitch down"),
    FieldRule("velocity0", "demo", ("vx",), _velocity, "mm/s; right to left, taken as level"),
    FieldRule("battery0", "raw_measures", ("vbat_raw",), _voltage, "mV to V"),
    FieldRule("barometer0", "pressure_raw", ("pressure",), _barometer, "Pa to m by ISO 2533"),
    FieldRule("motor0", "pwm", ("motor1",), _motors, "0..255 to 0..1"),
)
"""The options and what they become, in the order of preference."""


def open_recording(path: Path) -> Recording:
    """Open a recording of packets. Raises ``InputError`` where no packet has a time."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        rows, lost, timeless = _scanned(data)
    if not rows:
        what = "without a time in its packets" if timeless else "without a complete packet"
        do = "record with all options (general:navdata_demo FALSE)" if timeless else "copy it again"
        raise refusal(path, f"is {DESCRIPTION} {what}", do)
    series = {name: _series(name, each) for name, each in rows.items()}
    warnings = []
    if lost:
        warnings.append(
            warning(
                f"{counted(lost, 'byte holds', 'bytes hold')} no packet, damaged or cut short",
                COPY_AGAIN,
            )
        )
    if timeless:
        warnings.append(
            warning(f"{counted(timeless, 'packet has', 'packets have')} no time", "record with all options")
        )
    return field_recording(path, DESCRIPTION, series, RULES, tuple(warnings), {"vehicle": "AR.Drone"})


def _scanned(data: mmap.mmap) -> tuple[dict[str, _Rows], int, int]:
    """Return the options by name, the number of bytes passed over, and of packets without a time."""
    rows: dict[str, _Rows] = {}
    at, lost, timeless, clock = 0, 0, 0, _Clock()
    while at < len(data):
        options = _packet(data, at)
        if options is None:
            mark = _MARK.search(data, at + 1)
            following = mark.start() if mark else len(data)
            lost += following - at
            at = following
            continue
        found = {tag: body for tag, body, _ in options}
        at = options[-1][2]
        if len(found.get(_TIME, b"")) != struct.calcsize("<I"):
            timeless += 1
            continue
        time_us = clock.unwrapped(struct.unpack("<I", found[_TIME])[0])
        for tag, (name, layout) in _OPTIONS.items():
            if len(body := found.get(tag, b"")) >= layout.itemsize:
                each = rows.setdefault(name, _Rows())
                each.times_us.append(time_us)
                each.parts.append(body[: layout.itemsize])
    return rows, lost, timeless


def _packet(data: mmap.mmap, at: int) -> list[tuple[int, bytes, int]] | None:
    """Return tag, content and end of each option of the packet at a place; None if it is not complete."""
    if data[at : at + 4] not in MARKS:
        return None
    options = []
    for tag, begin, end in _options(data, at + _HEADER_BYTES):
        options.append((tag, data[begin + _OPTION_BYTES : end], end))
        if tag == _CHECKSUM:
            stored = int.from_bytes(data[begin + _OPTION_BYTES : end], "little")
            return options if sum(data[at:begin]) & 0xFFFFFFFF == stored else None
    return None


def _options(data: mmap.mmap, at: int) -> Iterator[tuple[int, int, int]]:
    """Yield tag, begin and end of the options from a place on, as far as they are complete."""
    while at + _OPTION_BYTES <= len(data):
        tag, size = struct.unpack_from("<HH", data, at)
        if size < _OPTION_BYTES or at + size > len(data):
            return
        yield tag, at, at + size
        at += size


class _Clock:
    """The drone's clock, which begins again after 2048 seconds."""

    def __init__(self) -> None:
        self._last_us, self._turns = 0, 0

    def unwrapped(self, word: int) -> int:
        """Return microseconds since the start of the drone."""
        time_us = (word >> _SECONDS_BIT) * 10**6 + (word & (1 << _SECONDS_BIT) - 1)
        # A packet that arrives late is a little earlier; a new turn is earlier by most of a turn.
        if time_us < self._last_us - _WRAP_US // 2:
            self._turns += 1
        self._last_us = time_us
        return time_us + self._turns * _WRAP_US


def _series(name: str, each: _Rows) -> FieldSeries:
    layout = next(layout for known, layout in _OPTIONS.values() if known == name)
    table = np.frombuffer(b"".join(each.parts), layout)
    stamps_ns: NDArray[np.int64] = np.array(each.times_us, dtype=np.int64) * field_values.NS_PER_US
    fields = {key: table[key] for key in layout.names or () if layout[key].kind != "V"}
    return FieldSeries(name, stamps_ns, fields)
