"""The clocks of gyro and attitude: of these and the pictures, the one that both others contradict is wrong.

Each of the three shows how the vehicle turned. A delay between two of them does not tell which is late; the
third one does.
"""

from __future__ import annotations

import numpy as np

from backend.clocks.picture_clock import ClockPiece, PictureClock
from slam.core.clock_steps import attitude_clock
from slam.core.flight import Flight
from slam.core.messages import note, warning
from slam.core.units import with_error


def on_one_clock(flight: Flight, pictures: PictureClock | None) -> Flight:
    """Return the flight with the gyro or the attitude restamped where the two others contradict it.

    ``pictures`` is the delay of the pictures behind the gyro, None where it is not known. What was done is a
    note of the flight; a delay between gyro and attitude that no pictures explain is a warning.
    """
    attitude = attitude_delay(flight)
    if attitude is None or not attitude.differs(0.0):
        return flight
    camera = pictures.pieces[0] if pictures is not None and len(pictures.pieces) == 1 else None
    if camera is None or not camera.known:
        return flight.with_warning(
            warning(
                f"{_said('attitude0', attitude)} imu0's readings of the same moment, and the pictures do "
                "not tell which of the two is wrong: tilts may be read at wrong times",
                "check the stamps of both",
            )
        )
    if camera.differs(0.0) and not camera.differs(attitude.delay_s, attitude.std_s):
        both = _mean(camera, attitude)
        said = note(
            f"{_said('imu0', _turned(both))} the pictures and attitude0 of the same moment, which agree: the"
            " imu's stamps are corrected in the map",
            "check the stamps in imu0/data.csv",
        )
        return flight.restamped(["imu"], lambda stamps_s: stamps_s + both.delay_s).with_warning(said)
    said = note(
        f"{_said('attitude0', attitude)} imu0's readings of the same moment: corrected in the map",
        "check the stamps in attitude0/data.csv",
    )
    return flight.restamped(["attitude"], lambda stamps_s: stamps_s - attitude.delay_s).with_warning(said)


def attitude_delay(flight: Flight) -> ClockPiece | None:
    """Return the one delay of `slam.core.clock_steps.attitude_clock`; None where it is not known well enough,
    or changes."""
    found = attitude_clock(flight)
    if found is None or len(found.pieces) > 1 or not found.pieces[0].known:
        return None
    return found.pieces[0]


def _mean(one: ClockPiece, other: ClockPiece) -> ClockPiece:
    """Return the mean of two delays, weighted by their precisions."""
    weights = np.array([one.std_s, other.std_s]) ** -2.0
    delay_s = float(weights @ [one.delay_s, other.delay_s] / weights.sum())
    return ClockPiece(one.begin_s, delay_s, float(weights.sum() ** -0.5))


def _turned(piece: ClockPiece) -> ClockPiece:
    """Return the same delay as the other clock has it."""
    return ClockPiece(piece.begin_s, -piece.delay_s, piece.std_s)


def _said(stream: str, piece: ClockPiece) -> str:
    side = "after" if piece.delay_s > 0 else "before"
    return f"{stream} is stamped {with_error(1e3 * abs(piece.delay_s), 1e3 * piece.std_s)} ms {side}"
