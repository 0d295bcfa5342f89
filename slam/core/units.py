"""Lengths, shares and uncertain values as text for a reader."""

from __future__ import annotations

import numpy as np

SPACE = "\N{NO-BREAK SPACE}"
"""Space between a figure and its unit."""
FOOT_M = 0.3048
"""Metres in a foot. Source: its definition of 1959."""


def percent(share: float) -> str:
    """Return a share as percent with up to two significant figures."""
    return f"{float(f'{100 * share:.2g}'):g}{SPACE}%"


def with_error(value: float, std: float, sign: str = "") -> str:
    """Return a value and its standard deviation, both to the digits of the latter; ``sign`` is ``+`` for a
    value with its sign."""
    digits = _digits(std)
    return f"{value:{sign}.{digits}f} ±{SPACE}{std:.{digits}f}"


def to_error(value: float, error: float) -> str:
    """Return a value to the digits that its uncertainty leaves, or the uncertainty itself to the same."""
    return f"{value:.{_digits(error)}f}"


def _digits(error: float) -> int:
    """Return the decimals to which a value with this uncertainty is told: two significant digits of it up to
    35, one above (the rule of the Particle Data Group, Review of Particle Physics, introduction, 5.3)."""
    if not (np.isfinite(error) and error > 0.0):
        return 0
    power = int(np.floor(np.log10(error)))
    return max(0, (1 if error < 3.55 * 10.0**power else 0) - power)


def spaced(of: str) -> str:
    """Return a unit after a space, to follow a figure; a factor, whose unit is 1, has none."""
    return "" if of == "1" else f" {of}"


def unit(metric: bool) -> str:
    """Return the unit of lengths: metres, or the camera's mean height where the scale is not observed."""
    return "m" if metric else "heights"


def axis_names(on_earth: bool) -> tuple[str, str]:
    """Return the names of the two axes of a top view."""
    return ("east", "north") if on_earth else ("x", "y")


def length(metres: float, metric: bool = True) -> str:
    """Return a length with three significant figures in mm, m or km; in heights if not ``metric``."""
    if not np.isfinite(metres):
        return "not known"
    if not metric:
        return f"{metres:.3g}{SPACE}{unit(metric)}"
    name, count = length_unit(metres)
    return f"{_significant(metres * count)}{SPACE}{name}"


def error_length(metres: float, metric: bool = True) -> str:
    """Return the uncertainty of a length in mm, m or km, to the digits that it has itself."""
    if not (np.isfinite(metres) and metric):
        return length(metres, metric)
    name, count = length_unit(metres)
    return f"{to_error(metres * count, metres * count)}{SPACE}{name}"


def round_length(metres: float, metric: bool = True) -> str:
    """Return a length that was chosen as a round number, ``0.5 m``, without more digits than it has."""
    return f"{metres:g}{SPACE}{unit(metric)}"


def length_unit(metres: float) -> tuple[str, float]:
    """Return the unit in which a length reads well, mm, m or km, and how many of it a metre has."""
    if abs(metres) < 0.0995:
        return "mm", 1e3
    return ("m", 1.0) if abs(metres) < 9995 else ("km", 1e-3)


def area(square_metres: float, metric: bool = True) -> str:
    """Return an area with two significant figures in square metres; in square heights if not ``metric``."""
    figure = f"{square_metres:.2g}" if square_metres < 99.5 else f"{square_metres:.0f}"
    return f"{figure}{SPACE}{unit(metric)}²"


def _significant(value: float) -> str:
    digits = 2 if value == 0 else int(np.clip(2 - np.floor(np.log10(abs(value))), 0, 2))
    return f"{value:.{digits}f}"


def sized(size: float, of: str, digits: int = 3) -> str:
    """Return a size in its everyday unit, with some significant figures but no exponent where it is large."""
    factor, name = everyday(size, of)
    value = factor * size
    return (
        f"{value:.{digits}g}{spaced(name)}" if abs(value) < 10**digits - 0.5 else f"{value:.0f}{spaced(name)}"
    )


def everyday(size: float, of: str) -> tuple[float, str]:
    """Return the factor and the unit in which a size with an SI unit reads well: degrees, percent, ms, mm."""
    if of in ("rad", "rad/s"):
        return float(np.degrees(1.0)), of.replace("rad", "deg")
    small = {"1": (1.0, 100.0, "%"), "s": (0.0995, 1e3, "ms"), "m": (0.0995, 1e3, "mm")}
    below, factor, name = small.get(of, (0.0, 1.0, of))
    return (factor, name) if abs(size) < below else (1.0, of)
