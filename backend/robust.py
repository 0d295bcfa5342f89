"""Robust noise models."""

from __future__ import annotations

import gtsam
import numpy as np

from backend.quantiles import chi_square_quantile

_WHOLE_WEIGHT = 0.99
"""Share of errors whose weight Huber's loss keeps, if the noise is Gaussian."""


def robust_unit(size: int) -> gtsam.noiseModel.Robust:
    """Return Huber's loss of errors (size,) of unit variance."""
    return robust(gtsam.noiseModel.Unit.Create(size))


def robust(model: gtsam.noiseModel.Gaussian) -> gtsam.noiseModel.Robust:
    """Return Huber's loss of errors with Gaussian noise."""
    limit = float(np.sqrt(chi_square_quantile(_WHOLE_WEIGHT, model.dim())))
    return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(limit), model)
