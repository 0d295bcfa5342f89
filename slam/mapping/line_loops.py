"""Loops over floors of lines: keyframes of different visits, aligned by their grey levels.

Crossings look alike, so that no loop is searched by its looks. The refined map predicts where two pictures
lie to each other, with the joint covariance of their poses, and the alignment is searched within it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from backend import se3
from backend.bundle.information import Information
from backend.errors import BackendError
from frontend.alignment import AlignmentTemplate, Prediction
from frontend.homography import transfer
from frontend.line_tracking import has_few, line_template
from frontend.loops import overlapping
from frontend.motions import MOST_LEAD
from frontend.registration import Registration, overlap
from slam.mapping.front_end import FrontEnd, Observations
from slam.mapping.map import Map

Array = NDArray[np.float64]
Pair = tuple[int, int]

EACH = 2
"""Loops of a keyframe at most, as many as it has links: further ones would count its noise again."""
_NUDGE = 1e-5
"""Half the step of numerical derivatives, in radians and heights."""


def close_over_lines(front_end: FrontEnd, observations: Observations, refined: Map) -> Observations:
    """Return the observations with the keyframes of different visits that lines align, by a refined map.

    They are searched where the poses say that footprints overlap, and within the covariance of the poses.
    """
    search = _Search(front_end, observations, refined)
    pairs = search.pairs()
    if not pairs:
        return observations
    try:
        predicted = search.predictions(pairs)
    except BackendError:
        return observations
    found: list[Registration] = []
    used: Counter[int] = Counter()
    by_overlap = sorted(pairs, key=lambda pair: -overlap(predicted[pair].i_H_j, front_end.camera))
    for done, (i, j) in enumerate(by_overlap, 1):
        if max(used[i], used[j]) < EACH:
            aligned = search.aligned(i, j, predicted[i, j])
            found += [aligned] if aligned is not None else []
            used.update([i, j] if aligned is not None else [])
        front_end.progress("loops", done, len(by_overlap))
    pairs_found = {(r.i, r.j) for r in found}
    others = tuple(r for r in observations.refused if (r.i, r.j) not in pairs_found)
    return replace(observations, registrations=(*observations.registrations, *found), refused=others)


@dataclass(frozen=True)
class _Search:
    """Search of loops in one refined map."""

    front_end: FrontEnd
    observations: Observations
    refined: Map

    def pairs(self) -> list[Pair]:
        """Return the pairs whose footprints overlap, of different visits, and with few features each."""
        refined, loops = self.refined, self.front_end.config.loops
        if refined.bundle is None or not any(r.by_lines for r in refined.kept_registrations):
            return []
        stamps_s, store = self.observations.stamps_s, self.observations.store
        few = [has_few(store.count(k), self.front_end.config.gates) for k in range(len(store))]
        poses = np.where(np.array(few)[:, None, None], self._poses, np.nan)
        known = {(r.i, r.j) for r in self.observations.registrations}
        # Those of one visit are left out below, and `close_over_lines` limits how many are aligned.
        near = overlapping(
            self.front_end.camera, poses, refined.floor_z_m, loops.min_overlap, neighbours=len(store)
        )
        return [
            (i, j) for i, j in near
            if stamps_s[j] - stamps_s[i] >= loops.min_separation_s and (i, j) not in known
        ]  # fmt: skip

    def predictions(self, pairs: Sequence[Pair]) -> dict[Pair, Prediction]:
        """Return where the later picture of each pair lies in the earlier one.

        Raises ``BackendError`` if the map leaves a direction open.
        """
        bundle = self.refined.bundle
        assert bundle is not None
        information = Information.of(bundle.optimum)
        members = np.flatnonzero(self.refined.component == 0)
        found = {}
        for i, j in pairs:
            J = self._derivatives(i, j)
            gradient = np.zeros((2, len(members), 6))
            gradient[:, np.searchsorted(members, [i, j])] = J
            found[i, j] = Prediction(self._i_H_j(i, j), information.covariance(gradient))
        return found

    def aligned(self, i: int, j: int, predicted: Prediction) -> Registration | None:
        """Align the pictures of two keyframes; None where that fails."""
        here, there = self._template(i), self._template(j)
        if here is None or there is None:
            return None
        front_end = self.front_end
        return here.register(i, j, there, predicted, MOST_LEAD, front_end.homography, front_end.config.gates)

    @cached_property
    def _poses(self) -> Array:
        return self.refined.of_main(self.refined.over_floor_T_b)

    @cached_property
    def _corners(self) -> Array:
        return self.front_end.camera.undistort(self.front_end.camera.corners_px)

    @cached_property
    def _templates(self) -> dict[int, AlignmentTemplate | None]:
        return {}

    def _template(self, k: int) -> AlignmentTemplate | None:
        """Return the picture of a keyframe for alignment, if it shows lines."""
        if k not in self._templates:
            frames, frame = self.front_end.flight.frames, int(self.observations.frame_index[k])
            image = frames.load(frame) if frames is not None else None
            self._templates[k] = (
                None
                if image is None
                else line_template(image, self.front_end.masks(frame), self.front_end.camera)
            )
        return self._templates[k]

    def _i_H_j(self, i: int, j: int, step_i: Array | None = None, step_j: Array | None = None) -> Array:
        """Return the homography of two keyframes, after steps (6,) of their body poses."""
        poses = []
        for k, step in ((i, step_i), (j, step_j)):
            pose = self._poses[k]
            poses.append(pose if step is None else pose @ se3.exp(step[None])[0])
        camera, floor_z_m = self.front_end.camera, self.refined.floor_z_m
        floor_H_i, floor_H_j = (camera.floor_H_image(pose, floor_z_m) for pose in poses)
        i_H_j = np.linalg.inv(floor_H_i) @ floor_H_j
        return np.asarray(i_H_j / i_H_j[2, 2], dtype=float)

    def _derivatives(self, i: int, j: int) -> Array:
        """Return the derivatives (2, 2, 6) of the mean displacement of j's corners in i by the poses of i and
        j."""

        def middle(step_i: Array | None, step_j: Array | None) -> Array:
            return np.asarray(transfer(self._i_H_j(i, j, step_i, step_j), self._corners).mean(axis=0))

        steps = _NUDGE * np.eye(6)
        by_i = [(middle(step, None) - middle(-step, None)) / (2 * _NUDGE) for step in steps]
        by_j = [(middle(None, step) - middle(None, -step)) / (2 * _NUDGE) for step in steps]
        return np.stack([np.array(by_i).T, np.array(by_j).T], axis=1)
