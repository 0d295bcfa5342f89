"""Tracking over a floor of lines: pictures with too few features are aligned by their grey levels.

Lines show no motion along themselves, where tracking continues as it was. Tilt, heading and height of the
camera come from the instruments, as far as these tell them, so that a prediction has a displacement of the
vehicle alone, which is the same for the whole floor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from frontend.alignment import AlignmentTemplate
from frontend.camera import Camera
from frontend.corner_track import CornerTrack
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig, transfer
from frontend.registration import Registration
from frontend.views import View

Array = NDArray[np.float64]

FEW = 4
"""A picture with fewer features than so many times the least number is aligned by its grey levels where its
features do not register it: lines have features at their crossings alone."""

FloorOf = Callable[[int], Array]
"""Function of a frame's number: the homography (3, 3) from its undistorted pixels to the floor below it, with
the axes of the world, as far as the instruments tell tilt, heading and height."""


class LineTracker:
    """Alignment of successive pictures with a keyframe."""

    def __init__(
        self, camera: Camera, homography: HomographyConfig, gates: GateConfig, floor_of: FloorOf
    ) -> None:
        self.camera, self.homography, self.gates, self.floor_of = camera, homography, gates, floor_of
        self._corners = camera.undistort(camera.corners_px)
        self._templates: WeakKeyDictionary[View, AlignmentTemplate | None] = WeakKeyDictionary()
        self._recent: dict[int, View] = {}

    def template(self, view: View) -> AlignmentTemplate | None:
        """Return the picture for alignment, if it has few features but structure."""
        if view not in self._templates:
            few = len(view.features) < FEW * self.gates.min_inliers
            found = AlignmentTemplate.of(view.image, view.mask, self.camera) if few else None
            self._templates[view] = found if found is not None and found.is_structured else None
        return self._templates[view]

    def register(
        self, number: int, view: View, keyframe: View, track: CornerTrack
    ) -> tuple[Registration, CornerTrack] | None:
        """Register a picture to the last keyframe, and continue the track; None where that fails.

        The picture is aligned with the one before it first: only that one shows all lines that have entered
        the picture since the keyframe.
        """
        here, there = self.template(keyframe), self.template(view)
        if here is None or there is None:
            return None
        before = self._recent.get(track.frames[-1])
        i_H_before = track.homography(self._corners)
        start = self._predicted(view.frame, keyframe.frame, track)
        between = None
        by_before = self.template(before) if before is not None else None
        if before is not None and by_before is not None:
            step = np.linalg.inv(i_H_before) @ start
            between = by_before.register(
                number, number + 1, there, step, track.lead, self.homography, self.gates
            )
        if between is not None:
            start = i_H_before @ between.i_H_j
        link = here.register(number, number + 1, there, start, track.lead, self.homography, self.gates)
        if link is None:
            return None
        landed = transfer(link.i_H_j, self._corners)
        onward = track.then(view.frame, landed, track.lead, True, self.camera.size_px[0])
        if between is not None:
            back = link.i_H_j @ np.linalg.inv(between.i_H_j)
            onward = replace(onward, corners_px=(transfer(back, self._corners), landed))
        self._keep(view)
        return link, onward

    def begin(self, view: View) -> None:
        """Start at a keyframe."""
        self._keep(view)

    def _keep(self, view: View) -> None:
        """Keep the last two pictures: the newest is registered again if the one before becomes a keyframe."""
        latest = list(self._recent.items())[-1:]
        self._recent = dict([*latest, (view.frame, view)])

    def _predicted(self, frame: int, keyframe: int, track: CornerTrack) -> Array:
        """Return the homography (3, 3) from a frame to the keyframe at constant velocity over the floor."""
        floor_H_i, floor_H_j = self.floor_of(keyframe), self.floor_of(frame)
        moved = [
            self._moved(floor_H_i, at, corners_px)
            for at, corners_px in zip(track.frames, track.corners_px, strict=True)
        ]
        to = moved[-1]
        if len(moved) > 1:
            (first, last), steps = track.frames, frame - track.frames[-1]
            to = to + steps / (last - first) * (moved[-1] - moved[0])
        shift = np.eye(3)
        shift[:2, 2] = to
        i_H_j = np.linalg.inv(floor_H_i) @ shift @ floor_H_j
        return np.asarray(i_H_j / i_H_j[2, 2], dtype=float)

    def _moved(self, floor_H_i: Array, frame: int, corners_px: Array) -> Array:
        """Return the displacement (2,) over the floor of a frame with corners at (4, 2) of keyframe i."""
        there = transfer(self.floor_of(frame), self._corners)
        return np.asarray((transfer(floor_H_i, corners_px) - there).mean(axis=0))
