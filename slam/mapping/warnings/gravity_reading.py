"""Judges whether an accelerometer that reads another gravity makes the lengths of a map wrong.

At rest, an offset b and a gain error e of the accelerometer look alike: it reads g (1 + e) + b. The map
estimates the offset and takes the gain for right up to its standard deviation. Given the reading, the gain
error to expect is

    e = (reading - g) / g * (g s_e)^2 / ((g s_e)^2 + s_b^2)

with the standard deviations s_e and s_b that the map assumes of both (the posterior mean of two Gaussian
variables whose sum is known; Bar-Shalom, Li and Kirubarajan 2001, section 1.4.14). It changes lengths by the
accelerometer by e times the sensitivity of their scale to the gain. Those of the map change by the share that
the accelerometer has in them beside other instruments. As with other errors that all measurements share
(`slam.mapping.warnings.systematic_warning`), the status names it where it exceeds what the map states.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backend.measurements import GRAVITY_M_S2
from slam.core.imu_at_rest import GravityReading, gravity_reading
from slam.core.messages import Message
from slam.core.units import percent
from slam.mapping.context import Context
from slam.mapping.map import Map

_NO_MORE = "most of it is likely an offset, which the map estimates"


@dataclass(frozen=True)
class GravityLine:
    """Meaning of a reading of gravity for a map."""

    raw: Message
    """The line about the reading alone, in whose place the judged one stands."""
    judged: Message
    """A reason for the status where more is wrong than the map states."""


def gravity_line(context: Context, map_: Map) -> GravityLine | None:
    """Return the line about a reading of gravity that is off, by its effect on the lengths of the map;
    None where it is right."""
    flight, config = context.flight, context.setup.config
    reading = None if flight.imu is None or flight.parts else gravity_reading(flight.imu)
    if reading is None:
        return None
    inertial = map_.inertial
    if inertial is None or not inertial.helps:
        read = reading.warning if reading.is_missing else reading.reads
        return GravityLine(
            reading.warning, read.extended("the lengths of the map do not rest on it").as_note()
        )
    by_accelerometer = expected_length_error(
        reading, inertial.found.gain_slopes, config.trust.accel_gain_std, config.inertial.accel_offset_m_s2
    )
    expected = inertial.share * by_accelerometer
    stated = map_.bundle.scale_std if map_.bundle is not None else None
    return judged(reading, expected, stated)


def judged(reading: GravityReading, expected: float, stated: float | None) -> GravityLine:
    """Return the line for a map whose lengths are ``expected`` to be wrong by this share, while it has
    ``stated`` their standard deviation."""
    if stated is not None and expected <= stated:
        covered = reading.reads.extended(
            f"{_NO_MORE}. Part of it may be a wrong gain, which looks alike at rest",
            f"by the usual size of both it makes lengths of the map {percent(expected)} wrong, and the "
            f"stated {percent(stated)} cover that",
        )
        return GravityLine(reading.warning, covered.as_note())
    doubted = reading.reads.extended(
        f"lengths of the map rest on it and may be {percent(expected)} wrong for this reason, more than is "
        "stated",
        "measure one distance on the ground, or calibrate the scale of the accelerometer",
    )
    return GravityLine(reading.warning, doubted.as_reason())


def expected_length_error(
    reading: GravityReading, gain_slopes: tuple[float, float, float], gain_std: float, offset_std_m_s2: float
) -> float:
    """Return the share by which lengths by the accelerometer are expected to be wrong, as the module says.

    ``gain_slopes``: d log(scale) / d log(gain) along the axes of the body.
    """
    by_gain, by_offset = (GRAVITY_M_S2 * gain_std) ** 2, offset_std_m_s2**2
    gain_error = reading.off_m_s2 / GRAVITY_M_S2 * by_gain / (by_gain + by_offset)
    # An axis takes part in the reading by the square of its share in the direction of gravity.
    return abs(gain_error * float(np.dot(gain_slopes, reading.b_up**2)))
