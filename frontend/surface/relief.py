"""Decision where the ground is not flat, from the misregistration over the floor.

Relief displaces pictures along the parallax alone. Errors of poses and of the measurement displace them
across it as well, so the components across the parallax are the knockoffs of the components along it. The
excess of a square is the size of its component along the parallax less the size of that across it. Over a
flat floor, both signs of the excess are equally likely. A wrong match displaces a square both ways, so that
its excess is seldom large. The threshold is the least with an estimated false discovery rate of at most
``FALSE_SHARE`` (Barber and Candes 2015, Controlling the false discovery rate via knockoffs, equations 1.7 and
1.9). On a flat floor there is none.

That rule needs many squares. A house or a heap covers a few: they are found where they lie far beyond the
largest component across.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frontend.surface.misregistration import Misregistration

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FALSE_SHARE = 0.05
"""Share of the squares found to have relief that may be flat, and of the flat floors with a square found
beyond all components across. The inverse, 20, is the least number of squares that either rule judges."""
_TAIL = 3.0
"""Exponent of the tails of the components, as heavy as those of Student's t with as many degrees of freedom.
Of two such samples, the largest value of one is more than r times that of the other with a probability of
1 / (1 + r^3)."""
VISIBLE_PX = 0.5
"""Least excess that counts: a smaller displacement changes no pixel of the mosaic."""


def relief_threshold_px(measured: Misregistration) -> float:
    """Return the least excess along the parallax that shows relief; infinite where none does."""
    excess = np.sort(_excess_px(measured)[measured.found])
    tried = excess[excess >= VISIBLE_PX]
    false = np.searchsorted(excess, -tried, side="right")
    found = len(excess) - np.searchsorted(excess, tried)
    kept = tried[(1 + false) <= FALSE_SHARE * found]
    if FALSE_SHARE * len(excess) >= 1:
        far_px = (1 / FALSE_SHARE - 1) ** (1 / _TAIL) * np.abs(measured.across_px[measured.found]).max()
        kept = np.concatenate([kept, tried[tried > far_px]])
    return float(kept.min(initial=np.inf))


def _excess_px(measured: Misregistration) -> Array:
    """Return (n,) the size of the component along the parallax less that of the one across it."""
    return np.asarray(np.abs(measured.along_px) - np.abs(measured.across_px))


def relief_squares(measured: Misregistration) -> Mask:
    """Return (rows, cols) the squares whose ground must be measured.

    These are the squares whose excess reaches the threshold. If there are any, a square where no displacement
    was found is measured too: over high ground the two pictures may be too far apart for phase correlation.
    """
    threshold_px = relief_threshold_px(measured)
    relief = np.zeros(measured.shape, bool)
    if np.isfinite(threshold_px):
        r, c = measured.square.T
        relief[r, c] = ~measured.found | (_excess_px(measured) >= threshold_px)
    return relief


def is_better(over_surface: Misregistration, over_floor: Misregistration) -> bool:
    """Return whether more squares agree better over a surface than over the floor than agree worse.

    A square counts if the displacements over the two differ by more than half of `VISIBLE_PX`. Where no
    displacement was found, it is taken as larger than any other.
    """
    off_px = np.full((2, *over_floor.shape), np.inf)
    for measured, off in zip((over_surface, over_floor), off_px, strict=True):
        r, c = measured.square[measured.found].T
        off[r, c] = np.linalg.norm(measured.shift_px[measured.found], axis=1)
    surface_px, floor_px = off_px[:, over_floor.compared & over_surface.compared]
    better = np.count_nonzero(surface_px + VISIBLE_PX / 2 < floor_px)
    return bool(better > np.count_nonzero(floor_px + VISIBLE_PX / 2 < surface_px))
