"""ArduPilot's dataflash logs (``.bin``); the log declares its own messages.

A log is a sequence of messages: two marks, a type, and fields. Messages of type ``FMT`` declare the length,
name, field codes and field names of every type. ArduPilot's body axes are forward-right-down, its angles are
degrees with yaw clockwise from north, and its stamps are microseconds (milliseconds before ArduPilot 3.3)
since the start of the autopilot.
Sources: ArduPilot's libraries/AP_Logger/LogStructure.h and README.md, and its log message documentation.
"""

from __future__ import annotations

import mmap
from array import array
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.wording import counted, either
from slam.core.messages import note, warning
from slam.io.body_axes import angles_from_aviation
from slam.io.csv_stream import MAX_STAMP_NS
from slam.io.files import refusal
from slam.io.gps_accuracy import with_accuracy
from slam.io.recordings.logs import field_values
from slam.io.recordings.logs.completed import ACCURACY, completed, range_entries
from slam.io.recordings.logs.field_rules import FieldRule, FieldSeries, above_sea_level, field_recording
from slam.io.recordings.logs.field_values import Converted, Fields, column, columns
from slam.io.recordings.logs.sticks import stick_from_pulses
from slam.io.recordings.recording import COPY_AGAIN, Recording

DESCRIPTION = "an ArduPilot log"
MARKS = b"\xa3\x95"
_FMT = 128
_US_PER_MS = 1000
_CENTIVOLT = 0.01
_TAKEN_AS_DOWN = note("the log does not state where the sensor looks: taken as facing down")
_INSTANCES = ("I", "Instance", "Inst")
"""Names of the field that distinguishes several sensors of one kind."""
_CODES: dict[str, tuple[str, float]] = {
    "a": ("64u1", 1), "b": ("i1", 1), "B": ("u1", 1), "h": ("<i2", 1), "H": ("<u2", 1), "i": ("<i4", 1),
    "I": ("<u4", 1), "f": ("<f4", 1), "d": ("<f8", 1), "n": ("S4", 1), "N": ("S16", 1), "Z": ("S64", 1),
    "c": ("<i2", 0.01), "C": ("<u2", 0.01), "e": ("<i4", 0.01), "E": ("<u4", 0.01), "L": ("<i4", 1e-7),
    "M": ("u1", 1), "q": ("<i8", 1), "Q": ("<u8", 1), "g": ("<f2", 1),
}  # fmt: skip
"""Code of a field -> its type in the file, and the factor to the value in its unit."""


@dataclass(frozen=True)
class _Message:
    """The declaration of one type of message."""

    name: str
    length: int
    dtype: np.dtype[np.void]
    factors: dict[str, float]


def _declared(body: bytes) -> tuple[int, _Message] | None:
    """Return number and declaration of a ``FMT`` message; None where it contradicts itself."""
    number, length = body[0], body[1]
    texts = (body[2:6], body[6:22], body[22:86])
    name, codes, labels = (text.split(b"\0")[0].decode("latin-1") for text in texts)
    names = labels.split(",") if labels else []
    if len(names) != len(codes) or len(set(names)) != len(names) or any(code not in _CODES for code in codes):
        return None
    if "" in names:  # numpy would give that field another name
        return None
    dtype = np.dtype([("marks", "V3"), *((n, _CODES[c][0]) for n, c in zip(names, codes, strict=True))])
    if dtype.itemsize != length:
        return None
    return number, _Message(name, length, dtype, {n: _CODES[c][1] for n, c in zip(names, codes, strict=True)})


def _scanned(data: mmap.mmap) -> tuple[dict[int, _Message], dict[int, array[int]], int]:
    """Return declarations, the places of the messages of each type, and the number of bytes passed over."""
    messages: dict[int, _Message] = {}
    places: dict[int, array[int]] = {}
    lengths = {_FMT: 89}
    at, lost, end = 0, 0, len(data)
    while at + 3 <= end:
        length = lengths.get(data[at + 2]) if data[at : at + 2] == MARKS else None
        if length is None or at + length > end:
            following = data.find(MARKS, at + 1)
            following = end if following < 0 else following
            lost += following - at
            at = following
            continue
        number = data[at + 2]
        if number == _FMT and (found := _declared(data[at + 3 : at + length])) is not None:
            messages[found[0]], lengths[found[0]] = found[1], found[1].length
        places.setdefault(number, array("q")).append(at)
        at += length
    return messages, places, lost


def _fields(data: mmap.mmap, message: _Message, places: array[int]) -> dict[str, NDArray[np.generic]]:
    """Return all fields of the messages of one type in their units."""
    raw = np.frombuffer(data, np.uint8)
    rows = raw[np.array(places)[:, None] + np.arange(message.length)]
    table = np.ascontiguousarray(rows).view(message.dtype)[:, 0]
    fields = {n: table[n] if f == 1 else table[n] * f for n, f in message.factors.items()}
    stamp_ms = _stamp_ms(message)
    if stamp_ms:
        return fields | {"TimeUS": fields[stamp_ms].astype(np.int64) * _US_PER_MS}
    return {"TimeUS": np.zeros(len(places), np.int64)} | fields


def _stamp_ms(message: _Message) -> str:
    """Return the field with the stamp in milliseconds of older logs; empty for a message with another one.

    ``TimeMS`` of an older ``GPS`` is that of the week, and ``T`` is the stamp.
    """
    names = message.factors
    if "TimeUS" in names or "TimeMS" not in names:
        return ""
    return "T" if "T" in names and "Week" in names else "TimeMS"


def _series(data: mmap.mmap, message: _Message, places: array[int]) -> dict[str, FieldSeries]:
    """Return the channels of one type; several sensors of one kind are ``IMU[0]``, ``IMU[1]`` and so on.

    Messages whose stamp is beyond any clock are damaged; `open_recording` counts them.
    """
    fields = _fields(data, message, places)
    damaged = fields["TimeUS"].astype(float) > MAX_STAMP_NS / field_values.NS_PER_US
    fields = {name: values[~damaged] for name, values in fields.items()}
    stamps_ns = fields["TimeUS"].astype(np.int64) * field_values.NS_PER_US
    instance = next((fields[name] for name in _INSTANCES if name in fields), None)
    if instance is None:
        return {message.name: FieldSeries(message.name, stamps_ns, fields)}
    series = {}
    for k in np.unique(instance):
        rows = instance == k
        chosen = {name: values[rows] for name, values in fields.items()}
        series[f"{message.name}[{k}]"] = FieldSeries(message.name, stamps_ns[rows], chosen)
    return series


_IMU_FIELDS = ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ")


def _imu(fields: Fields) -> Converted:
    return field_values.frd_vectors(fields, *_IMU_FIELDS), ()


def _attitude(fields: Fields) -> Converted:
    return angles_from_aviation(np.radians(columns(fields, "Roll", "Pitch", "Yaw"))), ()


def _gps(fields: Fields) -> Converted:
    known = field_values.known_fixes(columns(fields, "Lat", "Lng", "Alt"), column(fields, "Status"))
    if any(name not in fields for name in ACCURACY):
        return known, ()
    return with_accuracy(known, columns(fields, "HAcc", "HAcc", "VAcc")), ()


def _range(fields: Fields) -> Converted:
    return field_values.only_down(
        column(fields, "Dist"), column(fields, "Orient") == field_values.DOWN, column(fields, "Stat") == _GOOD
    )


def _older_range(fields: Fields) -> Converted:
    """Return the ranges of logs before ``Dist``."""
    range_m = column(fields, "Dist1")
    if "Orient1" not in fields:  # the oldest logs do not state where the sensor looks
        return np.where(range_m > 0, range_m, np.nan)[:, None], (_TAKEN_AS_DOWN,)
    return field_values.only_down(range_m, column(fields, "Orient1") == field_values.DOWN, range_m > 0)


def _voltage(fields: Fields) -> Converted:
    """Return the voltage; before ArduPilot 3.3 it is an integer, in hundredths of a volt."""
    volt = column(fields, "Volt")[:, None]
    return (volt * _CENTIVOLT if fields["Volt"].dtype.kind in "iu" else volt), ()


_GOOD = 4
"""``RFND.Stat`` of a reading in range (RangeFinder::Status)."""
_FRD = "forward-right-down to forward-left-up"
_ANGLES = "deg; yaw from north to east, pitch up to pitch down"
RULES: tuple[FieldRule, ...] = (
    FieldRule("imu0", "IMU", _IMU_FIELDS, _imu, f"rad/s, m/s²; {_FRD}"),
    FieldRule("sonar0", "RFND", ("Dist", "Stat", "Orient"), _range, "m, facing down", range_entries),
    FieldRule("sonar0", "RFND", ("Dist1",), _older_range, "m, facing down", range_entries),
    FieldRule("attitude0", "ATT", ("Roll", "Pitch", "Yaw"), _attitude, _ANGLES),
    FieldRule(
        "gps0", "GPS", ("Lat", "Lng", "Alt", "Status"), _gps, "deg, m above sea level", above_sea_level
    ),
    FieldRule("battery0", "BAT", ("Volt",), _voltage, "V"),
    FieldRule("battery0", "CURR", ("Volt",), _voltage, "V"),
    FieldRule("barometer0", "BARO", ("Alt",), field_values.single("Alt"), "m"),
)
"""The messages of ArduPilot and what they become, in the order of preference."""


_OF_USE = frozenset(rule.kind for rule in RULES) | {"RCIN", "OF", "PARM", "MSG", "GPA"}
"""Types whose fields are read; of the others only the number of messages is known."""
_TIMELESS = frozenset(("PARM", "MSG"))
"""Types that older logs do not stamp, and whose time does not matter."""


def open_recording(path: Path) -> Recording:
    """Open a dataflash log. Raises ``InputError`` where it declares no message."""
    series: dict[str, FieldSeries] = {}
    counts: dict[str, int] = {}
    late = 0
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        messages, places, lost = _scanned(data)
        for number, message in messages.items():
            counts[message.name] = 0 if number == _FMT else len(places.get(number, ()))
            is_stamped = "TimeUS" in message.factors or bool(_stamp_ms(message)) or message.name in _TIMELESS
            if message.name in _OF_USE and is_stamped and counts[message.name]:
                found = _series(data, message, places[number])
                late += counts[message.name] - sum(len(each.stamps_ns) for each in found.values())
                series |= found
    if not any(counts.values()):
        raise refusal(path, f"is {DESCRIPTION} without a message", "copy it again from the autopilot")
    parameters = _parameters(series)
    series = completed(series, parameters)
    rules = (*RULES, _stick_rule(parameters), *_flow_rules(series))
    used = {each.kind for each in series.values()}
    unread = [(name, name, count) for name, count in sorted(counts.items()) if count and name not in used]
    damage = (
        *[
            warning(
                f"{counted(lost, 'byte')} of the log {either(lost, 'holds', 'hold')} no message, damaged "
                "or cut short",
                COPY_AGAIN,
            )
        ]
        * bool(lost),
        *[warning(f"{counted(late, 'message has', 'messages have')} a stamp that no clock has", COPY_AGAIN)]
        * bool(late),
    )
    return field_recording(path, DESCRIPTION, series, rules, damage, _metadata(series), unread)


def _parameters(series: dict[str, FieldSeries]) -> dict[str, float]:
    if "PARM" not in series:
        return {}
    fields = series["PARM"].fields
    names = [bytes(name).decode("latin-1") for name in fields["Name"]]
    return dict(zip(names, column(fields, "Value").tolist(), strict=True))


def _stick_rule(parameters: dict[str, float]) -> FieldRule:
    def sticks(fields: Fields) -> Converted:
        pulses = {k: column(fields, f"C{k}") for k in range(1, 15) if f"C{k}" in fields}
        return stick_from_pulses(pulses, parameters), ()

    reading = "µs by the calibration of the log; right and back to left and forward"
    return FieldRule("command0", "RCIN", ("C1", "C2", "C3", "C4"), sticks, reading)


def _flow_rules(series: dict[str, FieldSeries]) -> tuple[FieldRule, ...]:
    """Return the rule for optical flow, which needs the range of another message; none without it."""
    for rule in RULES:
        for ranges in series.values():
            if rule.kind == ranges.kind == "RFND" and all(name in ranges.fields for name in rule.needs):
                range_m = rule.values(ranges.fields)[0][:, 0]
                known = np.isfinite(range_m)
                if known.any():
                    return (_flow_rule(ranges.stamps_ns[known], range_m[known]),)
    return ()


def _flow_rule(range_stamps_ns: NDArray[np.int64], range_m: NDArray[np.float64]) -> FieldRule:
    def flow(fields: Fields) -> Converted:
        stamps_ns = fields["TimeUS"].astype(np.int64) * field_values.NS_PER_US
        at_flow_m = np.interp(stamps_ns, range_stamps_ns, range_m, np.nan, np.nan)
        turn_free = columns(fields, "flowX", "flowY") - columns(fields, "bodyX", "bodyY")
        return field_values.flow_velocity(turn_free, at_flow_m, column(fields, "Qual") > 0)

    needs = ("flowX", "flowY", "bodyX", "bodyY", "Qual")
    return FieldRule("velocity0", "OF", needs, flow, "rad/s times the range of RFND, to m/s forward and left")


def _metadata(series: dict[str, FieldSeries]) -> dict[str, str]:
    texts = series["MSG"].fields["Message"] if "MSG" in series else ()
    first = next((bytes(text).decode("latin-1").strip() for text in texts), "")
    return {"vehicle": first} if first else {}
