"""The sense of a column ``yaw``: counter-clockwise from east as in a flight, or clockwise from north.

Loggers use the name for both. Readings of the same table tell the sense: the gyro, or how the vehicle moves
over the ground by its positions. Source of the conversion: `slam.io.body_axes`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from slam.core.flight import Gps
from slam.core.geodesy import METRES_PER_DEGREE, metres_per_degree_east
from slam.core.messages import Note
from slam.io.files import brief, refusal
from slam.io.recordings.logs.field_values import Fields, column, columns
from slam.io.recordings.tables.columns import Column

Array = NDArray[np.float64]

_LEAST_SHARE = 0.5
"""Share of the squares that one sense explains and the other does not: more than chance leaves."""
_LEAST_STEP_M = 3 * Gps.noise_std_m[0]
"""Distance of positions that tell a course: three standard deviations of an unknown receiver."""
_ADVICE = "name it heading if it is clockwise from north, yaw_from_east if counter-clockwise from east"


def with_sense(path: Path, yaw: Column, fields: Fields, line: int) -> tuple[Fields, tuple[str, ...]]:
    """Return the fields with ``heading`` in place of a ``yaw`` clockwise from north, and a line about it.

    ``fields`` hold ``time`` in seconds and ``yaw`` in radians, each (n,). Raises ``InputError`` where nothing
    tells the sense of a yaw that may be that of a compass: beyond half a turn, or in degrees and never
    negative.
    """
    title = f"column {brief(yaw.title, 40)!r}"
    told = {
        by: sense
        for by, sense in (("the gyro", _by_gyro(fields)), ("velocity and positions", _by_track(fields)))
        if sense
    }
    senses = set(told.values())
    by = " and ".join(told)
    if senses == {"clockwise"}:
        others = {name: values for name, values in fields.items() if name != "yaw"}
        note = Note(f"{title} is clockwise from north by {by}; read as heading, with pitch up")
        return {**others, "heading": fields["yaw"]}, (note,)
    if senses == {"counter-clockwise"}:
        return fields, (Note(f"{title} is counter-clockwise from east by {by}"),)
    why = "the gyro and the positions contradict each other" if senses else "no other column tells its sense"
    lowest, highest = (
        np.nanmin(column(fields, "yaw"), initial=np.inf),
        np.nanmax(column(fields, "yaw"), initial=-np.inf),
    )
    if highest > np.pi or (yaw.unit == "deg" and lowest >= 0 and highest > 0):
        what = f"{title} is {np.degrees(lowest):.0f} to {np.degrees(highest):.0f} degrees, and {why}"
        raise refusal(path, what, _ADVICE, line)
    if yaw.unit == "rad":
        return fields, ()  # as in a flight folder
    return fields, (f"{title} is taken counter-clockwise from east; {why}; {_ADVICE}",)


def _by_gyro(fields: Fields) -> str:
    """Return the sense of yaw by the gyro's z, positive about the axis that the accelerometer shows up."""
    if "gyro_z" not in fields:
        return ""
    up = np.sign(np.nanmedian(column(fields, "accel_z"))) if "accel_z" in fields else 1.0
    rows = columns(fields, "time", "yaw", "gyro_z")
    time_s, yaw, rate = rows[np.isfinite(rows).all(axis=1)].T
    if len(time_s) < 2:
        return ""
    turned = np.diff(np.unwrap(yaw))
    predicted = up * (rate[1:] + rate[:-1]) / 2 * np.diff(time_s)
    return _sense(turned, predicted, -predicted)


def _by_track(fields: Fields) -> str:
    """Return the sense of yaw by the positions: the path of the velocity, or flight straight ahead."""
    if not {"latitude", "longitude"} <= fields.keys():
        return ""
    has_velocity = {"v_x", "v_y"} <= fields.keys()
    names = ("time", "yaw", "latitude", "longitude", *(("v_x", "v_y") if has_velocity else ()))
    rows = columns(fields, *names)
    known = np.isfinite(rows).all(axis=1) & rows[:, 2:4].any(axis=1)  # 0, 0 is no fix
    rows = rows[known]
    if len(rows) < 2:
        return ""
    time_s, yaw, latitude, longitude = rows[:, :4].T
    east_per_degree = metres_per_degree_east(float(np.median(latitude)))
    place = (longitude - longitude[0]) * east_per_degree + 1j * (latitude - latitude[0]) * METRES_PER_DEGREE
    turns = np.exp(1j * yaw), np.exp(1j * (np.pi / 2 - yaw))
    if has_velocity:
        ahead = rows[:, 4] + 1j * rows[:, 5]
        paths = [cumulative_trapezoid(ahead * turn, time_s, initial=0) for turn in turns]
        return _sense(*(path - path.mean() for path in (place, *paths)))
    kept = _apart(place, _LEAST_STEP_M)
    step = np.diff(place[kept])
    courses = [np.add.reduceat(turn, kept)[:-1] / np.diff(kept) for turn in turns]
    return _sense(step, *(np.abs(step) * course for course in courses))


def _apart(place: NDArray[np.complex128], least_m: float) -> NDArray[np.int64]:
    """Return the rows of places (n,) that lie at least so far from the one before."""
    kept = [0]
    for k, each in enumerate(place):
        if abs(each - place[kept[-1]]) >= least_m:
            kept.append(k)
    return np.array(kept)


def _sense(
    measured: NDArray[np.inexact], counter: NDArray[np.inexact], clockwise: NDArray[np.inexact]
) -> str:
    """Return the sense whose prediction explains most of a measured change (n,); empty where none does."""
    power = float((np.abs(measured) ** 2).sum())
    explains = [
        power > 0 and float((np.abs(measured - each) ** 2).sum()) < _LEAST_SHARE * power
        for each in (counter, clockwise)
    ]
    if explains[0] == explains[1]:
        return ""
    return "counter-clockwise" if explains[0] else "clockwise"
