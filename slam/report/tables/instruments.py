"""Table of a flight's instruments: what they state, which were used, and the share of each in the error."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import degrees
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from slam.core.estimate import Estimate
from slam.core.figure_table import FigureTable
from slam.core.instrument import Instrument
from slam.core.messages import by_kind
from slam.core.units import SPACE, error_length, percent
from slam.report.answers.advice import WORDS
from slam.report.answers.left_out import NOT_NEEDED, LeftOut
from slam.report.answers.streams import doubts
from slam.report.heading import heading_doubt

if TYPE_CHECKING:
    from slam.core.flight import Flight
    from slam.core.streams import AttitudeSeries, Gps, Imu, Scalar, Sonar, Velocity

_TITLE = (
    "Instruments. The columns behind “doubted?” say how much of the uncertainty that is left each of them "
    "causes (in the variance, at the keyframe farthest from the start; each adds up to 100 %). The one with "
    "the largest share is the one to improve. A small share means that more accurate instruments outweigh "
    "it, or that it is more accurate than the map needs. Doubted is an instrument that a warning names, or "
    "whose heading drifts more than errors of the stated size can by chance."
)
_COLUMNS = (
    "instrument", "readings", "one reading is good to", "used?", "doubted?", "place of the ground", "lengths",
    "height over the ground", "camera's x and y", "camera's z", "camera's heading",
)  # fmt: skip
_DIRECTIONS = (("ground",), ("scale",), ("height",), ("x", "y"), ("z",), ("yaw",))
NOT_USED = f"no: {NOT_NEEDED}"
_NOTABLE = 0.005
"""Share that is rounded to 1 %: without readings, a smaller one is not listed."""


class _Stream(NamedTuple):
    """The stream behind a share."""

    field: str
    """Field of the flight that holds the readings."""
    name: str
    """Name in messages."""
    stated: Callable[[Any], str]
    """Accuracy of one reading, in words, by the series."""


def _of_range(sonar: Sonar) -> str:
    shared = [f"gain {percent(sonar.scale_std)}{_origin(sonar, 'scale_std')}"] if sonar.scale_std else []
    shared += (
        [f"zero {error_length(sonar.datum_std_m)}{_origin(sonar, 'datum_std')}"] if sonar.datum_std_m else []
    )
    common = f"; for all together {', '.join(shared)}" if shared else ""
    return f"{error_length(sonar.noise_std_m)}{_origin(sonar)}{common}"


def _origin(series: Instrument, key: str = "noise_std") -> str:
    """Return whether an accuracy is stated or assumed, in brackets."""
    return " (assumed)" if key in series.assumed else " (stated)"


def _of_position(gps: Gps) -> str:
    east, north, up = gps.noise_std_m
    return (
        f"{error_length(float(np.hypot(east, north) / np.sqrt(2)))}, height {error_length(up)}{_origin(gps)}"
    )


def _of_attitude(attitude: AttitudeSeries) -> str:
    roll, pitch, yaw = map(degrees, attitude.noise_std_rad)
    return f"{max(roll, pitch):.2g}°, heading {yaw:.2g}°{_origin(attitude)}"


def _of_velocity(velocity: Velocity) -> str:
    stated = _origin(velocity, "scale_std")
    gain = f"; for all together gain {percent(velocity.scale_std)}{stated}" if velocity.scale_std else ""
    return f"{max(velocity.noise_std_m_s):.2g}{SPACE}m/s{_origin(velocity)}{gain}"


def _of_imu(imu: Imu) -> str:
    gyro, accelerometer = f"{degrees(imu.gyro_noise_density):.2g}°/s", f"{imu.accel_noise_density:.2g}"
    return f"gyro {gyro}, accelerometer {accelerometer}{SPACE}m/s² at 1{SPACE}Hz{_origin(imu)}"


def _of_barometer(barometer: Scalar) -> str:
    return f"{error_length(barometer.noise_std)}{_origin(barometer)}" if barometer.noise_std else ""


_STREAMS: Mapping[str, _Stream] = {
    "pictures": _Stream("frames", "cam0", lambda _: ""),
    "range": _Stream("sonar", "sonar0", _of_range),
    "position": _Stream("gps", "gps0", _of_position),
    "imu": _Stream("imu", "imu0", _of_imu),
    "attitude": _Stream("attitude", "attitude0", _of_attitude),
    "velocity": _Stream("velocity", "velocity0", _of_velocity),
    "barometer": _Stream("barometer", "barometer0", _of_barometer),
}


def instrument_table(estimate: Estimate, flight: Flight | None) -> tuple[FigureTable, ...]:
    """Return the table; none without a refinement, which alone knows the shares."""
    shares = estimate.information_shares
    if flight is None or not shares:
        return ()
    names = [*_STREAMS, *(name for row in shares.values() for name in row if name not in _STREAMS)]
    rows = []
    for name in dict.fromkeys(names):
        count, stated = _readings(flight, name)
        if not count and max((row.get(name, 0.0) for row in shares.values()), default=0.0) < _NOTABLE:
            continue
        words = WORDS.get(name, name.replace("_", " "))
        is_used = _is_used(estimate, name)
        cells = _cells(shares, name) if is_used else ("",) * len(_DIRECTIONS)
        weighed = _weighed(estimate, name) if is_used and count else ""
        use_and_doubt = ("", "")
        if name in _STREAMS:
            found = _doubts(estimate, flight, name)
            use_and_doubt = (_use(estimate, name, found), _doubted(estimate, name, found))
        rows.append((words, str(count or ""), f"{stated}{weighed}", *use_and_doubt, *cells))
    return (FigureTable(_TITLE, _COLUMNS, tuple(rows)),)


def unused_instruments(estimate: Estimate, flight: Flight | None) -> tuple[LeftOut, ...]:
    """Return the instruments that the refinement did without, as others are more accurate; none without a
    refinement."""
    if flight is None or not estimate.information_shares:
        return ()
    counts = {name: _readings(flight, name)[0] for name in _STREAMS}
    return tuple(
        LeftOut(f"Readings of {WORDS[name]}", NOT_NEEDED, count, f"No: {NOT_NEEDED}.")
        for name, count in counts.items()
        if count and _use(estimate, name, _doubts(estimate, flight, name)) == NOT_USED
    )


def _is_used(estimate: Estimate, name: str) -> bool:
    return any(name in row for row in estimate.information_shares.values())


def _use(estimate: Estimate, name: str, found: list[str]) -> str:
    """Return whether the map rests on a stream, and why not; ``found`` are the doubts about it."""
    if _is_used(estimate, name):
        return "yes"
    if found or _STREAMS[name].name in estimate.status:
        return "no: it is doubted"
    return NOT_USED if estimate.metric else "no: it tells no length here"


def _readings(flight: Flight, name: str) -> tuple[int, str]:
    """Return the number of readings, and how accurate one of them is, as stated or assumed."""
    stream = _STREAMS.get(name)
    series = getattr(flight, stream.field) if stream else None
    return (0, "") if stream is None or series is None else (len(series.stamps_s), stream.stated(series))


def _weighed(estimate: Estimate, name: str) -> str:
    """Return which accuracy the map used in place of the stated one; empty where it is not known here.

    `backend.bundle.noise` estimates that of roll and pitch from their differences from the map.
    """
    inertial, found = estimate.instruments.accelerometer, estimate.instruments.attitude
    if name == "imu" and inertial is not None and inertial.used:
        return f"; lengths by it {percent(inertial.scale_std)}, of which its gain is a part"
    if name != "attitude" or found is None:
        return ""
    return (
        f"; its roll and pitch differ from the map by {degrees(found.tilt_rad):.2g}° on average, and are "
        "trusted no better than that"
    )


def _doubts(estimate: Estimate, flight: Flight, name: str) -> list[str]:
    """Return what warnings find of a stream, each up to its first colon, and the drift of the heading."""
    stream = _STREAMS[name].name
    found = [m.verdict for m in doubts(estimate.messages) if stream == m.about or stream in m.finding]
    if name == "attitude" and (drift := heading_doubt(estimate, flight)):
        found.append(drift)
    return found


def _doubted(estimate: Estimate, name: str, found: list[str]) -> str:
    """Return whether a stream is doubted, and why; a note names what the accuracy counts."""
    if found:
        return f"yes: {'; '.join(found)}"
    noted = any(m.about == _STREAMS[name].name for m in by_kind(estimate.messages).notes)
    return "no; a note above names an error, which the stated accuracy includes" if noted else "no"


def _cells(shares: Mapping[str, Mapping[str, float]], name: str) -> tuple[str, ...]:
    cells = []
    for axes in _DIRECTIONS:
        known = [shares[axis].get(name, 0.0) for axis in axes if axis in shares]
        cells.append(f"{100 * sum(known) / len(known):.0f} %" if known else "")
    return tuple(cells)
