"""The time offset between camera and instruments: estimated with the map, and taken out of a flight.

The pictures give the path, the accelerometer gives the moments at which the vehicle accelerated: the offset
is what makes both fit best (`backend.inertial_scale`). Attitude and ranges are assumed to share the clock of
gyro and accelerometer.
"""

from __future__ import annotations

from backend.inertial_scale.regression_rows import MAX_DELAY_S
from slam.core.flight import VEHICLE_CLOCK_STREAMS, Flight
from slam.mapping.inertial_scale import AccelerometerScale

_NOTABLE_S = 0.025
"""Largest offset that exposure, transfer and the jitter of cheap cameras' stamps cause on one clock."""
_SURE = 6.0
"""Standard deviations by which a delay must differ from none: its own is of white noise alone."""
_EDGE_S = 0.002
"""So near to the longest delay that is looked for it may be any longer one; the search is exact to half of
this."""
_VAGUE_S = _NOTABLE_S / 2
"""Known no better than this, a delay that matters could hide."""


def shift_instrument_stamps(flight: Flight, late_s: float) -> Flight:
    """The flight with its instruments' stamps on the clock of its pictures, ``late_s`` after theirs."""
    return flight.restamped(VEHICLE_CLOCK_STREAMS, lambda stamps_s: stamps_s + late_s)


def correctable_delay(by_inertia: AccelerometerScale | None) -> float:
    """Seconds by which the pictures are stamped late; 0 where that is too little or too vague."""
    if by_inertia is None:
        return 0.0
    delay_s, std_s = by_inertia.found.delay_s, by_inertia.found.delay_std_s
    sure = abs(delay_s) >= max(_NOTABLE_S, _SURE * std_s)
    return delay_s if sure and abs(delay_s) < MAX_DELAY_S - _EDGE_S else 0.0


def delay_warning(by_inertia: AccelerometerScale | None, taken_out_s: float) -> str:
    """In words, where pictures and accelerometer are stamped by clocks that differ, or may; else empty."""
    if by_inertia is None:
        return ""
    std_s = by_inertia.found.delay_std_s
    delay_s = by_inertia.found.delay_s + taken_out_s
    if not std_s < _VAGUE_S:
        return (
            "the time offset between camera and imu0 cannot be determined from this flight and is taken as "
            "zero; to have it found, fly with more acceleration"
        )
    if abs(delay_s) < max(_NOTABLE_S, _SURE * std_s):
        return ""
    offset = (
        f"pictures are stamped {1e3 * abs(delay_s):.0f} ± {1e3 * max(std_s, 5e-4):.0f} ms "
        f"{'after' if delay_s > 0 else 'before'} the imu's readings of the same moment"
    )
    if taken_out_s != 0.0:
        return (
            f"{offset}: corrected in the map, whose poses are stamped by the imu's clock; "
            "for other programs shift the stamps in cam0/data.csv by "
            f"{-1e3 * delay_s:+.0f} ms"
        )
    return (
        f"{offset}, or more, too much to correct: attitude and ranges are read at wrong times; shift the "
        f"stamps in cam0/data.csv by {-1e3 * delay_s:+.0f} ms and run again"
    )
