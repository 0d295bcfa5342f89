"""Lengths and shares as a person reads them."""

from __future__ import annotations

import numpy as np

SPACE = "\N{NO-BREAK SPACE}"
"""Between a figure and its unit."""


def percent(share: float) -> str:
    """A share as percent with up to two significant figures."""
    return f"{100 * share:.2g}{SPACE}%"


def unit(metric: bool) -> str:
    """Of lengths: metres, or the camera's mean heights over the floor where nothing told the scale."""
    return "m" if metric else "heights"


def length(metres: float, metric: bool = True) -> str:
    """A length with three significant figures and the unit that reads best; not ``metric``: in heights."""
    if not np.isfinite(metres):
        return "not known"
    if not metric:
        return f"{metres:.3g}{SPACE}{unit(metric)}"
    if abs(metres) < 0.0995:
        return f"{_significant(metres * 1e3)}{SPACE}mm"
    if abs(metres) < 9995:
        return f"{_significant(metres)}{SPACE}m"
    return f"{_significant(metres / 1e3)}{SPACE}km"


def _significant(value: float) -> str:
    digits = 2 if value == 0 else int(np.clip(2 - np.floor(np.log10(abs(value))), 0, 2))
    return f"{value:.{digits}f}"
