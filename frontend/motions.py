"""Identification of the floor's motion in a pair of pictures with more than one motion.

A landing gear, a shadow's edge or a vehicle that drives through may carry more features than the floor, so
that the largest number of matches is not the floor's. The floor fills most of the picture: of two motions the
one whose matches cover more of it is selected. A single pair of pictures may mislead. Where the floor's
motion is known from earlier pictures, its continuation is selected until the other motion has covered more
over many pictures. The same rule resolves repetitive floors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.cells import cells, occupied
from frontend.homography import HomographyConfig, HomographyFit, fit_homography, transfer
from frontend.points import Points

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ELSEWHERE = 0.4
"""A second motion is searched where outliers occupy separate cells, at least this many for each cell of the
inliers."""
_LEAST, _ITERATIONS = 15, 300

DISTINCT_MOTION_WIDTHS = 0.05
"""A motion whose corners lie this many picture widths from where they are expected may not be the floor's."""
MOST_LEAD = 2.0
"""Upper limit of the lead, in pictures filled by the floor alone."""
KNOWN_MOTION_WIDTHS = 0.02
"""As `DISTINCT_MOTION_WIDTHS`, where instruments tell the motion: two readings of an attitude within 0.4
degrees (small drones) displace a picture of 64 degrees by 1 %, and this is twice as much."""
MIXED, SHARP, SHARPER = 0.1, 0.25, 3.0
"""If the noise of a fit exceeds this share of its threshold, two motions may be mixed. The fit with this
share of the threshold is one of them if its noise is so many times smaller."""


@dataclass(frozen=True)
class Expectation:
    """Prediction of the next picture from the previous ones."""

    corners_px: Array
    """(4, 2) predicted corners of picture j in picture i."""
    lead: float
    """Sum over pictures of the share of cells that the floor explained beyond other motions."""
    within_widths: float = DISTINCT_MOTION_WIDTHS
    """Error of the prediction, in picture widths, within which a motion may be the floor's."""

    @staticmethod
    def at(
        i_H_j: Array, corners_px: Array, within_widths: float = DISTINCT_MOTION_WIDTHS
    ) -> Expectation | None:
        """Predict from a known homography; None where a corner lies beyond the horizon."""
        if (corners_px @ i_H_j[2, :2] + i_H_j[2, 2] <= 0).any() or not np.isfinite(i_H_j).all():
            return None
        return Expectation(transfer(i_H_j, corners_px), MOST_LEAD, within_widths)

    def off_px(self, i_H_j: Array, corners_px: Array) -> float:
        """Return the mean distance of the corners from their prediction."""
        return float(np.linalg.norm(transfer(i_H_j, corners_px) - self.corners_px, axis=1).mean())

    def homography(self, corners_px: Array) -> Array:
        """Return the predicted homography (3, 3), pixels of picture j to pixels of picture i."""
        here, there = corners_px.astype(np.float32), self.corners_px.astype(np.float32)
        return np.asarray(cv2.getPerspectiveTransform(here, there))

    def predicted(self, pixel_j: Array, corners_px: Array) -> Array:
        """Return the predicted places (m, 2) in picture i of points of picture j."""
        with np.errstate(divide="ignore", invalid="ignore"):  # expected corners may lie in one place
            return transfer(self.homography(corners_px), pixel_j)


@dataclass(frozen=True)
class OtherMotion:
    """A second motion in a pair of pictures, beside that of the floor."""

    share: float
    """Share of the cells with matches of either motion that have matches of this one."""
    moved_px: tuple[float, float]
    """Mean displacement of its matches from picture j to picture i."""
    floor_px: tuple[float, float]
    """Displacement of the floor at the same places."""
    middle_px: tuple[float, float]
    """Displacement of the floor in the middle of the picture: a turn about it adds nothing."""

    @staticmethod
    def of(
        i_H_j: Array, at: Array, floor_i_H_j: Array, of_floor: NDArray[np.bool_], size_px: tuple[int, int]
    ) -> OtherMotion:
        """Describe the motion of points at (m, 2) in picture j, beside that of the floor.

        ``of_floor``: cells with matches of the floor.
        """
        covered = occupied(cells(at, size_px))
        share = float(covered.sum() / (covered | of_floor).sum())
        middle = 0.5 * np.array([size_px], dtype=np.float64)
        moved, floor, of_middle = (
            (transfer(H, place) - place).mean(axis=0).tolist()
            for H, place in ((i_H_j, at), (floor_i_H_j, at), (floor_i_H_j, middle))
        )
        return OtherMotion(share, tuple(moved), tuple(floor), tuple(of_middle))


@dataclass(frozen=True)
class FloorMotion:
    """The floor's homography in a pair of pictures."""

    fit: HomographyFit
    elsewhere: Mask
    """(m,) whether each match is an inlier of another motion."""
    other_i_H_j: Array | None
    """(3, 3) homography of the other motion; None without one."""
    lead: float
    """As in `Expectation`, this pair of pictures included."""

    def other(self, pixel_j: Array, size_px: tuple[int, int]) -> OtherMotion | None:
        """Describe the other motion of the matches at (m, 2) in picture j; None without one."""
        if self.other_i_H_j is None or not self.elsewhere.any():
            return None
        of_floor = occupied(cells(pixel_j[self.fit.inlier], size_px))
        return OtherMotion.of(self.other_i_H_j, pixel_j[self.elsewhere], self.fit.i_H_j, of_floor, size_px)


def floor_motion(
    points_i: Points,
    points_j: Points,
    seen_j: Array,
    corners_px: Array,
    size_px: tuple[int, int],
    config: HomographyConfig = HomographyConfig(),
    expected: Expectation | None = None,
) -> FloorMotion | None:
    """Fit the floor's homography to m matched points, as `fit_homography`; None where no plane fits.

    ``seen_j`` (n, 2): all features of picture j.
    """
    most = _one_motion(points_i, points_j, corners_px, config)
    if most is None:
        return None
    cell = cells(points_j.pixel, size_px)
    away_px = (expected.within_widths if expected else DISTINCT_MOTION_WIDTHS) * size_px[0]
    chosen = ~most.inlier
    off_px = expected.off_px(most.i_H_j, corners_px) if expected else 0.0
    if expected and off_px > away_px:
        apart = points_i.pixel - expected.predicted(points_j.pixel, corners_px)
        chosen &= np.linalg.norm(apart, axis=1) < off_px
    else:
        filled = occupied(cell[most.inlier])
        if (occupied(cell[chosen]) & ~filled).sum() <= ELSEWHERE * filled.sum():
            chosen[:] = False
    other = _agreeing(points_i, points_j, np.flatnonzero(chosen), corners_px, config)
    lead = expected.lead if expected else 0.0
    if other is None:
        return FloorMotion(most, np.zeros(len(points_i), dtype=bool), None, lead)
    other_off_px = expected.off_px(other.i_H_j, corners_px) if expected else 0.0
    first, second = (most, other) if off_px <= other_off_px else (other, most)
    more = _explained(first, cell, seen_j, size_px) - _explained(second, cell, seen_j, size_px)
    if abs(off_px - other_off_px) <= away_px:
        # Both may continue the floor's motion: the prediction does not separate them.
        first_is_floor = more >= 0
    else:
        lead = min(MOST_LEAD, lead + more)
        first_is_floor = lead >= 0
    floor, other = (first, second) if first_is_floor else (second, first)
    return FloorMotion(floor, other.inlier & ~floor.inlier, other.i_H_j, abs(lead))


def _one_motion(
    points_i: Points, points_j: Points, corners_px: Array, config: HomographyConfig
) -> HomographyFit | None:
    """Fit the homography with most inliers; where it blends two similar motions, return one of the two."""
    most = fit_homography(points_i, points_j, corners_px, config)
    if most is None or most.noise_px < MIXED * config.threshold_px:
        return most
    sharp = replace(config, threshold_px=SHARP * config.threshold_px, score="msac")
    one = _agreeing(points_i, points_j, np.arange(len(points_i)), corners_px, sharp)
    return one if one is not None and one.noise_px < most.noise_px / SHARPER else most


def _explained(fit: HomographyFit, cell: NDArray[np.int64], seen_j: Array, size_px: tuple[int, int]) -> float:
    """Return the share of cells with inliers among the cells of j whose features should be visible in i."""
    there = transfer(fit.i_H_j, seen_j)
    common = ((there >= 0) & (there < size_px)).all(axis=1)
    filled = occupied(cell[fit.inlier])
    return float(filled.sum() / max(1, (filled | occupied(cells(seen_j[common], size_px))).sum()))


def _agreeing(
    points_i: Points,
    points_j: Points,
    chosen: NDArray[np.int64],
    corners_px: Array,
    config: HomographyConfig,
) -> HomographyFit | None:
    """Fit a motion to the chosen matches; its inlier mask covers all matches. None with too few inliers."""
    if len(chosen) < _LEAST:
        return None
    quick = replace(config, max_iterations=min(config.max_iterations, _ITERATIONS))
    found = fit_homography(points_i[chosen], points_j[chosen], corners_px, quick)
    if found is None or found.inlier.sum() < _LEAST:
        return None
    inlier = np.zeros(len(points_i), dtype=bool)
    inlier[chosen[found.inlier]] = True
    return replace(found, inlier=inlier)
