"""The sense of a column ``yaw``: counter-clockwise from east as in a flight, or clockwise from north.

Loggers use the name for both. Readings of the same table tell the sense: the gyro, or how the vehicle moves
over the ground by its positions. Source of the conversion: `slam.io.body_axes`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from slam.core.geodesy import METRES_PER_DEGREE, metres_per_degree_east
from slam.core.messages import Message, note, warning
from slam.core.streams import Gps
from slam.io.files import brief
from slam.io.recordings.logs.field_values import Fields, column, columns
from slam.io.recordings.tables.columns import Column

Array = NDArray[np.float64]

_LEAST_SHARE = 0.5
"""Share of the squares that one sense explains and the other does not: more than chance leaves."""
_LEAST_STEP_M = 3 * Gps.noise_std_m[0]
"""Distance of positions that tell a course: three standard deviations of an unknown receiver."""
_ADVICE = "name it heading if it is clockwise from north, yaw_from_east if counter-clockwise from east"


@dataclass(frozen=True)
class YawSense:
    """The fields of a table whose yaw has a known sense, or the doubt about it."""

    fields: Fields
    lines: tuple[Message, ...] = ()
    """Messages that tell the sense and what tells it, or which one is taken."""
    doubt: str = ""
    """Why the yaw is not read without a request; empty for none."""


def with_sense(yaw: Column, fields: Fields) -> YawSense:
    """Return the fields with ``heading`` in place of a ``yaw`` clockwise from north.

    ``fields`` hold ``time`` in seconds and ``yaw`` in radians, each (n,). A yaw that may be that of a compass
    is doubted where nothing tells its sense: one beyond half a turn, or in degrees and never negative.
    """
    title = f"column {brief(yaw.title, 40)!r}"
    found = {by: sense for by, sense in (("the gyro", _by_gyro(fields)), _by_track(fields)) if sense}
    senses = set(found.values())
    by = " and ".join(found)
    if senses == {"clockwise"}:
        others = {name: values for name, values in fields.items() if name != "yaw"}
        said = note(f"{title} is clockwise from north by {by}", "read as heading, with pitch up")
        return YawSense({**others, "heading": fields["yaw"]}, (said,))
    if senses == {"counter-clockwise"}:
        return YawSense(fields, (note(f"{title} is counter-clockwise from east by {by}"),))
    why = "the gyro and the positions contradict each other" if senses else "no other column tells its sense"
    lowest, highest = (
        np.nanmin(column(fields, "yaw"), initial=np.inf),
        np.nanmax(column(fields, "yaw"), initial=-np.inf),
    )
    if highest > np.pi or (yaw.unit == "deg" and lowest >= 0 and highest > 0):
        what = f"{title} is {np.degrees(lowest):.0f} to {np.degrees(highest):.0f} degrees, and {why}"
        said = warning(f"attitude0 is taken on request only: {what}", _ADVICE)
        return YawSense(fields, (said,), str(warning(what, _ADVICE)))
    if yaw.unit == "rad":
        return YawSense(fields)  # as in a flight folder
    return YawSense(fields, (warning(f"{title} is taken counter-clockwise from east", why, _ADVICE),))


def _by_gyro(fields: Fields) -> str:
    """Return the sense of yaw by the gyro's z, positive about the axis that the accelerometer shows up."""
    if "gyro_z" not in fields:
        return ""
    up = np.sign(np.nanmedian(column(fields, "accel_z"))) if "accel_z" in fields else 1.0
    rate_s, rate = _known(fields, "gyro_z")
    yaw_s, yaw = _known(fields, "yaw")
    if len(rate) < 2:
        return ""
    # A slower attitude is held, or empty, in the rows between its readings.
    is_new = np.diff(yaw, prepend=np.nan) != 0
    turned = np.diff(np.unwrap(yaw[is_new]))
    angle = cumulative_trapezoid(up * rate, rate_s, initial=0)
    predicted = np.diff(np.interp(yaw_s[is_new], rate_s, angle))
    return _sense(turned, predicted, -predicted)


def _known(fields: Fields, name: str) -> tuple[Array, Array]:
    """Return times and values of the rows that have one, in the order of time."""
    rows = columns(fields, "time", name)
    rows = rows[np.isfinite(rows).all(axis=1)]
    time_s, values = rows[np.argsort(rows[:, 0], kind="stable")].T
    return time_s, values


def _by_track(fields: Fields) -> tuple[str, str]:
    """Return what tells the sense of yaw by the positions, and the sense, empty where it does not.

    That is the path of the velocity, else flight straight ahead.
    """
    if not {"latitude", "longitude"} <= fields.keys():
        return "", ""
    has_velocity = {"v_x", "v_y"} <= fields.keys()
    names = ("time", "yaw", "latitude", "longitude", *(("v_x", "v_y") if has_velocity else ()))
    rows = columns(fields, *names)
    known = np.isfinite(rows).all(axis=1) & rows[:, 2:4].any(axis=1)  # 0, 0 is no fix
    rows = rows[known]
    if len(rows) < 2:
        return "", ""
    time_s, yaw, latitude, longitude = rows[:, :4].T
    east_per_degree = metres_per_degree_east(float(np.median(latitude)))
    place = (longitude - longitude[0]) * east_per_degree + 1j * (latitude - latitude[0]) * METRES_PER_DEGREE
    turns = np.exp(1j * yaw), np.exp(1j * (np.pi / 2 - yaw))
    if has_velocity:
        ahead = rows[:, 4] + 1j * rows[:, 5]
        paths = [cumulative_trapezoid(ahead * turn, time_s, initial=0) for turn in turns]
        sense = _sense(*(path - path.mean() for path in (place, *paths)))
        return "velocity and positions", sense
    kept = _apart(place, _LEAST_STEP_M)
    step = np.diff(place[kept])
    courses = [np.add.reduceat(turn, kept)[:-1] / np.diff(kept) for turn in turns]
    # A vehicle that keeps its course may fly sideways: only turns of the course tell a sense.
    length = np.abs(step)
    straight = length * (length * step).sum() / max((length**2).sum(), _LEAST_STEP_M**2)
    sense = _sense(*(path - straight for path in (step, *(length * course for course in courses))))
    return "positions, if it flies straight ahead", sense


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
