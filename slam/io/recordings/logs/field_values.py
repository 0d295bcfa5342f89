"""Conversions of the fields of a log into the units and axes of a flight."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from backend.wording import counted, either
from slam.core.messages import Message, note
from slam.io.body_axes import body_from_frd

Array = NDArray[np.float64]
Fields = Mapping[str, NDArray[np.generic]]
"""Name of a field -> its values (n,)."""
Converted = tuple[Array, tuple[Message, ...]]
"""Values (n, c) in the columns of the flight format, and notes."""

NS_PER_US = 1000
FIX_2D, FIX_3D = 2, 3
"""Kinds of a satellite fix, as autopilots and GoPro's cameras number them."""
_SEA_LEVEL_HPA, _SCALE_M, _EXPONENT = 1013.25, 44330.77, 0.190263
"""International Standard Atmosphere, ISO 2533: altitude over pressure."""
DOWN = 25
"""Orientation of a range sensor that looks down (MAVLink's ROTATION_PITCH_270)."""


def column(fields: Fields, name: str) -> Array:
    """Return one field as float64 (n,)."""
    return np.asarray(fields[name], float)


def columns(fields: Fields, *names: str) -> Array:
    """Return fields as float64 (n, c)."""
    return np.column_stack([column(fields, name) for name in names])


def frd_vectors(fields: Fields, *names: str) -> Array:
    """Return fields (n, 3 k), vectors in forward-right-down axes, in forward-left-up axes."""
    values = columns(fields, *names)
    return np.hstack([body_from_frd(values[:, k : k + 3]) for k in range(0, len(names), 3)])


def single(name: str) -> Callable[[Fields], Converted]:
    """Return the conversion of one field that is taken as it is."""
    return lambda fields: (column(fields, name)[:, None], ())


def standard_altitude(pressure_hpa: Array) -> Array:
    """Return altitudes (n, 1) in the standard atmosphere of pressures (n,); NaN for none."""
    ratio = np.maximum(pressure_hpa, 0) / _SEA_LEVEL_HPA
    return np.where(ratio > 0, _SCALE_M * (1 - ratio**_EXPONENT), np.nan)[:, None]


def known_fixes(values: Array, fix: Array) -> Array:
    """Return positions (n, 3) with NaN where the kind of fix (n,) does not determine them."""
    known = values.copy()
    known[fix < FIX_2D] = np.nan
    known[fix < FIX_3D, 2] = np.nan
    return known


def only_down(range_m: Array, is_down: NDArray[np.bool_], is_valid: NDArray[np.bool_]) -> Converted:
    """Return ranges (n, 1) of sensors that look down; NaN for others and for invalid readings."""
    aside = int((~is_down).sum())
    left_out = f"{either(aside, 'is', 'are')} left out"
    notes = (note(f"{counted(aside, 'reading')} of sensors that do not look down {left_out}"),)
    return np.where(is_down & is_valid, range_m, np.nan)[:, None], notes * bool(aside)


def flow_velocity(flow_rad_s: Array, range_m: Array, is_valid: NDArray[np.bool_]) -> Converted:
    """Return velocities (n, 2), forward and left, from flow (n, 2) without turns, and range (n,).

    The flow is positive where it looks like a right-handed turn of the sensor about the body's x and y in
    forward-right-down axes. In such a turn, the point that the sensor sees moves to the left over the ground
    about x, and forward about y.
    """
    rate = flow_rad_s * range_m[:, None]
    values = np.column_stack([rate[:, 1], rate[:, 0]])
    values[~is_valid | ~np.isfinite(values).all(axis=1)] = np.nan
    return values, (note("from flow times distance", "body axes taken as level"),)
