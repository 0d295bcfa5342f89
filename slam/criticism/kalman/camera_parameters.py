"""The camera's part of the filter parameters: a vector of the parameters that pictures can show.

Entries of unobservable sign are squares: exposure time, standard deviations of gain and gamma.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam.simulation.model import Model
from slam.simulation.terms import CATALOGUE

Array = NDArray[np.float64]

CAMERA = (
    "focal_length.eps", "radial_distortion.k1", "camera_tilt.x", "camera_tilt.y",
    "camera_time_offset.offset", "rolling_shutter.readout",
    "vignetting.a", "motion_blur.exposure", "exposure_variation.gain", "exposure_variation.gamma",
)  # fmt: skip
(FOCAL, RADIAL, TILT_X, TILT_Y, OFFSET, READOUT, VIGNETTING, BLUR, GAIN, GAMMA) = range(len(CAMERA))
POINTS = 6
"""Number of leading entries that move points of the picture."""
_PARAMETERS = [CATALOGUE[term].parameter(name) for term, name in (entry.split(".") for entry in CAMERA)]
SQUARES = tuple(k for k, parameter in enumerate(_PARAMETERS) if parameter.squared)
STEPS = tuple(parameter.step for parameter in _PARAMETERS)


def camera_vector(model: Model) -> Array:
    """Return the vector of a model."""
    vector = np.array([model.value(*name.split(".")) for name in CAMERA])
    vector[list(SQUARES)] **= 2
    return vector


def catalogued(entry: int, value: float) -> float:
    """Return an entry in the unit of the catalogue."""
    return float(np.sqrt(max(value, 0.0))) if entry in SQUARES else value
