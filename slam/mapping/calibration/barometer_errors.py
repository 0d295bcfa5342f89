"""Errors of the barometer as the refinement estimates them, and the warning about another unit."""

from __future__ import annotations

import numpy as np

from backend.bundle.barometer import GAIN, HEIGHTS, read_and_mapped
from backend.bundle.noise import autocorrelated_std
from backend.bundle.refinement import Bundle
from backend.sparse_cholesky import SingularMatrixError
from slam.core.instrument_errors import BarometerErrors
from slam.core.messages import Note

_LEAST_HEIGHTS = 15
_MOST_GAIN, _SURE = 1.5, 4.0
"""Ratio of changes of height that no air temperature makes, and standard deviations from which on it is no
chance."""


def barometer_errors(bundle: Bundle | None) -> BarometerErrors | None:
    """Return the errors; None where the refinement does not use the barometer."""
    if bundle is None or not bundle.uses_barometer:
        return None
    try:
        std = bundle.optimum.standard_deviations(HEIGHTS)
    except SingularMatrixError:
        return None
    return BarometerErrors(
        gain=float(bundle.optimum.values.atVector(HEIGHTS)[GAIN]),
        gain_std=float(std[GAIN]),
        noise_m=bundle.noise.height_m,
    )


def barometer_warning(bundle: Bundle | None) -> str:
    """Return a line about heights that change by another factor than the map's; empty where none do.

    The refinement takes such heights as noisy ones. The factor follows by least squares.
    """
    if bundle is None or not bundle.uses_barometer:
        return ""
    heights = bundle.optimum.problem.measurements.heights
    if len(heights) < _LEAST_HEIGHTS:
        return ""
    read, z = (values - values.mean() for values in read_and_mapped(heights, bundle.w_T_b))
    squares = float(z @ z)
    gain = float(read @ z) / max(squares, 1e-12)
    std = autocorrelated_std((read - gain * z)[:, None]) / np.sqrt(max(squares, 1e-12))
    if 1 / _MOST_GAIN < gain < _MOST_GAIN or abs(gain - 1) < _SURE * std:
        return ""
    return Note(
        f"barometer0: its heights change {gain:.2g} ± {std:.1g} times as much as those of the map, which "
        "takes this as noise; check its unit (m)"
    )
