"""Plain names of effects, quantities, readings and constants, and sizes in everyday units."""

from __future__ import annotations

import re
from collections.abc import Sequence

from slam.core.units import everyday, spaced
from slam.simulation.terms import CATALOGUE

_MOST_IN_FIGURES = 999.5
"""Larger values with three significant figures would have an exponent."""
_NAMES = re.compile(rf"(?<![\w.(])({'|'.join(sorted(CATALOGUE, key=len, reverse=True))})(\.\w+)?(?![\w])")

_READINGS = {
    "velocity": "speed",
    "velocity_x": "speed ahead",
    "velocity_y": "speed to the left",
    "range": "height reading",
    "gyro_x": "gyro about the axis ahead",
    "gyro_y": "gyro about the axis to the left",
    "gyro_z": "gyro about the axis up",
    "accel_x": "acceleration ahead",
    "accel_y": "acceleration to the left",
    "accel_z": "acceleration up",
    "attitude.roll": "roll (right side down)",
    "attitude.pitch": "pitch (nose down)",
    "attitude.yaw": "heading",
    "velocity late": "speed late",
    "velocity.v_x": "speed ahead",
    "velocity.v_y": "speed to the left",
    "sonar.range": "height reading",
}
"""Names of readings that are no plain words."""
_CONSTANTS = {
    "vehicle.gain": "tilt per stick over the model's",
    "vehicle.drag_1_s": "drag over the speed",
    "vehicle.attitude_time_s": "time in which the tilt follows",
    "sonar.datum_m": "zero of the height sensor",
    "tilt_std_rad": "tilt that nobody commands",
    "tilt_time_s": "how long such a tilt lasts",
    "yaw_rate_std_rad_s": "turning that nobody commands",
    "yaw_rate_time_s": "how long such turning lasts",
    "velocity_std_m_s": "speed that nobody commands",
    "velocity_time_s": "how long such a speed lasts",
    "velocity_up_std_m_s": "climb rate that nobody commands",
    "gyro_noise": "noise of the gyro over the stated one",
    "accel_noise": "noise of the accelerometer over the stated one",
    "attitude_noise": "noise of the attitude over the stated one",
    "velocity_noise": "noise of the speed over the stated one",
    "sonar_noise": "noise of the height sensor over the stated one",
}
"""Constants of a vehicle that are fitted together with the causes -> in words."""
_IN_CODE = [re.escape(name) for name in (*_READINGS, *_CONSTANTS) if re.search("[_. ]", name)]
_CODED = re.compile(rf"(?<![\w.])({'|'.join(_IN_CODE)})(?![\w])")


def reading(name: str) -> str:
    """Return a reading of a sensor in words."""
    return _READINGS.get(name, name.replace("_", " "))


def constant(name: str) -> str:
    """Return a constant of the vehicle in words."""
    return _CONSTANTS.get(name, name)


def in_plain_names(text: str) -> str:
    """Return a text with the names of readings and constants that are no plain words in words."""
    return _CODED.sub(lambda found: _READINGS.get(found[0]) or _CONSTANTS[found[0]], text)


def title_of(name: str) -> str:
    """Return the plain name of an effect without an article, or another name in words."""
    if name not in CATALOGUE:
        return name.replace("_", " ")
    return re.sub("^(a|an) ", "", CATALOGUE[name].title)


def quantity(effect: str, parameter: str) -> str:
    """Return the plain name of a parameter of an effect, beside the effect's own name."""
    return next((p.quantity for p in CATALOGUE[effect].parameters if p.name == parameter), parameter)


def with_titles(lines: Sequence[str]) -> list[str]:
    """Return lines with effects, and the parameters behind them, by their plain names."""

    def plain(found: re.Match[str]) -> str:
        title, parameter = CATALOGUE[found[1]].title, (found[2] or "").removeprefix(".")
        return f"{title} ({quantity(found[1], parameter)})" if parameter else title

    return [_NAMES.sub(plain, line) for line in lines]


def figure(value: float) -> str:
    """Return a value with three significant figures, and without an exponent where it is large."""
    return f"{value:.3g}" if abs(value) < _MOST_IN_FIGURES else f"{value:.0f}"


def sized_between(low: float, high: float, unit: str) -> str:
    """Return an interval with its everyday unit, which is that of the end farther from zero."""
    factor, name = everyday(max(low, high, key=abs), unit)
    return f"{figure(factor * low)} to {figure(factor * high)}{spaced(name)}"
