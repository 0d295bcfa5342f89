"""Terms of the clocks.

The vehicle's clock stamps imu, attitude, velocity, sonar and battery; the recorder's stamps command and
pictures.
"""

from __future__ import annotations

from slam.simulation.terms.term import Term, signed, size

TIMING = (
    Term(
        name="clock_drift",
        family="timing",
        acts_on="clock",
        parameters=(signed("ppm", "ppm", 500.0, 50_000.0),),
        equation="a reading of the vehicle taken at t is stamped t (1 + ppm 1e-6)",
        confounders=("camera_time_offset",),
        excitation="a flight of five minutes or more, with fast tilts",
    ),
    Term(
        name="timestamp_jitter",
        family="timing",
        acts_on="clock",
        parameters=(size("sigma", "s", 0.001, 0.01, 0.1),),
        equation="each stamp of the vehicle's readings has a normally distributed error",
        confounders=("dropped_frames",),
        excitation="fast tilts",
    ),
)
