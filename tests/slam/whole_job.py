"""The whole job on the short flight, and what its tests ask of every answer and refusal."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from slam.core.errors import InputError
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.mapping.pipeline import optimize
from tests.slam.small_flight import flown


def normal(seed: int = 0) -> tuple[Flight, Estimate]:
    return _normal(seed)


@lru_cache
def _normal(seed: int) -> tuple[Flight, Estimate]:
    flight = flown(seed)
    return flight, optimize(flight)


def assert_whole(estimate: Estimate) -> None:
    """All placed in one part, each with a covariance."""
    assert (estimate.component == 0).all()
    assert np.isfinite(estimate.w_T_b).all()
    assert (np.linalg.eigvalsh(estimate.covariances)[:, 0] > 0).all()


def refusal(flight: Flight) -> str:
    with pytest.raises(InputError) as refused:
        optimize(flight)
    message = str(refused.value)
    assert "\n" not in message
    assert flight.name in message
    return message
