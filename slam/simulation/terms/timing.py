"""Terms of the clocks.

The vehicle's clock stamps imu, attitude, velocity, sonar and battery; the recorder's stamps command and
pictures.
"""

from __future__ import annotations

from slam.core.flight import Flight
from slam.core.streams import VEHICLE_CLOCK_STREAMS
from slam.simulation.terms.term import FAST_TILTS, Array, Term, signed, size


def _without_drift(flight: Flight, values: Array, std: float | None) -> Flight:
    """Undo the drift of the vehicle's clock, in ppm since second 0."""
    rate = 1.0 + 1e-6 * values[0]
    return flight.restamped(VEHICLE_CLOCK_STREAMS, lambda stamps_s: stamps_s / rate)


TIMING = (
    Term(
        name="clock_drift",
        title="a clock at a wrong rate",
        meaning="the vehicle's clock runs at another rate than the recorder's",
        family="timing",
        acts_on="clock",
        instrument="clock of the log",
        parameters=(signed("ppm", "ppm", 500.0, 50_000.0, step=20.0, quantity="error of the rate"),),
        equation="a reading of the vehicle taken at t is stamped t (1 + ppm 1e-6)",
        confounders=("camera_time_offset",),
        excitation="a flight of five minutes or more, with fast tilts",
        undo=_without_drift,
    ),
    Term(
        name="timestamp_jitter",
        title="scattered time stamps",
        meaning="the times of single readings scatter",
        family="timing",
        acts_on="clock",
        instrument="clock of the log",
        parameters=(size("sigma", "s", 0.001, 0.01, 0.1, quantity="scatter of the stamps"),),
        equation="each stamp of the vehicle's readings has a normally distributed error",
        confounders=("dropped_frames",),
        excitation=FAST_TILTS,
        in_single_readings=True,
    ),
)
