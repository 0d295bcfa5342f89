"""Faults 28 to 44: time, sensors and calibration of a flight folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from slam.io.flight_folder import write_flight
from tests.slam.faults.damages import Rows, column, key, later, rows, without
from tests.slam.faults.fault import Damage, Event, Fault, Sources, optimized
from tests.slam.small_flight import flown


def at_once(table: Rows) -> Rows:
    return [[table[0][0], *row[1:]] for row in table]


def copied(table: Rows) -> Rows:
    """The readings of the first half once more, at the stamps of the second."""
    half = len(table) // 2
    return [*table[:half], *([late[0], *row[1:]] for late, row in zip(table[half:], table, strict=False))]


def no_turns(table: Rows) -> Rows:
    return [[*r[:4], *"0000", *r[8:]] if k % 9 == 0 else r for k, r in enumerate(table)]


def bent(k1: float) -> Damage:
    return key("cam0", r"coefficients: \[[^]]*\]", f"coefficients: [{k1}, 0, 0, 0]")


HOUR_NS = 3600 * 10**9
LOUD = "noise_std: [1e300]"
LOOKS_UP = "data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]"


def stamped_late(_: Sources, place: Path) -> str:
    """The map of a flight whose pictures are stamped 50 ms late."""
    flight = flown(0)
    assert flight.frames is not None
    late = replace(flight, frames=replace(flight.frames, stamps_s=flight.frames.stamps_s + 0.05))
    write_flight(late, place / "flight")
    return optimized(place / "flight", place / "out")


def imu_set_forward(_: Sources, place: Path) -> str:
    """The map of a flight in which the clock of the IMU is set forward by a second."""
    flight = flown(0)
    assert flight.imu is not None
    stamps_s = flight.imu.stamps_s
    stepped = flight.restamped(["imu"], lambda s: s + (s > stamps_s[len(stamps_s) // 2]))
    write_flight(stepped, place / "flight")
    return optimized(place / "flight", place / "out")


FAULTS = (
    Fault(28, "NaN stamps", "W", "without a finite stamp", column("imu0", 0, lambda _: "nan", every=50)),
    Fault(28, "Inf stamps", "W", "without a finite stamp", column("sonar0", 0, lambda _: "inf", every=50)),
    Fault(29, "repeated rows", "W", "repeated", rows("imu0", lambda t: [*t[:5], *t])),
    Fault(30, "unsorted", "W", "out of order", rows("imu0", lambda t: t[::-1])),
    Fault(31, "clock back", "W", "jumps back by 3", rows("sonar0", later(-3 * 10**9))),
    Fault(32, "clock an hour ahead", "W", "jumps ahead by 3600", rows("sonar0", later(HOUR_NS))),
    Event(
        31, "clock set forward in flight", "W", "its clock steps by [+]1.000", imu_set_forward, is_slow=True
    ),
    Fault(29, "block copied to other times", "W", "repeat exactly", rows("imu0", copied)),
    Fault(33, "microseconds", "E", "microseconds", column("imu0", 0, lambda s: int(s) // 1000)),
    Fault(33, "seconds", "E", "seconds", column("imu0", 0, lambda s: int(s) // 10**9)),
    Event(34, "pictures stamped late", "W", "pictures are stamped 5[0-9]", stamped_late, is_slow=True),
    Fault(35, "gap", "W", "1 gap", rows("sonar0", lambda t: [*t[:20], *t[-20:]])),
    Fault(36, "no IMU", "W", "no IMU", without("imu0"), "optimize", is_slow=True),
    Fault(
        36,
        "attitude upside down",
        "W",
        "the sky",
        column("attitude0", 1, lambda _: 3.0),
        "optimize",
        is_slow=True,
    ),
    Fault(36, "no attitude", "W", "tilt is not measured", without("attitude0"), "optimize"),
    Fault(37, "no sonar", "W", "no metric scale", without("sonar0"), "optimize"),
    Fault(38, "no camera", "E", "slam estimate", without("cam0"), "optimize"),
    Fault(39, "sonar negative", "W", "zero or less", column("sonar0", 1, lambda _: -1, every=9)),
    Fault(
        39,
        "sonar stuck",
        "W",
        "reads exactly 0.7 m",
        column("sonar0", 1, lambda _: 0.7),
        source="optimize",
    ),
    Fault(
        39,
        "sonar saturated",
        "W",
        "no metric scale",
        column("sonar0", 1, lambda _: 6.0),
        "optimize",
        is_slow=True,
    ),
    Fault(39, "sonar echoes", "W", "echoes", column("sonar0", 1, lambda r: 2 * float(r or 1), every=9)),
    Fault(39, "sonar in cm", "E", "centimetres", column("sonar0", 1, lambda r: 100 * float(r or 1))),
    Fault(39, "sonar in mm", "E", "millimetres", column("sonar0", 1, lambda r: 1000 * float(r or 1))),
    Fault(39, "sonar of no use", "E", "noise_std", key("sonar0", r"noise_std: \[[^]]*\]", LOUD)),
    Fault(40, "gyro in deg/s", "E", "deg/s", column("imu0", 2, lambda w: 57.3 * float(w))),
    Fault(40, "accelerometer in g", "E", "in g", column("imu0", 6, lambda a: float(a) / 9.81)),
    Fault(40, "gravity upside down", "W", "upside down", column("imu0", 6, lambda a: -float(a))),
    Fault(41, "NaN IMU", "W", "a value is missing", column("imu0", 3, lambda _: "nan", every=10)),
    Fault(42, "all pictures at once", "E", "same stamp|stamp of another", rows("cam0", at_once), "optimize"),
    Fault(
        42,
        "equal stamps",
        "W",
        "stamp of another",
        rows("imu0", lambda t: [t[0], t[0][:1] + t[1][1:], *t[1:]]),
    ),
    Fault(43, "zero quaternions", "W", "quaternion", rows("state_groundtruth_estimate0", no_turns)),
    Fault(44, "no intrinsics", "E", "intrinsics", key("cam0", "intrinsics: [^\n]*", "")),
    Fault(
        44,
        "centre outside",
        "E",
        "centre",
        key("cam0", "intrinsics: [^\n]*", "intrinsics: [40, 40, 900, 20]"),
    ),
    Fault(44, "camera that looks up", "E", "T_BS", key("cam0", r"data: \[.*?\]", LOOKS_UP), "optimize"),
    Fault(44, "distortion that folds", "E", "fold", bent(-5.0)),
    Fault(44, "distortion short of the corner", "W", "not beyond", bent(-0.8)),
)
