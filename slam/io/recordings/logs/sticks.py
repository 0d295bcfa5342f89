"""Stick positions from the pulses of a radio receiver, with the calibration of the vehicle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LOW_US, _MIDDLE_US, _HIGH_US = 1100.0, 1500.0, 1900.0
"""ArduPilot's defaults of RCn_MIN, RCn_TRIM and RCn_MAX."""


@dataclass(frozen=True)
class _Channel:
    low_us: float
    middle_us: float
    high_us: float
    sign: float

    def centred(self, pulse_us: Array) -> Array:
        """Return -1..1, with 0 at the trim."""
        above = (pulse_us - self.middle_us) / max(self.high_us - self.middle_us, 1.0)
        below = (pulse_us - self.middle_us) / max(self.middle_us - self.low_us, 1.0)
        return self.sign * np.clip(np.where(pulse_us >= self.middle_us, above, below), -1, 1)

    def spread(self, pulse_us: Array) -> Array:
        """Return -1..1 from the lowest pulse to the highest."""
        share = (pulse_us - self.low_us) / max(self.high_us - self.low_us, 1.0)
        return self.sign * np.clip(2 * share - 1, -1, 1)


def stick_from_pulses(pulses_us: Mapping[int, Array], parameters: Mapping[str, float]) -> Array:
    """Return the stick (n, 4): forward, left, up, yaw from pulses in microseconds, channel 1 first.

    ``parameters`` are ArduPilot's RCMAP_ROLL and so on, RCn_MIN, RCn_TRIM, RCn_MAX and RCn_REVERSED, which
    is RCn_REV = -1 in older logs. A stick to the right or to the back gives a longer pulse. Rows
    without a signal (0) are NaN.
    """

    def stick(axis: str, default: int) -> tuple[_Channel, Array]:
        number = int(parameters.get(f"RCMAP_{axis}", default))
        defaults = {"MIN": _LOW_US, "TRIM": _MIDDLE_US, "MAX": _HIGH_US, "REVERSED": 0.0, "REV": 1.0}
        low, middle, high, is_reversed, sign = (
            parameters.get(f"RC{number}_{part}", value) for part, value in defaults.items()
        )
        pulse_us = np.where(pulses_us[number] > 0, pulses_us[number], np.nan)
        return _Channel(low, middle, high, -1.0 if is_reversed or sign < 0 else 1.0), pulse_us

    (roll, roll_us), (pitch, pitch_us) = stick("ROLL", 1), stick("PITCH", 2)
    (throttle, throttle_us), (yaw, yaw_us) = stick("THROTTLE", 3), stick("YAW", 4)
    return np.column_stack(
        [-pitch.centred(pitch_us), -roll.centred(roll_us), throttle.spread(throttle_us), -yaw.centred(yaw_us)]
    )
