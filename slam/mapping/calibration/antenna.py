"""The place of the GPS antenna that a map has estimated, beside what was told of it."""

from __future__ import annotations

from backend.bundle.refinement import Bundle
from backend.triple import triple
from slam.core.instrument_errors import AntennaPlace


def antenna_place(bundle: Bundle | None) -> AntennaPlace | None:
    """Return the place; None without positions, and where it was held."""
    if bundle is None:
        return None
    measured = bundle.optimum.problem.measurements
    if not measured.positions or measured.antenna_std_m == 0:
        return None
    place, std, told = map(triple, (bundle.antenna_m, bundle.antenna_std_m, measured.antenna_m))
    return AntennaPlace(place, std, told, measured.antenna_std_m)
