"""Huber's loss for errors of any size, with one rule for where it becomes linear."""

from __future__ import annotations

import math

import gtsam
import numpy as np

from backend.quantiles import chi_square_quantile

_WHOLE_WEIGHT = 1.0 - math.exp(-2.0)
"""Share of errors whose weight Huber's loss keeps, if the noise is Gaussian: those of pixels within two
standard deviations, and as many of any other size. The loss then costs at most 4 % of the information, and
the covariance that its weights give is right to 1 %."""


def huber_limit(size: int) -> float:
    """Return the norm of whitened errors (size,) from which on Huber's loss grows linearly."""
    return float(np.sqrt(chi_square_quantile(_WHOLE_WEIGHT, size)))


def robust_unit(size: int) -> gtsam.noiseModel.Robust:
    """Return Huber's loss of errors (size,) of unit variance."""
    return robust(gtsam.noiseModel.Unit.Create(size))


def robust(model: gtsam.noiseModel.Gaussian, measured: int | None = None) -> gtsam.noiseModel.Robust:
    """Return Huber's loss of errors with Gaussian noise. ``measured``: how many of them have any weight."""
    limit = huber_limit(model.dim() if measured is None else measured)
    return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(limit), model)
