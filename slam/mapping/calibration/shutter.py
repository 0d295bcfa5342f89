"""The shutter of photographs, as the map has found it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.bundle.refinement import Bundle
from slam.core.instrument_errors import RollingShutter
from slam.mapping.map import Map

Array = NDArray[np.float64]


def rolling_shutter(bundle: Bundle | None) -> RollingShutter | None:
    """Return the read-out time of photographs; None where nothing is known of it."""
    if bundle is None or bundle.readout is None:
        return None
    found = bundle.readout
    return RollingShutter(
        found.readout_s, found.std_s, found.prior_std_s, found.is_estimated, found.known_velocities
    )


def row_motion_m(map_: Map) -> Array | None:
    """Return the motion (n, 3) of each camera in body axes from the exposure of the first row to that of the
    last; NaN for pictures outside the main part, None for a global shutter."""
    bundle = map_.bundle
    if bundle is None or bundle.row_motion_m is None:
        return None
    found = np.full((len(map_.w_T_b), 3), np.nan)
    main = np.flatnonzero(map_.component == 0)
    if len(main) == len(bundle.row_motion_m):  # else instruments have joined other parts to the refined one
        found[main] = bundle.row_motion_m
    return found
