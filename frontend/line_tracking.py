"""Tracking over a floor of lines: pictures with too few features are aligned by their grey levels.

Lines show no motion along themselves, where the instruments tell it. Tilt, heading and height of the camera
come from the instruments too, as far as these tell them, so that a prediction has a displacement of the
vehicle alone, which is the same for the whole floor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from frontend.alignment import AlignmentTemplate, Prediction
from frontend.camera import Camera
from frontend.corner_track import CornerTrack
from frontend.drift import Displacement, Drift, DriftModel
from frontend.edge_windows import mean_shift
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig, transfer
from frontend.registration import Registration
from frontend.views import View

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

FEW = 4
"""A picture with fewer features than so many times the least number is aligned by its grey levels where its
features do not register it: lines have features at their crossings alone."""
_NUDGE_PX = 0.5
"""Half the step of numerical derivatives."""


def has_few(features: int, gates: GateConfig) -> bool:
    """Return whether a picture with so many features may be aligned by its grey levels."""
    return features < FEW * gates.min_inliers


def line_template(image: Image, mask: Image | None, camera: Camera) -> AlignmentTemplate | None:
    """Return a picture for alignment; None if it shows no structure."""
    found = AlignmentTemplate.of(image, mask, camera)
    return found if found.is_structured else None


class InstrumentMotion(Protocol):
    """Motion of the camera over the floor, as far as the instruments tell it."""

    def __call__(self, frame: int) -> Array:
        """Return the homography (3, 3) from undistorted pixels of a frame to the floor below it, in metres
        along the axes of the world."""

    def stamp_s(self, frame: int) -> float:
        """Return the time of a frame."""

    @property
    def drift(self) -> DriftModel:
        """How the motion departs from the true one."""


@dataclass(frozen=True)
class _Followed:
    """A picture that was followed, and the drift at its time."""

    view: View
    drift: Drift


@dataclass(frozen=True)
class _Guess:
    """Expected place of a picture in another one, and how it follows from a departure."""

    prediction: Prediction
    departure: Displacement
    floor_by_pixel: Array
    """(2, 2) derivatives of the departure by the displacement of the picture."""


class LineTracker:
    """Alignment of successive pictures with a keyframe."""

    def __init__(
        self, camera: Camera, homography: HomographyConfig, gates: GateConfig, motion: InstrumentMotion
    ) -> None:
        self.camera, self.homography, self.gates, self.motion = camera, homography, gates, motion
        self._corners = camera.undistort(camera.corners_px)
        self._templates: WeakKeyDictionary[View, AlignmentTemplate | None] = WeakKeyDictionary()
        self._recent: dict[int, _Followed] = {}

    def template(self, view: View) -> AlignmentTemplate | None:
        """Return the picture for alignment, if it has few features but structure."""
        if view not in self._templates:
            few = has_few(len(view.features), self.gates)
            self._templates[view] = line_template(view.image, view.mask, self.camera) if few else None
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
        before, drift = self._before(keyframe, track)
        drift = drift.at(self.motion.stamp_s(view.frame))
        between = None
        by_before = self.template(before) if before not in (None, keyframe) else None
        if before is not None and by_before is not None:
            guess = self._guess(before.frame, view.frame, drift.from_before)
            between = self._aligned(number, by_before, there, guess, track)
            if between is not None:
                drift = drift.seen_from_before(self._seen(guess, between))
        guess = self._guess(keyframe.frame, view.frame, drift.from_keyframe)
        link = self._aligned(number, here, there, guess, track)
        if link is None:
            return None
        drift = drift.seen_from_keyframe(self._seen(guess, link))
        landed = transfer(link.i_H_j, self._corners)
        onward = track.then(view.frame, landed, track.lead, True, self.camera.size_px[0])
        if between is not None:
            back = link.i_H_j @ np.linalg.inv(between.i_H_j)
            onward = replace(onward, corners_px=(transfer(back, self._corners), landed))
        self._keep(_Followed(view, drift))
        return link, onward

    def begin(self, view: View) -> None:
        """Start at a keyframe: what is known of the drift stays."""
        if self.template(view) is None:
            return
        stamp_s = self.motion.stamp_s(view.frame)
        last = next(reversed(self._recent.values()), None)
        drift = Drift.begin(self.motion.drift, view.frame, stamp_s)
        if last is not None:
            continued = last.drift.at(stamp_s)
            if continued.speed_std_m_s < drift.speed_std_m_s:
                drift = continued.at_keyframe(view.frame)
        self._keep(_Followed(view, drift))

    @property
    def state(self) -> tuple[tuple[int, Drift], ...]:
        """Frames that were followed last, with the drift at their times."""
        return tuple((frame, followed.drift) for frame, followed in self._recent.items())

    def resume(self, state: tuple[tuple[int, Drift], ...], view_of: Callable[[int], View]) -> None:
        """Go on from a state; ``view_of`` gives the one view of each frame."""
        self._recent = {frame: _Followed(view_of(frame), drift) for frame, drift in state}

    def _keep(self, followed: _Followed) -> None:
        """Keep the last two pictures: the newest is registered again if the one before becomes a keyframe."""
        latest = list(self._recent.items())[-1:]
        self._recent = dict([*latest, (followed.view.frame, followed)])

    def _before(self, keyframe: View, track: CornerTrack) -> tuple[View | None, Drift]:
        """Return the last picture of a track, if it was followed by its lines, and the drift there."""
        frame = track.frames[-1]
        followed = self._recent.get(frame)
        if followed is not None:
            drift = followed.drift
            if drift.keyframe != keyframe.frame and frame == keyframe.frame:
                drift = drift.at_keyframe(frame)
            if drift.keyframe == keyframe.frame:
                return followed.view, drift
        drift = Drift.begin(self.motion.drift, keyframe.frame, self.motion.stamp_s(keyframe.frame))
        for number, corners_px in zip(track.frames, track.corners_px, strict=True):
            drift = drift.at(self.motion.stamp_s(number))
            seen = Displacement(self._moved(keyframe.frame, number, corners_px), np.zeros((2, 2)))
            drift = drift.seen_from_keyframe(seen)
        return None, drift

    def _aligned(
        self,
        number: int,
        here: AlignmentTemplate,
        there: AlignmentTemplate,
        guess: _Guess,
        track: CornerTrack,
    ) -> Registration | None:
        return here.register(
            number, number + 1, there, guess.prediction, track.lead, self.homography, self.gates
        )

    def _guess(self, i: int, j: int, departure: Displacement) -> _Guess:
        """Return where frame j lies in frame i, for a departure from the motion by the instruments."""
        floor_H_i, floor_H_j = self.motion(i), self.motion(j)
        shift = np.eye(3)
        shift[:2, 2] = departure.moved_m
        i_H_floor = np.linalg.inv(floor_H_i)
        i_H_j = i_H_floor @ shift @ floor_H_j
        middle = transfer(i_H_j, self._corners.mean(axis=0)[None])
        ends = transfer(floor_H_i, middle + _NUDGE_PX * np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]]))
        by_pixel = (ends[:2] - ends[2:]).T / (2 * _NUDGE_PX)
        by_floor = np.linalg.inv(by_pixel)
        predicted = Prediction(np.asarray(i_H_j / i_H_j[2, 2]), by_floor @ departure.covariance @ by_floor.T)
        return _Guess(predicted, departure, by_pixel)

    def _seen(self, guess: _Guess, found: Registration) -> Displacement:
        """Return the departure from the motion by the instruments that a registration shows."""
        off = transfer(found.i_H_j, self._corners) - transfer(guess.prediction.i_H_j, self._corners)
        moved, covariance = mean_shift(off.ravel(), found.corner_covariance, max(self.camera.size_px))
        by_pixel = guess.floor_by_pixel
        moved_m = guess.departure.moved_m + by_pixel @ moved
        return Displacement(moved_m, by_pixel @ covariance @ by_pixel.T)

    def _moved(self, i: int, j: int, corners_px: Array) -> Array:
        """Return the departure (2,) of frame j over the floor from the motion by the instruments, for its
        corners at (4, 2) of frame i."""
        there = transfer(self.motion(j), self._corners)
        return np.asarray((transfer(self.motion(i), corners_px) - there).mean(axis=0))
