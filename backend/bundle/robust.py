"""Robust noise models of factors whose errors are whitened."""

from __future__ import annotations

import gtsam
import numpy as np

from backend.quantiles import chi_square_quantile

_WHOLE_WEIGHT = 0.99
"""Share of errors whose weight Huber's loss keeps, if the noise is Gaussian."""


def robust_unit(size: int) -> gtsam.noiseModel.Robust:
    """Return Huber's loss of errors (size,) of unit variance."""
    kernel = gtsam.noiseModel.mEstimator.Huber.Create(
        float(np.sqrt(chi_square_quantile(_WHOLE_WEIGHT, size)))
    )
    return gtsam.noiseModel.Robust.Create(kernel, gtsam.noiseModel.Unit.Create(size))
