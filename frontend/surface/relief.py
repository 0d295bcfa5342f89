"""Decision where the ground is not flat, from the misregistration over the floor.

Relief displaces pictures along the parallax alone. Errors of poses and of the measurement displace them
across it as well, so the components across the parallax are the null sample: the knockoffs of the components
along it. The threshold is the least with an estimated false discovery rate of at most ``FALSE_SHARE`` (Barber
and Candes 2015, Controlling the false discovery rate via knockoffs, equation 1.9). A flat floor exceeds none.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frontend.surface.misregistration import Misregistration

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FALSE_SHARE = 0.05
"""Share of the squares found to have relief that may be flat. Fewer than its inverse, 20, are never found."""
VISIBLE_PX = 0.5
"""Least displacement that counts: a smaller one does not change which pixel of the mosaic shows a point."""


def relief_threshold_px(measured: Misregistration) -> float:
    """Return the least displacement along the parallax that shows relief; infinite where none does."""
    along = np.sort(np.abs(measured.along_px[measured.found]))
    across = np.sort(np.abs(measured.across_px[measured.found]))
    tried = along[along >= VISIBLE_PX]
    false = len(across) - np.searchsorted(across, tried)
    found = len(along) - np.searchsorted(along, tried)
    kept = tried[(1 + false) <= FALSE_SHARE * found]
    return float(kept.min(initial=np.inf))


def relief_squares(measured: Misregistration) -> Mask:
    """Return (rows, cols) the squares whose ground must be measured.

    These are the squares beyond the threshold. If there are any, a square where no displacement was found is
    measured too: over high ground the two pictures may be too far apart for phase correlation.
    """
    threshold_px = relief_threshold_px(measured)
    relief = np.zeros(measured.shape, bool)
    if np.isfinite(threshold_px):
        r, c = measured.square.T
        relief[r, c] = ~measured.found | (np.abs(measured.along_px) >= threshold_px)
    return relief
