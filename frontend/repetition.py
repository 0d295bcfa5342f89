"""Repetition of the floor within one picture: displacements at which a picture looks like itself.

Over tiles, a grid or a carpet, a picture also matches a copy of the floor one period beside the right place.
A copy is as good a match if it looks as alike as the same points do in two pictures. Such pairs of features
of one picture vote for a common displacement. On other floors, points that look alike share none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frontend.features import Features
from frontend.homography import transfer
from frontend.matching import distances
from frontend.registration import Registration

Array = NDArray[np.float64]

LEAST_WIDTHS = 0.03
"""Least period in picture widths. Copies nearer than this share pixels of their descriptors."""
BIN_WIDTHS = 0.02
"""Width of a bin of the vote. A tilt of 10 degrees changes displacements by less over half a picture."""
LEAST_COMMON = 0.25
"""Least share of the picture that it has in common with itself at a displacement: with less, too few features
vote. It holds for two copies beside each other, each half a picture wide."""
AS_GOOD = 0.5
"""Share of the features that match at a copy, over that at the right place, from which the copy competes.
Where two pictures overlap by half, the right place has only half of the votes that a copy may have. Floors
that do not repeat (puzzle, planks, lines, the recorded flights and photographs) have 0; tiles of a third of
the picture have 0.8 to 3."""
_PARALLEL = np.cos(np.radians(20.0))


@dataclass(frozen=True)
class Repetition:
    """Lattice of the copies in one picture."""

    periods_px: Array
    """(1 or 2, 2) shortest displacements at which the picture looks like itself."""

    @property
    def period_px(self) -> float:
        """Shortest distance of two copies."""
        return float(np.linalg.norm(self.periods_px, axis=1).min())

    def in_periods(self, off_px: Array) -> Array:
        """Return displacements (n, 2) in periods, (n, 1 or 2)."""
        if len(self.periods_px) == 1:
            (period,) = self.periods_px
            return np.asarray((off_px @ period)[:, None] / (period @ period))
        return np.asarray(off_px @ np.linalg.inv(self.periods_px))


def repetition(
    here: Features, there: Features, link: Registration, size_px: tuple[int, int], least: int
) -> Repetition | None:
    """Return the repetition of the picture ``here``; None where it does not repeat.

    ``link`` registers the picture ``there`` to it, and tells how alike two views of one point are. ``least``:
    fewest matches of a registration.
    """
    i, j = link.matches.T.astype(np.intp)
    if len(i) < least or len(here) < least:
        return None
    apart, ratio = distances(here, here)
    seen = transfer(link.i_H_j, there.pixel)
    visible = ((seen >= 0) & (seen < size_px)).all(axis=1).sum()
    matched_share = len(i) / max(1, int(visible))
    of_link, _ = distances(here[i], there[j])
    first, second = np.nonzero(apart <= np.median(np.diagonal(of_link)) / ratio)
    peaks = _peaks(here.pixel, first, second, size_px, least)
    periods = [off for off, share in peaks if share >= AS_GOOD * matched_share]
    return _lattice(periods)


def _peaks(
    pixel: Array, first: NDArray[np.intp], second: NDArray[np.intp], size_px: tuple[int, int], least: int
) -> list[tuple[Array, float]]:
    """Return the common displacements of pairs of features, with the share of those that have a partner."""
    off, (w, h) = pixel[second] - pixel[first], size_px
    common = (1 - np.abs(off[:, 0]) / w) * (1 - np.abs(off[:, 1]) / h)
    # Of each pair, only the displacement downwards counts, or to the right if it is level.
    chosen = (off @ [1e-6, 1.0] > 0) & (np.hypot(*off.T) > LEAST_WIDTHS * w) & (common > LEAST_COMMON)
    first, off = first[chosen], off[chosen]
    found: list[tuple[Array, float]] = []
    width = BIN_WIDTHS * w
    while len(off) >= least:
        bins, count = np.unique(np.floor(off / width), axis=0, return_counts=True)
        middle = np.median(
            off[(np.abs(off - (bins[count.argmax()] + 0.5) * width) <= width).all(axis=1)], axis=0
        )
        near = np.hypot(*(off - middle).T) <= width
        if near.sum() < least:
            break
        inside = ((pixel + middle >= 0) & (pixel + middle < size_px)).all(axis=1)
        share = len(np.unique(first[near])) / max(1, int(inside.sum()))
        found.append((middle, share))
        rest = np.hypot(*(off - middle).T) > 2 * width
        first, off = first[rest], off[rest]
    return found


def _lattice(periods: list[Array]) -> Repetition | None:
    """Return the shortest displacement, and the shortest one in another direction."""
    if not periods:
        return None
    ordered = sorted(periods, key=lambda off: float(np.linalg.norm(off)))
    base = ordered[0] / np.linalg.norm(ordered[0])
    others = [off for off in ordered[1:] if abs(off @ base) < _PARALLEL * np.linalg.norm(off)]
    return Repetition(np.array([ordered[0], *others[:1]]))
