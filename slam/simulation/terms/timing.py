"""Terms of the clocks.

The vehicle's clock stamps imu, attitude, velocity, sonar and battery; the recorder's stamps command and
pictures.
"""

from __future__ import annotations

from slam.simulation.terms.term import Term, signed, size

TIMING = (
    Term(
        "clock_drift",
        "timing",
        "clock",
        (signed("ppm", "ppm", 500.0, 50_000.0),),
        "a reading of the vehicle taken at t is stamped t (1 + ppm 1e-6)",
        ("camera_time_offset",),
        "a flight of five minutes and more, with brisk tilts",
    ),
    Term(
        "timestamp_jitter",
        "timing",
        "clock",
        (size("sigma", "s", 0.001, 0.01, 0.1),),
        "each stamp of the vehicle's readings is off by a normal deviate",
        ("dropped_frames",),
        "brisk tilts",
    ),
)
