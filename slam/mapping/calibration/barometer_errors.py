"""Errors of the barometer as the refinement estimates them."""

from __future__ import annotations

import numpy as np

from backend.bundle.heights import GAIN, HEIGHTS
from backend.bundle.refinement import Bundle
from backend.sparse_cholesky import SingularMatrixError
from slam.core.instrument_errors import BarometerErrors


def barometer_errors(bundle: Bundle | None) -> BarometerErrors | None:
    """Return the errors; None where the refinement does not use the barometer."""
    if bundle is None or not bundle.uses_barometer:
        return None
    try:
        reduced = bundle.optimum.linearise().eliminate()
    except SingularMatrixError:
        return None
    unit = np.zeros(reduced.size)
    unit[reduced.structure.columns(HEIGHTS).start + GAIN] = 1.0
    return BarometerErrors(
        gain=float(bundle.optimum.values.atVector(HEIGHTS)[GAIN]),
        gain_std=float(np.sqrt(unit @ reduced.factor.solve(unit))),
        noise_m=bundle.noise.height_m,
    )
