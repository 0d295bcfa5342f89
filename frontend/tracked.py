"""Frames as tracking leaves them: registered to a keyframe by flow or features, or keyframes themselves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.cells import cells
from frontend.corner_track import CornerTrack
from frontend.features import Features
from frontend.registration import Registration
from frontend.views import View

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Keyframe:
    """A frame that is kept in the map."""

    frame: int
    """Number of the frame in the flight."""
    features: Features
    link: Registration | None
    """Registration to the previous keyframe (i = previous, j = this); None where tracking restarted."""
    refused: Registration | None = None
    """A rejected registration to the previous keyframe."""
    image: Image | None = None
    """Its picture, where frames are tracked."""


@dataclass(frozen=True)
class IntermediateFrame:
    """A frame between keyframes, registered to the keyframe before it."""

    frame: int
    keyframe: int
    i_H_j: NDArray[np.float64]
    """(3, 3) homography; i is the keyframe, j the frame."""
    corner_covariance: NDArray[np.float64]
    """(8, 8) px², as in `frontend.registration`."""


@dataclass(frozen=True)
class Tracked:
    """A picture that is registered to the last keyframe."""

    view: View
    link: Registration | None
    corner_track: CornerTrack
    """Corners of this frame and of the previous one in the picture of the last keyframe."""

    @property
    def frame(self) -> int:
        """Number of the frame in the flight."""
        return self.view.frame

    def seen_from(self, keyframe: Matched) -> Tracked:
        """Return the frame as the pictures after a new keyframe continue its motion; its link stays."""
        assert keyframe.link is not None
        return replace(self, corner_track=self.corner_track.seen_from(keyframe.link.i_H_j))

    def passed(self) -> IntermediateFrame:
        """Return the frame as an intermediate frame."""
        assert self.link is not None
        return IntermediateFrame(self.frame, self.link.i, self.link.i_H_j, self.link.corner_covariance)


@dataclass(frozen=True)
class Matched(Tracked):
    """A picture that is registered by its features, those on moving objects included: the next frame needs
    them to separate the objects from the floor."""

    on_floor: NDArray[np.bool_]
    """(n,) whether each feature belongs to the floor and enters the map."""

    @property
    def features(self) -> Features:
        """Features of the picture."""
        return self.view.features

    def as_last(self) -> Matched:
        """Return the frame as the keyframe that later frames are registered to."""
        assert self.link is not None
        return replace(self, corner_track=self.corner_track.seen_from(self.link.i_H_j))

    def keyframe(self, last: Matched | None) -> Keyframe:
        """Return the frame as a keyframe with the features on the floor only."""
        features, link = self.features, self.link
        if link is not None and last is not None and not (self.on_floor.all() and last.on_floor.all()):
            i, j = link.matches.T
            kept = last.on_floor[i] & self.on_floor[j]
            number_i, number_j = np.cumsum(last.on_floor) - 1, np.cumsum(self.on_floor) - 1
            matches = np.column_stack([number_i[i[kept]], number_j[j[kept]]])
            link = replace(link, matches=matches.astype(i.dtype), elsewhere=link.elsewhere[:0])
        on_floor = features if self.on_floor.all() else features[self.on_floor]
        return Keyframe(self.frame, on_floor, link, image=self.view.image)


def on_floor(features: Features, link: Registration, camera: Camera) -> NDArray[np.bool_]:
    """Return (n,) whether a feature is on the floor: not in a cell where only another motion was matched."""
    if len(link.elsewhere) == 0:
        return np.ones(len(features), dtype=bool)
    cell = cells(features.pixel, camera.size_px)
    other = np.setdiff1d(cell[link.elsewhere], cell[link.matches[:, 1]])
    kept = ~np.isin(cell, other)
    kept[link.elsewhere] = False
    return kept
