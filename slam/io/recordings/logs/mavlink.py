"""MAVLink packets: their framing, their checksums, and the declarations of the messages that are read.

A declaration lists the fields in the order of the packet, the largest types first. The checksum of a packet
covers its bytes and a number that is computed from the declaration, so that a wrong declaration fits none.
Version 2 drops zero bytes at the end of a payload. Source: mavlink.io, "Packet Serialization".
"""

from __future__ import annotations

import binascii
import mmap
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

V1, V2 = 0xFE, 0xFD
_TYPES = {
    "uint8_t": "<u1", "int8_t": "<i1", "uint16_t": "<u2", "int16_t": "<i2", "uint32_t": "<u4",
    "int32_t": "<i4", "uint64_t": "<u8", "float": "<f4", "char": "S1",
}  # fmt: skip
_HEADER = {V1: 6, V2: 10}
"""Bytes before the payload, by the first byte."""
_CHECKSUM_BYTES, _SIGNATURE_BYTES = 2, 13
_TIME_BYTES = 8
"""Time of reception before each packet of a log."""
_SIGNED = 1
"""Bit of the flags of a packet that has a signature."""
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def checksum(data: bytes) -> int:
    """Return the CRC-16/MCRF4XX of MAVLink: CCITT's polynomial over bytes with reversed bits."""
    found = binascii.crc_hqx(data.translate(_REVERSED), 0xFFFF)
    return _REVERSED[found & 0xFF] << 8 | _REVERSED[found >> 8]


@dataclass(frozen=True)
class Declaration:
    """One type of message."""

    number: int
    name: str
    text: str
    """Types and names of the fields: ``uint32_t time_boot_ms float roll pitch``. A type holds for all names
    up to the next one; ``name[16]`` is an array."""
    extension: str = ""
    """The same of the fields that version 2 adds, as far as they are read; the checksum does not cover them.
    """

    def _fields(self, text: str) -> list[tuple[str, str, int]]:
        """Type, name and length (0 for a single value) of each field."""
        fields, kind = [], ""
        for word in text.split():
            if word in _TYPES:
                kind = word
                continue
            name, _, length = word.rstrip("]").partition("[")
            fields.append((kind, name, int(length or 0)))
        return fields

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """Layout of the payload."""
        kinds = {"char": "S{}"}
        return np.dtype(
            [
                (name, kinds.get(kind, _TYPES[kind]).format(length or 1))
                if kind == "char" or not length
                else (name, _TYPES[kind], length)
                for kind, name, length in self._fields(f"{self.text} {self.extension}")
            ]
        )

    @cached_property
    def extra(self) -> int:
        """The number in the checksum."""
        text = f"{self.name} ".encode()
        for kind, name, length in self._fields(self.text):
            text += f"{kind} {name} ".encode() + (bytes([length]) if length else b"")
        found = checksum(text)
        return (found & 0xFF) ^ (found >> 8)


_ERRORS = "errors_count1 errors_count2 errors_count3 errors_count4"
_AXES = "xacc yacc zacc xgyro ygyro zgyro xmag ymag zmag"
_RATES = "rollspeed pitchspeed yawspeed"
_CHANNELS = " ".join(f"chan{k}_raw" for k in range(1, 19))
DECLARATIONS: dict[int, Declaration] = {
    each.number: each
    for each in (
        Declaration(
            0,
            "HEARTBEAT",
            "uint32_t custom_mode uint8_t type autopilot base_mode system_status mavlink_version",
        ),
        Declaration(
            1,
            "SYS_STATUS",
            "uint32_t onboard_control_sensors_present onboard_control_sensors_enabled "
            "onboard_control_sensors_health uint16_t load voltage_battery int16_t current_battery "
            f"uint16_t drop_rate_comm errors_comm {_ERRORS} int8_t battery_remaining",
        ),
        Declaration(
            22,
            "PARAM_VALUE",
            "float param_value uint16_t param_count param_index char param_id[16] uint8_t param_type",
        ),
        Declaration(
            24,
            "GPS_RAW_INT",
            "uint64_t time_usec int32_t lat lon alt uint16_t eph epv vel cog "
            "uint8_t fix_type satellites_visible",
            "int32_t alt_ellipsoid uint32_t h_acc v_acc",
        ),
        Declaration(26, "SCALED_IMU", f"uint32_t time_boot_ms int16_t {_AXES}"),
        Declaration(27, "RAW_IMU", f"uint64_t time_usec int16_t {_AXES}"),
        Declaration(
            29, "SCALED_PRESSURE", "uint32_t time_boot_ms float press_abs press_diff int16_t temperature"
        ),
        Declaration(30, "ATTITUDE", f"uint32_t time_boot_ms float roll pitch yaw {_RATES}"),
        Declaration(31, "ATTITUDE_QUATERNION", f"uint32_t time_boot_ms float q1 q2 q3 q4 {_RATES}"),
        Declaration(65, "RC_CHANNELS", f"uint32_t time_boot_ms uint16_t {_CHANNELS} uint8_t chancount rssi"),
        Declaration(
            105,
            "HIGHRES_IMU",
            f"uint64_t time_usec float {_AXES} abs_pressure diff_pressure pressure_alt temperature "
            "uint16_t fields_updated",
        ),
        Declaration(
            106,
            "OPTICAL_FLOW_RAD",
            "uint64_t time_usec uint32_t integration_time_us float integrated_x integrated_y "
            "integrated_xgyro integrated_ygyro integrated_zgyro uint32_t time_delta_distance_us "
            "float distance int16_t temperature uint8_t sensor_id quality",
        ),
        Declaration(
            132,
            "DISTANCE_SENSOR",
            "uint32_t time_boot_ms uint16_t min_distance max_distance current_distance "
            "uint8_t type id orientation covariance",
        ),
        Declaration(173, "RANGEFINDER", "float distance voltage"),
    )
}
"""Number -> declaration, of MAVLink's ``common.xml`` and ArduPilot's ``ardupilotmega.xml``."""


@dataclass(frozen=True)
class Packet:
    """A packet whose length fits; the checksum of a declared message fits too."""

    number: int
    system: int
    payload: bytes
    length: int
    """Number of bytes of the whole packet."""


def packet_at(data: bytes | mmap.mmap, at: int) -> Packet | None:
    """Return the packet that begins at a place of ``data``; None where none does, or its checksum fails."""
    start = data[at] if at < len(data) else 0
    header = _HEADER.get(start)
    if header is None or at + header > len(data):
        return None
    size = data[at + 1]
    is_signed = start == V2 and data[at + 2] & _SIGNED
    end = at + header + size + _CHECKSUM_BYTES + (_SIGNATURE_BYTES if is_signed else 0)
    if end > len(data):
        return None
    system = data[at + (3 if start == V1 else 5)]
    number = data[at + 5] if start == V1 else int.from_bytes(data[at + 7 : at + 10], "little")
    payload = data[at + header : at + header + size]
    declared = DECLARATIONS.get(number)
    if declared is not None:
        covered = data[at + 1 : at + header + size] + bytes([declared.extra])
        stored = int.from_bytes(data[at + header + size : at + header + size + _CHECKSUM_BYTES], "little")
        if checksum(covered) != stored:
            return None
    return Packet(number, system, payload, end - at)


def telemetry(data: bytes | mmap.mmap) -> Iterator[tuple[int, Packet] | int]:
    """Yield time of reception [us since 1970] and packet, or the number of bytes that were passed over.

    In a telemetry log, each packet follows the time at which the ground station received it, in 8 bytes, the
    highest first. The checksum of an undeclared message is unknown: it counts where another packet follows.
    """
    at, lost = 0, 0
    while at + _TIME_BYTES < len(data):
        packet = packet_at(data, at + _TIME_BYTES)
        if packet is None or not _is_confirmed(data, at, packet):
            at, lost = at + 1, lost + 1
            continue
        if lost:
            yield lost
            lost = 0
        yield int.from_bytes(data[at : at + _TIME_BYTES], "big"), packet
        at += _TIME_BYTES + packet.length
    if lost + len(data) - at:
        yield lost + len(data) - at


def _is_confirmed(data: bytes | mmap.mmap, at: int, packet: Packet) -> bool:
    """Return whether the checksum of a packet fits, or the log ends or goes on with a packet behind it."""
    following = at + _TIME_BYTES + packet.length + _TIME_BYTES
    return packet.number in DECLARATIONS or following >= len(data) or data[following] in _HEADER
