"""Errors of the barometer as the refinement estimates them, and the warning about another unit."""

from __future__ import annotations

import numpy as np

from backend.bundle.barometer import GAIN, HEIGHTS, height_gain, read_and_mapped
from backend.bundle.refinement import Bundle
from backend.bundle.residual_spread import autocorrelated_std
from backend.significance import SIGMAS_OF_SEVERAL
from backend.sparse_cholesky import SingularMatrixError
from slam.core.instrument_errors import BarometerErrors
from slam.core.messages import Message, about
from slam.core.pose_heights import up_stds

_LEAST_HEIGHTS = 15
"""The scatter of so many residuals is known to a fifth (1 / sqrt(2 (n - 2))): four deviations are more
than three."""
_MOST_GAIN = 1.5
"""Ratio of changes of height that no air temperature makes. A height is proportional to it (see
`backend.bundle.barometer`): from 1 / 1.5 to 1.5 times 288 K are 192 to 432 K. Feet are 3.3 or 0.3 times."""
_CLEAR = 3.0
"""Least ratio of the spread of the map's heights to their standard deviation. Their noise lowers the slope by
the square of its inverse, a ninth, which is far from 1 / `_MOST_GAIN` (Fuller 1987, section 1.1.1)."""


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


def barometer_warning(bundle: Bundle | None) -> Message | None:
    """Return a line about heights that change by another factor than the map's; None where none do.

    The refinement takes such heights as noisy ones. The factor follows by least squares. Their noise is
    that of the residuals, and never less than stated. Rounding counts apart, by its largest effect: at a
    hover its error keeps one sign for long, and does not average out.
    """
    if bundle is None or not bundle.uses_barometer:
        return None
    heights = bundle.optimum.problem.measurements.heights
    if len(heights) < _LEAST_HEIGHTS:
        return None
    read, z = (values - values.mean() for values in read_and_mapped(heights, bundle.w_T_b))
    steps_m = np.diff(np.unique(np.round(read, 3)))
    k = [height.k for height in heights]
    z_std_m = float(np.median(up_stds(bundle.w_T_b[k], bundle.over_floor_covariances[k])))
    if not len(steps_m) or not z.std() > _CLEAR * z_std_m:
        return None
    gain, squares = height_gain(read, z), float(z @ z)
    stated_m = float(np.median([height.std_m for height in heights]))
    std = max(autocorrelated_std((read - gain * z)[:, None]), stated_m) / np.sqrt(squares)
    # Each reading is off by half of a step at most: the largest error of the slope.
    by_rounding = 0.5 * float(np.median(steps_m)) * float(np.abs(z).sum()) / squares
    if 1 / _MOST_GAIN < gain < _MOST_GAIN or abs(gain - 1) < SIGMAS_OF_SEVERAL * std + by_rounding:
        return None
    return about(
        "barometer0",
        f"its heights change {gain:.2g} ± {std:.1g} times as much as those of the map",
        "the map takes the difference as noise",
        "check that its unit is metres",
    )
