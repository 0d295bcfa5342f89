"""Constant-velocity prediction of the next picture's corners from the floor's motion over the last two."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frontend.homography import transfer
from frontend.motions import KNOWN_MOTION_WIDTHS, MOST_LEAD, Expectation

Array = NDArray[np.float64]
FloorHomography = Callable[[int], Array]
"""Function of a frame: homography (3, 3) from its undistorted pixels to the floor."""

MOVES = 0.02
"""Least corner motion, in picture widths, of a moving picture."""
ALONE = 0.1
"""Increment of the floor's lead by a picture without another motion."""


@dataclass(frozen=True)
class CornerTrack:
    """Corners of the last two pictures in the picture of a keyframe."""

    frames: tuple[int, ...]
    corners_px: tuple[Array, ...]
    """(4, 2) of each frame's corners in the keyframe's picture."""
    lead: float
    """Confidence in the floor's motion, defined in `frontend.motions.Expectation`."""

    @staticmethod
    def begin(frame: int, corners_px: Array) -> CornerTrack:
        """Start at a keyframe without a history."""
        return CornerTrack((frame,), (corners_px,), 0.0)

    def then(self, frame: int, corners_px: Array, lead: float, alone: bool, width_px: int) -> CornerTrack:
        """Append a picture; ``alone``: no other motion was found in it.

        A motion that fills the picture is the floor's. Without motion, the floor may be confused with a
        landing gear.
        """
        before = self.corners_px[-1]
        if alone and np.linalg.norm(corners_px - before, axis=1).mean() > MOVES * width_px:
            lead = min(MOST_LEAD, lead + ALONE)
        return CornerTrack((self.frames[-1], frame), (before, corners_px), lead)

    def corrected(self, corners_px: Array) -> CornerTrack:
        """Return the track with another registration of its last picture."""
        return CornerTrack(self.frames, (*self.corners_px[:-1], corners_px), self.lead)

    def seen_from(self, i_H_j: Array) -> CornerTrack:
        """Return the track in the picture of another keyframe j."""
        j_H_i: Array = np.asarray(np.linalg.inv(i_H_j), dtype=float)
        return CornerTrack(self.frames, tuple(transfer(j_H_i, c) for c in self.corners_px), self.lead)

    def homography(self, corners_px: Array) -> Array:
        """Return that (3, 3) of the last picture, with corners at (4, 2), to the keyframe."""
        return Expectation(self.corners_px[-1], self.lead).homography(corners_px)

    def expected(self, frame: int) -> Expectation | None:
        """Predict the corners of a later frame at constant velocity; None after a single frame."""
        if len(self.frames) < 2:
            return None
        (before, last), (a, b) = self.frames, self.corners_px
        steps = (frame - last) / (last - before)
        return Expectation(np.asarray(b + steps * (b - a), dtype=float), self.lead)


def expectations(
    floor_H: FloorHomography | None, corners_px: Array
) -> Callable[[CornerTrack, int], Expectation | None]:
    """Return what predicts a later frame of a track: the instruments, which tell the motion since its last
    frame, or without ``floor_H`` a constant velocity. ``corners_px`` (4, 2) are those of a picture."""
    if floor_H is None:
        return CornerTrack.expected

    def by_instruments(track: CornerTrack, frame: int) -> Expectation | None:
        step = np.linalg.inv(floor_H(track.frames[-1])) @ floor_H(frame)
        return Expectation.at(track.homography(corners_px) @ step, corners_px, KNOWN_MOTION_WIDTHS)

    return by_instruments
