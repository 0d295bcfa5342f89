"""Registrations of the newest keyframe to earlier ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frontend.loops import verify
from frontend.registration import Registration, overlap
from frontend.store import FeatureStore
from frontend.tracked import Keyframe
from slam.mapping.front_end import FrontEnd
from slam.mapping.live.loop_candidates import AppearanceIndex, near
from slam.mapping.search_radius import view_radius

Array = NDArray[np.float64]

_OF_EACH = 2
"""Loops tried for each keyframe, by appearance and by place: all of them take less than a picture's time."""


class LiveLoops:
    """Finds the earlier keyframes that the newest one sees again, and the one before its neighbour."""

    def __init__(self, store: FeatureStore, front_end: FrontEnd) -> None:
        self._store, self._front_end = store, front_end
        self._index = AppearanceIndex(store, front_end.config.retrieval)
        self._stamps_s: list[float] = []
        self._links: list[Registration | None] = []

    def of_newest(self, keyframe: Keyframe, stamp_s: float, poses: Array) -> list[Registration]:
        """Return the registrations of the newest keyframe that hold, its link included.

        ``poses`` (n, 4, 4) of the keyframes before it over the floor at 0; NaN where not placed.
        """
        front_end, newest = self._front_end, len(self._stamps_s)
        self._stamps_s.append(stamp_s)
        self._links.append(keyframe.link)
        self._index.add(newest)
        separation_s = front_end.config.loops.min_separation_s
        old = np.flatnonzero(stamp_s - np.array(self._stamps_s[:-1]) >= separation_s)
        pairs = dict.fromkeys(self._index.similar(old, _OF_EACH))
        if len(old) and keyframe.link is not None and np.isfinite(poses[-1]).all():
            here = poses[-1, :3, 3]
            reach = 2 * view_radius(front_end.camera) * max(float(here[2]), 0.0)
            pairs |= dict.fromkeys(near(poses[old, :3, 3], here, reach, old, _OF_EACH))
        if newest >= 2 and self._overlaps_second():
            pairs[newest - 2] = None
        verdicts = verify(
            [(i, newest) for i in pairs], self._store, front_end.camera, front_end.homography,
            front_end.config.gates,
        )  # fmt: skip
        accepted = [r for r in verdicts if r.ok]
        return accepted if keyframe.link is None else [keyframe.link, *accepted]

    def _overlaps_second(self) -> bool:
        """Return whether the newest keyframe overlaps the one before its neighbour, by the links between."""
        first, second = self._links[-2:]
        if first is None or second is None:
            return False
        i_H_k = first.i_H_j @ second.i_H_j
        return overlap(i_H_k, self._front_end.camera) >= self._front_end.config.loops.min_overlap
