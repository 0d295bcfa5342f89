"""Gyro and accelerometer of GoPro's cameras, whose order and signs of axes differ from model to model.

The camera's axes are X to its left, Y to its back and Z to its top. (Y and X are those of a HERO5 whose
accelerometer agrees with the velocity of the Karma drone that carries it; Z those of gravity.) ``ORIN`` names
the axis of each channel, a small letter for the opposite direction. Cameras before it wrote the order into
the name of the series, or the makers' documents state it. Source: GoPro, gpmf-parser, "GPMF introduction"
(README.md).
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

KEYS = ("GYRO", "ACCL")
_OF_MODELS = {"hero5": "ZXY", "hero6": "YxZ", "fusion": "yXZ"}
"""Part of the camera's name -> order of its axes, where the file does not state it."""
_IN_NAME = re.compile(r"\(([xyz]),\s*([xyz]),\s*([xyz])\)", re.IGNORECASE)
_HERO5_NAME = "up/down, right/left, forward/back"
_BODY_AXES = "ZXY"
"""Axes of the camera that are forward, left and up of a body on which it looks straight down, the nose at the
top of the picture."""
GRAVITY_MARGIN = 0.5
"""Share of the readings' size that their mean must have to show the direction of gravity."""


def axes_of(texts: Mapping[str, str], model: str) -> str:
    """Return the axis of each channel as ``ORIN`` does, such as "XzY"; empty where it is not known.

    ``texts`` are the attributes of the series, ``model`` is the camera's name.
    """
    if stated := texts.get("ORIN"):
        found = stated
    elif named := _IN_NAME.search(texts.get("STNM", "")):
        found = "".join(named.groups()).upper()
    elif _HERO5_NAME in texts.get("STNM", ""):
        found = "ZXY"
    else:
        found = next((axes for name, axes in _OF_MODELS.items() if name in model.lower()), "")
    return found if _is_right_handed(found) else ""


def in_body_axes(values: Array, axes: str) -> Array:
    """Return readings (n, 3) in forward, left and up of a body on which the camera looks straight down."""
    order = [axes.upper().index(letter) for letter in _BODY_AXES]
    signs = [1.0 if axes[k].isupper() else -1.0 for k in order]
    return np.asarray(values[:, order] * signs)


def joined(gyro_s: Array, gyro: Array, accel_s: Array, accel: Array) -> tuple[Array, Array]:
    """Return the times (m,) of the gyro at which the accelerometer is known, and both readings (m, 6)."""
    accel_s, first = np.unique(accel_s, return_index=True)
    if len(accel_s) < 2:
        return np.empty(0), np.empty((0, 6))
    within = (gyro_s >= accel_s[0]) & (gyro_s <= accel_s[-1])
    at_s = gyro_s[within]
    between = [np.interp(at_s, accel_s, column) for column in accel[first].T]
    return at_s, np.column_stack([gyro[within], *between])


def up_in_body(accel: Array) -> Array | None:
    """Return the mean direction (3,) of up by an accelerometer's readings (n, 3), or None without one."""
    if not len(accel):
        return None
    mean = accel.mean(axis=0)
    size = float(np.linalg.norm(mean))
    usual = float(np.linalg.norm(accel, axis=1).mean())
    return np.asarray(mean / size) if size > GRAVITY_MARGIN * max(usual, 1e-9) else None


def _is_right_handed(axes: str) -> bool:
    """Return whether the axes of a series are those of an instrument: all three, in a right-handed order."""
    if sorted(axes.upper()) != ["X", "Y", "Z"]:
        return False
    matrix = np.zeros((3, 3))
    for channel, letter in enumerate(axes):
        matrix["XYZ".index(letter.upper()), channel] = 1.0 if letter.isupper() else -1.0
    return bool(np.linalg.det(matrix) > 0)
