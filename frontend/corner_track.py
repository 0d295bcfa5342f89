"""Constant-velocity prediction of where the next picture lies, from the floor's motion over the last two."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frontend.homography import transfer
from frontend.motions import MOST_LEAD, Expectation

Array = NDArray[np.float64]

MOVES = 0.02
"""A picture moves where its corners go farther than this in picture widths."""
ALONE = 0.1
"""What a picture in which nothing else moves adds to the floor's lead."""


@dataclass(frozen=True)
class CornerTrack:
    """The last two pictures' places in the picture of a keyframe."""

    frames: tuple[int, ...]
    corners_px: tuple[Array, ...]
    """(4, 2) of each frame's corners in the keyframe's picture."""
    lead: float
    """As `frontend.motions.Expectation` has it."""

    @staticmethod
    def begin(frame: int, corners_px: Array) -> CornerTrack:
        """At a keyframe of which nothing is known before."""
        return CornerTrack((frame,), (corners_px,), 0.0)

    def then(self, frame: int, corners_px: Array, lead: float, alone: bool, width_px: int) -> CornerTrack:
        """One picture later; ``alone``: no other motion was found in it.

        What moves all over a picture is the floor; where nothing moves, it may stand beside a landing gear.
        """
        before = self.corners_px[-1]
        if alone and np.linalg.norm(corners_px - before, axis=1).mean() > MOVES * width_px:
            lead = min(MOST_LEAD, lead + ALONE)
        return CornerTrack((self.frames[-1], frame), (before, corners_px), lead)

    def seen_from(self, i_H_j: Array) -> CornerTrack:
        """The same in the picture of another keyframe j."""
        j_H_i: Array = np.asarray(np.linalg.inv(i_H_j), dtype=float)
        return CornerTrack(self.frames, tuple(transfer(j_H_i, c) for c in self.corners_px), self.lead)

    def expected(self, frame: int) -> Expectation | None:
        """Of a later frame, if corners go on as fast as between the last two; None after a single one."""
        if len(self.frames) < 2:
            return None
        (before, last), (a, b) = self.frames, self.corners_px
        steps = (frame - last) / (last - before)
        return Expectation(np.asarray(b + steps * (b - a), dtype=float), self.lead)
