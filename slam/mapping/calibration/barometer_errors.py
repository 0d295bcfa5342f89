"""Errors of the barometer as the refinement estimates them."""

from __future__ import annotations

from backend.bundle.barometer import GAIN, HEIGHTS
from backend.bundle.refinement import Bundle
from backend.sparse_cholesky import SingularMatrixError
from slam.core.instrument_errors import BarometerErrors


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
